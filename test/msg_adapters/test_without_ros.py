"""Messages can be read where there is no ROS: out of a bag, on any machine."""

import pytest
from processes import ROOT, completed

#: What a process does first: nothing of ROS can be imported in it.
NO_ROS = """
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in ("rclpy", "rosidl_parser", "rpyutils") or top.endswith(("_msgs", "_interfaces")):
            raise ModuleNotFoundError(f"No module named {top!r}", name=top)

sys.meta_path.insert(0, NoRos())
"""
IMPORTS = """
import importlib
from pathlib import Path
names = [path.stem for path in Path("msg_adapters").glob("*.py") if path.stem != "__init__"]
assert "camera_info" in names
for name in names:
    importlib.import_module(f"star_tracker.msg_adapters.{name}")
"""
READS = """
from types import SimpleNamespace as Fields
import numpy as np
from star_tracker.msg_adapters.attitude import array_from_boresight
from star_tracker.msg_adapters.camera_info import camera_from_info
from star_tracker.msg_adapters.centroids import centroids_from_polygon
from star_tracker.msg_adapters.health import report_from_status
from star_tracker.msg_adapters.imu import orientation_from_imu
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud
from star_tracker.msg_adapters.solution import values_from_diagnostics
from star_tracker.msg_adapters.stamp import nanoseconds_from_header

# As rosbags makes them: dataclasses whose sequences are arrays.
xy = np.array([(1.5, 2.5), (3.0, 4.0)], "<f4")
cloud = Fields(
    height=1, width=2, is_bigendian=False, point_step=8, row_step=16, is_dense=True,
    data=np.frombuffer(xy.tobytes(), np.uint8),
    fields=[Fields(name="x", offset=0, datatype=7, count=1),
            Fields(name="y", offset=4, datatype=7, count=1)],
)
assert (centroids_from_cloud(cloud).xy_px == xy).all()
info = Fields(
    width=640, height=480, k=np.array([2400.0, 0, 320, 0, 2400, 240, 0, 0, 1]),
    d=np.array([-0.1, 0.01]), distortion_model="plumb_bob", r=np.eye(3).ravel(), p=np.zeros(12),
    binning_x=0, binning_y=0, roi=Fields(x_offset=0, y_offset=0, width=0, height=0),
)
assert camera_from_info(info, "normal").distortion.coefficients[:2] == (-0.1, 0.01)
point = Fields(x=1.0, y=2.0, z=3.0, w=4.0)
assert (centroids_from_polygon(Fields(polygon=Fields(points=[point]))).xy_px == [[1, 2]]).all()
assert (array_from_boresight(Fields(vector=point)) == [1, 2, 3]).all()
imu = Fields(orientation=point, orientation_covariance=np.arange(9.0))
assert orientation_from_imu(imu)[0].tolist() == [1, 2, 3, 4]
status = Fields(level=1, message="fine", values=[Fields(key="a", value="b")])
assert report_from_status(status) == ("WARN", "fine", {"a": "b"})
assert values_from_diagnostics(Fields(status=[status])) == {"a": "b"}
assert nanoseconds_from_header(Fields(stamp=Fields(sec=1, nanosec=2))) == 1_000_000_002
"""
CLEAN = """
ros = sorted(name for name in sys.modules if name.startswith(("rclpy", "sensor_msgs")))
assert not ros, ros
"""


@pytest.mark.parametrize("what", [IMPORTS, READS], ids=["imports", "reads"])
def test_a_process_without_ros(what):
    done = completed("-W", "error", "-c", NO_ROS + what + CLEAN, cwd=ROOT)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_block_holds():
    """Or else the tests above would tell nothing where ROS is installed."""
    done = completed("-c", NO_ROS + "import sensor_msgs.msg")
    assert "No module named 'sensor_msgs'" in done.stderr
