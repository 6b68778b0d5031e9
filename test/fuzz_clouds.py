"""Clouds and cameras that nobody should send, and frames of centroids that no sky shows.

`FUZZ_CASES=100000` in the environment runs so many cases in the slow tests instead of those of
continuous integration; `FUZZ_SEED` another sequence of them.
"""

import array
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from sensor_msgs.msg import CameraInfo, PointCloud2, PointField, RegionOfInterest
from std_msgs.msg import Header

#: Cases of a fuzz test where it need not be slow.
FEW_CASES = 300
#: Cases of each slow fuzz test in continuous integration.
CASES = int(os.environ.get("FUZZ_CASES", "2000"))
SEED = int(os.environ.get("FUZZ_SEED", "6"))
#: Without a database of examples and with one seed: each run is the same.
_SETTINGS = settings(
    max_examples=FEW_CASES, deadline=None, database=None, phases=(Phase.generate, Phase.shrink),
    suppress_health_check=list(HealthCheck),
)

SIZE = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}
UINT32 = st.one_of(
    st.integers(0, 40), st.sampled_from([2**16, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1]),
    st.integers(0, 2**32 - 1),
)
NAMES = st.one_of(
    st.sampled_from(["x", "y", "intensity", "z", "rgb", "", "X", "titles", "x\x00"]),
    st.text(max_size=8),
)


#: A test of few cases, and the same one of many, which is slow.
few_or_many = pytest.mark.parametrize(
    "n_cases", [FEW_CASES, pytest.param(CASES, marks=pytest.mark.slow)], ids=["few", "many"]
)


def fuzzed(n_cases):
    """Run a test on so many cases, which are the same in each run."""
    return lambda test: seed(SEED)(settings(_SETTINGS, max_examples=n_cases)(test))


few = fuzzed(FEW_CASES)


def _right(draw, *, sound):
    """Draw whether one more part of a message is as it should be."""
    return sound or draw(st.integers(0, 3)) > 0


def _fields(draw, *, sound):
    """Draw fields that follow each other as they should, or not; return them and their end."""
    names = draw(
        st.sampled_from([["x", "y"], ["x", "y", "intensity"], ["y", "z", "x"], ["", "y", "x"]])
        if _right(draw, sound=sound) else st.lists(NAMES, max_size=6)
    )
    fields, offset = [], 0
    coordinates = st.sampled_from([7, 7, 8])
    for name in names:
        datatype, count, at = draw(coordinates), 1, offset
        if not _right(draw, sound=sound):
            datatype = draw(st.one_of(coordinates, st.integers(0, 255)))
            count = draw(st.one_of(st.just(1), UINT32))
            at = draw(st.one_of(st.just(offset), UINT32))
        fields.append(PointField(name=name, offset=at, datatype=datatype, count=count))
        offset += SIZE.get(datatype, 4) * min(count, 16)
    return fields, offset


