"""What measures star identifiers: one harness for our methods, the paper's forms and the peers.

    configuration -> plan -> chunks, run by execution, kept in the store -> records -> report

A `Contestant` becomes an `Entrant` for the camera that it is `Told` of, and answers `Scene`s.
`star_tracker evaluate` and `make benchmark` are two configurations of it. It needs libraries that
the package itself does not: PyYAML, joblib, matplotlib, jinja2 (extra `report`), distributed
(extra `dask`) and the peers (extra `benchmark`).
"""
