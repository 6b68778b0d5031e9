"""A bag of a camera fixed to the ground, a frame a minute over six hours, played to the node.

`imu_enu` stays where it is within its covariance, while `attitude` turns at the sidereal rate.
"""

from itertools import islice

import numpy as np
import pytest
from bag_files import raw_messages
from ground_camera import (
    AIR,
    CAMERA,
    HOURS,
    ORIENTATION,
    POSE,
    SIGMA_PX,
    SITE,
    START_NS,
    centroids_at,
)
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("erfa", reason="pyerfa is not installed")

from rclpy.serialization import deserialize_message
from ros_helpers import IdentifyClient, array_from_quaternion, open_bench, stamp_ns
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2

from star_tracker.bags.writing import new_bag
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.earth.site import EARTH_RATE_RAD_PER_S
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.centroids import Centroids
from star_tracker.msg_adapters.imu import earth_attitude_from_imu
from star_tracker.msg_adapters.point_cloud import cloud_from_centroids
from star_tracker.nodes.identify_node import IdentifyNode

#: 361 frames, each through six topics: half a minute.
pytestmark = pytest.mark.slow

ARCSEC = np.radians(1 / 3600)
EVERY_S = 60
N_FRAMES = HOURS * 3600 // EVERY_S + 1
#: Frames on their way at a time; fewer than the node lets wait.
BURST = 8
TOLD = {
    "use_camera_info": True, "catalog": "paper", "parity": "normal", "deadline_ms": 60_000.0,
    "keep_up": False, "camera_info_wait_ms": 10_000.0, "centroid_sigma_px": SIGMA_PX,
    "earth_frame": "enu", "latitude_deg": SITE.latitude_deg, "longitude_deg": SITE.longitude_deg,
    "height_m": SITE.height_m, "pressure_hpa": AIR.pressure_hpa,
    "temperature_c": AIR.temperature_c, "ut1_utc_s": ORIENTATION.ut1_utc_s,
    "polar_motion_arcsec": [ORIENTATION.xp_arcsec, ORIENTATION.yp_arcsec],
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """The night as an MCAP file: the camera once, then its frames."""
    path = tmp_path_factory.mktemp("night") / "night.mcap"
    catalog, rng = StarCatalog.paper(), np.random.default_rng(8)
    with new_bag(path) as writer:
        writer.declare("/camera_info", "sensor_msgs/CameraInfo")
        writer.declare("/centroids", "sensor_msgs/PointCloud2")
        header = writer.header(START_NS, "camera")
        writer.write("/camera_info", info_from_camera(CAMERA, header), START_NS)
        for stamp in range(START_NS, START_NS + N_FRAMES * EVERY_S * 10**9, EVERY_S * 10**9):
            xy = centroids_at(stamp, catalog, rng)
            cloud = cloud_from_centroids(Centroids(xy), writer.header(stamp, "camera"))
            writer.write("/centroids", cloud, stamp)
    return path


@pytest.fixture(scope="module")
def played(bag):
    """The node's `imu_enu` and `attitude` of each frame, in order."""
    found = {"/camera_info": [], "/centroids": []}
    kinds = {"/camera_info": CameraInfo, "/centroids": PointCloud2}
    for topic, _, _, raw in raw_messages(bag):
        found[topic].append(deserialize_message(raw, kinds[topic]))
    with open_bench() as bench:
        client = IdentifyClient(bench)
        enus = bench.inbox(Imu, "imu_enu")
        bench.start(IdentifyNode, TOLD)
        outbox = bench.connected_outbox(CameraInfo, "camera_info")
        client.connect()
        bench.until(lambda: enus.n_publishers, "publisher of imu_enu")
        outbox.publish(found["/camera_info"][0])
        frames = iter(found["/centroids"])
        while burst := list(islice(frames, BURST)):
            for frame in burst:
                client.publish(frame)
            last = stamp_ns(burst[-1].header)
            bench.until(lambda last=last: enus.at(last), "imu_enu")
        bench.until(lambda: len(client.attitudes.messages) == N_FRAMES, "attitudes")
    return enus.messages, client.attitudes.messages


def test_each_frame_of_the_night_is_answered_under_its_stamp(played):
    stamps = [START_NS + n * EVERY_S * 10**9 for n in range(N_FRAMES)]
    for messages in played:
        assert [stamp_ns(message.header) for message in messages] == stamps


def test_imu_enu_stays_within_its_covariance(played):
    found = [earth_attitude_from_imu(message) for message in played[0]]
    errors = np.array([
        Rotation.from_matrix(POSE.T @ one.rotation).as_rotvec() for one in found
    ])
    inverses = [np.linalg.inv(one.covariance_rad2) for one in found]
    nees = np.einsum("ni,nij,nj->n", errors, inverses, errors)
    # All frames together, and each alone, within what chance leaves in 0.1 % of nights. Less by a
    # quarter: refraction is uneven across the field, which widens residuals and covariance.
    assert 0.6 < nees.mean() / 3 < chi2.ppf(1 - 5e-4, 3 * N_FRAMES) / (3 * N_FRAMES)
    assert nees.max() < chi2.ppf(1 - 1e-3 / N_FRAMES, 3)
    # No drift: the mean of each hour is as near as its 60 frames make it.
    hours = errors[:-1].reshape(HOURS, -1, 3).mean(axis=1)
    sigma = np.sqrt(np.mean([np.diag(one.covariance_rad2) for one in found], axis=0) / 60)
    assert np.abs(hours / sigma).max() < 4


def test_attitude_turns_at_the_sidereal_rate(played):
    """Each minute by 15 minutes of arc about the Earth's axis: 90 deg 15' in all."""
    turned = Rotation.from_quat([array_from_quaternion(message) for message in played[1]])
    steps = (turned[1:] * turned[:-1].inv()).as_rotvec()
    each = EARTH_RATE_RAD_PER_S * EVERY_S / ARCSEC
    assert steps[:, 2].mean() / ARCSEC == pytest.approx(each, abs=0.3)
    whole = (turned[-1] * turned[0].inv()).as_rotvec()
    # Refraction puts the same rotation into each, but for where the stars lie in the field.
    assert np.linalg.norm(whole) / ARCSEC == pytest.approx(each * (N_FRAMES - 1), abs=60)
    assert np.degrees(np.arccos(whole[2] / np.linalg.norm(whole))) < 0.2
