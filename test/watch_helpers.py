"""What an identify_node would say of a frame, as plain values."""

import numpy as np

from star_tracker.nodes.watch.model import Report, Watched

#: The dtype of `identified_stars`, as its topic's fields are named; here without ROS.
STAR_DTYPE = np.dtype([
    ("x", "<f4"), ("y", "<f4"), ("star_number", "<u4"), ("hip", "<u4"), ("ra_deg", "<f8"),
    ("dec_deg", "<f8"), ("magnitude", "<f4"), ("residual_px", "<f4"), ("state", "<u1"),
])
STARS = np.array([
    (7.5, 40.25, 1572, 35846, 110.8688, 25.0505, 5.04, 0.25, 1),
    (100.0, 200.5, 0, 0, np.nan, np.nan, np.nan, np.nan, 0),
    (1011.125, 278.0625, 1387, 32246, 100.9830, -5.1311, 3.06, 0.125, 1),
    (300.0, 400.0, 77, 0, 359.9999, 89.5, 6.0, 12.5, 2),
], STAR_DTYPE)
SOLVED = {
    "status": "SOLVED", "reason": "identified", "hint": "", "method": "match_group",
    "mode": "tracking", "parity": "mirrored", "matched": "2", "displaced": "1", "total": "4",
    "ignored": "0", "wrong_probability": "1.5e-09", "log10_false_alarms": "-9.10",
    "rms_px": "0.1976", "hypotheses": "12", "solve_ms": "0.161",
}
UNSOLVED = {
    **SOLVED, "status": "NO_MATCH", "reason": "nothing fits", "method": "", "parity": "",
    "hint": "image looks mirrored: parity mirrored solves it", "matched": "0", "displaced": "0",
    "wrong_probability": "1", "log10_false_alarms": "inf", "rms_px": "nan", "ignored": "1",
}
#: A quarter turn about z, so that the camera's x is the reference frame's y.
QUATERNION = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
ARCSEC = np.pi / 180 / 3600
COVARIANCE = np.diag([(3 * ARCSEC) ** 2, (2 * ARCSEC) ** 2, (40 * ARCSEC) ** 2])
BORESIGHT = np.array([109.60001, -34.5, 0.25])
HEALTH = Report("OK", "100 % of 80 frames solved", {
    "frames_per_s": "8.000", "solved_per_s": "8.000", "solve_ratio": "1.000",
    "latency_p50_ms": "0.900", "latency_p95_ms": "1.250", "latency_max_ms": "n/a",
    "input_age_s": "0.002", "frames": "81", "solved": "80", "dropped": "3", "mode": "tracking",
    "last_reason": "n/a", "rejected_bad_centroids": "2", "configuration": "123456789012",
})
FOCAL_LENGTH = Report("OK", "a sentence", {
    "nominal_px": "2435.677", "focal_length_px": "2435.817", "standard_error_px": "0.133",
    "drift_percent": "0.0057", "frames": "614", "frames_left_out": "0",
})


def hear_solved(watched, now_s, stamp_ns=1_500_000_000):
    """Tell of a solved frame, all of it, and return the frames that are complete then."""
    watched.on_boresight(stamp_ns, BORESIGHT, now_s)
    watched.on_orientation(stamp_ns, (QUATERNION, COVARIANCE), now_s)
    watched.on_solution(stamp_ns, "identify_node", SOLVED, now_s)
    watched.on_stars(stamp_ns, STARS, now_s)
    return watched.take(now_s)


def hear_unsolved(watched, now_s, stamp_ns=2_500_000_000):
    watched.on_solution(stamp_ns, "identify_node", UNSOLVED, now_s)
    watched.on_stars(stamp_ns, STARS[:0], now_s)
    return watched.take(now_s)


def watched_at(now_s, namespace="/left"):
    """Return a node that has said all there is to say."""
    watched = Watched(namespace)
    hear_solved(watched, now_s)
    watched.on_report(f"{namespace}/identify_node: health", HEALTH, now_s)
    watched.on_report(f"{namespace}/identify_node: focal length", FOCAL_LENGTH, now_s)
    return watched
