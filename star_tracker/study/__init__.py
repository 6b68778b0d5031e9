"""The robustness study behind `star_tracker evaluate`: what is measured, run, stored and shown.

    configuration -> chunks -> execution, with the store -> records -> figures, page

It needs libraries that the package itself does not: PyYAML, joblib, matplotlib, jinja2 (extra
`report`) and distributed (extra `dask`).
"""