def _bytes(draw, n_bytes):
    """Bytes of a length: noise, or floats among which are those that are no coordinates."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if draw(st.booleans()):
        return rng.bytes(n_bytes)
    values = rng.choice(
        [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 3e38, -3e38, 100.0, 256.5, 511.9, -1.0],
        n_bytes // 4 + 1,
    )
    return values.astype(draw(st.sampled_from(["<f4", ">f4", "<f8", ">f8"]))).tobytes()[:n_bytes]


@st.composite
def clouds(draw):
    """Any PointCloud2 that can be sent: sound ones, ones with one fault, and nonsense."""
    sound = draw(st.booleans())
    fields, end = _fields(draw, sound=sound)
    width = draw(st.integers(0, 40) if _right(draw, sound=sound) else UINT32)
    step = end + draw(st.integers(0, 9)) if _right(draw, sound=sound) else draw(UINT32)
    height = draw(st.sampled_from([1, 1, 2, 5]) if _right(draw, sound=sound) else UINT32)
    row_step = width * step + (draw(st.sampled_from([0, 0, 4, 64])) if height != 1 else 0)
    length = height * row_step
    if length > 4_000 or not _right(draw, sound=sound):
        length = draw(st.one_of(st.integers(0, 300), st.just(min(length, 4_000))))
    return PointCloud2(
        header=Header(), height=height, width=width, fields=fields,
        is_bigendian=draw(st.booleans()), point_step=step,
        row_step=draw(st.one_of(st.just(min(row_step, 2**32 - 1)), UINT32)),
        data=array.array("B", _bytes(draw, length)), is_dense=draw(st.booleans()),
    )


BAD_VALUES = st.sampled_from([
    np.nan, np.inf, -np.inf, -1.0, -1e-300, 5e-324, 1e30, -1e300, 1.7e308, 512.0, 0.0,
])


@st.composite
def garbage(draw):
    """Centroids (n, 2) without a sky behind them, and intensities (n,) or None.

    One centroid many times, few that repeat, points along a line, a column or a circle, a grid,
    powers of ten; among them what is no coordinate, and intensities from 5e-324 to 1e300.
    """
    n = draw(st.integers(0, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    t = np.sort(rng.uniform(0, 1, n))
    kind = draw(st.sampled_from(["same", "few", "line", "axis", "curve", "grid", "huge"]))
    xy = {
        "same": lambda: np.tile(rng.uniform(0, 512, 2), (n, 1)),
        "few": lambda: rng.uniform(0, 512, (3, 2))[rng.integers(0, 3, n)],
        "line": lambda: rng.uniform(0, 512, 2) * (1 - t[:, None]) + rng.uniform(0, 512, 2)
        * t[:, None],
        "axis": lambda: np.column_stack([np.full(n, rng.uniform(0, 512)), 512 * t]),
        "curve": lambda: 256 + 200 * np.column_stack([np.cos(6 * t), np.sin(6 * t)]),
        "grid": lambda: np.column_stack(np.divmod(np.arange(n), 6)) * 60.0 + 20,
        "huge": lambda: rng.normal(0, 1, (n, 2)) * 10.0 ** rng.integers(-300, 300, (n, 2)),
    }[kind]()
    for at in draw(st.lists(st.integers(0, max(0, 2 * n - 1)), max_size=8 if n else 0)):
        xy.flat[at] = draw(BAD_VALUES)
    if draw(st.booleans()):
        return xy, None
    intensity = rng.choice([0.0, -1.0, 1.0, 2.0, np.nan, np.inf, 1e300, 5e-324], n)
    return xy, intensity if draw(st.booleans()) else rng.uniform(0, 1e5, n)


NUMBER = st.one_of(
    st.floats(), st.sampled_from([0.0, 1.0, -1.0, 100.0, 600.0, 1e-3, 1e9]), st.floats(-1, 1),
)
SIDE = st.one_of(st.sampled_from([64, 512, 1024]), UINT32)


@st.composite
def camera_infos(draw):
    """Any CameraInfo: K, P, R, distortion, size, region and binning each sound or not."""
    k = [600.0, 0.0, 32.0, 0.0, 600.0, 32.0, 0.0, 0.0, 1.0]
    for at in draw(st.lists(st.integers(0, 8), max_size=3)):
        k[at] = draw(NUMBER)
    p = [*k[:3], -30.0, *k[3:6], 0.0, *k[6:], 0.0]
    r = [float(value) for value in np.eye(3).ravel()]
    if draw(st.integers(0, 3)) == 0:
        p[draw(st.integers(0, 11))] = draw(NUMBER)
        r[draw(st.integers(0, 8))] = draw(NUMBER)
    roi, binning = RegionOfInterest(), (0, 0)
    if draw(st.integers(0, 3)) == 0:
        roi = RegionOfInterest(
            x_offset=draw(UINT32), y_offset=draw(UINT32), width=draw(SIDE), height=draw(SIDE)
        )
    if draw(st.integers(0, 3)) == 0:
        binning = draw(st.tuples(UINT32, UINT32))
    model = draw(st.sampled_from([
        "", "plumb_bob", "rational_polynomial", "equidistant", "fisheye", "none", "a\x00\n",
    ]))
    return CameraInfo(
        width=draw(SIDE), height=draw(SIDE), k=k, p=p, r=r, distortion_model=model, roi=roi,
        binning_x=binning[0], binning_y=binning[1],
        d=draw(st.one_of(st.just([]), st.lists(NUMBER, max_size=14), st.lists(
            st.floats(-0.3, 0.3), max_size=8,
        ))),
    )
