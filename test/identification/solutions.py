"""Trackers of whole frames: what several files of tests share."""

import math

import numpy as np

from star_tracker.solution import SolveSettings

PATIENT = SolveSettings(deadline_ms=math.inf)
THRESHOLD = PATIENT.max_log10_false_alarms


def assert_unsolved(solution, status, n):
    assert solution.status is status
    assert solution.attitude is None
    assert solution.wrong_probability == 1.0
    assert (solution.method, solution.parity) == ("", "")
    assert math.isnan(solution.rms_px)
    np.testing.assert_array_equal(solution.identification.catalog_index, np.full(n, -1))
    np.testing.assert_array_equal(solution.identification.state, np.zeros(n))
    assert np.isnan(solution.identification.residual_px).all()
    assert len(solution.identification.residual_px) == n


def record(solution):
    """All that a solution says but the time it took, bit by bit."""
    i, a = solution.identification, solution.attitude
    arrays = [i.catalog_index, i.state, i.residual_px]
    if a is not None:
        arrays += [a.quaternion_xyzw, a.covariance_rad2, a.ra_rad, a.dec_rad, a.roll_rad]
    return (
        solution.status, solution.reason, solution.method, solution.parity,
        solution.n_hypotheses, solution.n_ignored,
        *(np.asarray(x).tobytes() for x in (
            *arrays, solution.wrong_probability, solution.log10_false_alarms, solution.rms_px,
        )),
    )


def intensity_of(view):
    """A linear intensity of arbitrary scale for the measured magnitudes of a frame."""
    return 1e4 * 10 ** (-0.4 * view.v_mag)
