"""centroid_node in this process: images in, centroids out, whatever the images are like."""

import array
import sys
import threading

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from ros_helpers import health_from_diagnostics, new_header, open_bench, stamp_ns
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.detect import detect_stars
from star_tracker.msg_adapters.detected_stars import detected_from_cloud
from star_tracker.msg_adapters.image import Picture, compressed_from_picture, image_from_picture
from star_tracker.nodes.centroid.detector import Detector
from star_tracker.nodes.centroid.parameters import CENTROID_PARAMETERS, TOPICS
from star_tracker.nodes.centroid.worker import Worker
from star_tracker.nodes.centroid_node import CentroidNode
from star_tracker.nodes.declaring import ParameterError

SIZE = 120
#: Where the stars of the tests' image are, from the outer corner of the first pixel, and how many
#: units their light is.
STARS = np.array([(30.5, 40.5, 9e3), (80.25, 20.75, 6e3), (60.0, 90.0, 4e3), (15.7, 99.2, 3e3)])


def sky(seed=1, dtype=np.uint16):
    """An image of four stars."""
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    light = np.random.default_rng(seed).normal(100.0, 3.0, (SIZE, SIZE))
    for x, y, flux in STARS:
        r2 = (columns - x) ** 2 + (rows - y) ** 2
        light += flux / (2 * np.pi * 1.2**2) * np.exp(-r2 / (2 * 1.2**2))
    return np.clip(np.round(light), 0, np.iinfo(dtype).max).astype(dtype)


GOOD = sky()


def image_of(pixels, encoding="mono16", header=None):
    return image_from_picture(Picture(pixels), encoding, header or new_header("eye"))


class Client:
    """Sends images to a centroid_node and waits for its centroids."""

    def __init__(self, bench, parameters=None, reliability=ReliabilityPolicy.RELIABLE):
        self.bench = bench
        self.clouds = bench.inbox(PointCloud2, "centroids")
        self.node = bench.start(CentroidNode, parameters)
        transport = (parameters or {}).get("image_transport", "raw")
        kind = {"raw": Image, "compressed": CompressedImage}[transport]
        bench.until(lambda: self.clouds.n_publishers, "publisher of centroids")
        self.images = bench.connected_outbox(kind, TOPICS[transport], reliability)
        bench.until_true(lambda: self.node.ready, "detector")

    def send(self, message):
        """Publish an image; return the cloud of its stamp."""
        self.images.publish(message)
        stamp = stamp_ns(message.header)
        self.bench.until(lambda: self.clouds.at(stamp), "centroids")
        (cloud,) = self.clouds.at(stamp)
        return cloud

    def refuse(self, message):
        """Publish an image that is of no use and wait until it is counted."""
        before = self.node.health.refused.total()
        self.images.publish(message)
        self.bench.until_true(
            lambda: self.node.health.refused.total() > before, "count of the image"
        )


@pytest.fixture(scope="module")
def client():
    with open_bench() as bench:
        yield Client(bench)


def test_stamp_and_frame_are_those_of_the_image(client):
    message = image_of(GOOD, header=new_header("left_eye"))
    cloud = client.send(message)
    assert cloud.header == message.header
    names = [field.name for field in cloud.fields]
    assert names == ["x", "y", "intensity", "snr", "peak", "flags"]


def test_pixels_are_counted_from_the_middle_of_the_first_one(client):
    stars = detected_from_cloud(client.send(image_of(GOOD)))
    assert len(stars) == 4
    np.testing.assert_allclose(stars["x"], STARS[:, 0] - 0.5, atol=0.05)
    np.testing.assert_allclose(stars["y"], STARS[:, 1] - 0.5, atol=0.05)
    np.testing.assert_allclose(stars["intensity"], STARS[:, 2], rtol=0.05)


def test_or_from_its_corner():
    with open_bench() as bench:
        stars = detected_from_cloud(Client(bench, {"pixel_origin": "corner"}).send(image_of(GOOD)))
    np.testing.assert_allclose(stars["x"], STARS[:, 0], atol=0.05)
    np.testing.assert_allclose(stars["y"], STARS[:, 1], atol=0.05)


@pytest.mark.parametrize(("encoding", "pixels"), [
    ("mono8", sky(dtype=np.uint8)),
    ("32FC1", GOOD.astype(np.float32)),
    ("bgr8", np.repeat(sky(dtype=np.uint8)[:, :, None], 3, axis=2)),
    ("rgba16", np.dstack([GOOD, GOOD, GOOD, np.full_like(GOOD, 9)])),
])
def test_other_encodings_show_the_same_stars(client, encoding, pixels):
    stars = detected_from_cloud(client.send(image_of(pixels, encoding)))
    np.testing.assert_allclose(stars["x"][:4], STARS[:, 0] - 0.5, atol=0.1)


def test_a_raw_colour_image_is_read_by_its_pattern(client):
    message = image_from_picture(Picture(GOOD, "grbg"), "bayer_grbg16", new_header())
    stars = detected_from_cloud(client.send(message))
    expected = detect_stars(GOOD, bayer="grbg")
    np.testing.assert_array_equal(stars["x"], expected.x_px - 0.5)


def broken(**fields):
    message = image_of(GOOD)
    for name, value in fields.items():
        setattr(message, name, value)
    return message


#: What is of no use, by the reason that it is counted under. The last three can be read, and are
#: answered by no centroids.
USELESS = [
    ("encoding", broken(encoding="yuv422")),
    ("empty", broken(width=0)),
    ("step", broken(step=100)),
    ("data", broken(data=array.array("B", bytes(10)))),
    ("too_large", broken(width=20_000, height=20_000)),
    ("too_small", image_of(np.zeros((1, 1), np.uint8), "mono8")),
    ("uniform", image_of(np.zeros((SIZE, SIZE), np.uint16))),
    ("uniform", image_of(np.full((SIZE, SIZE), 65_535, np.uint16))),
    ("not_finite", image_of(np.full((SIZE, SIZE), np.nan, np.float32), "32FC1")),
]


@pytest.mark.parametrize(("kind", "message"), USELESS)
def test_an_image_of_no_use_is_counted_and_the_next_one_served(client, kind, message):
    before = client.node.health.refused[kind]
    client.refuse(message)
    assert client.node.health.refused[kind] == before + 1
    assert len(detected_from_cloud(client.send(image_of(GOOD)))) == 4


@pytest.mark.parametrize(("pixels", "text"), [
    (np.zeros((1, 1)), "image is 1 x 1 px: a star needs sky around it, 5 x 5 px at the least"),
    (np.zeros((9, 9)), "all pixels of the image are 0: check the lens cap and the exposure"),
    (np.full((9, 9), 255), "all pixels of the image are 255: check exposure and gain"),
    (
        np.full((9, 9), np.nan),
        "image has no pixel that is a finite number: check what the driver publishes",
    ),
])
def test_an_image_that_shows_nothing_is_answered_and_said_why(pixels, text):
    message = image_of(pixels.astype(np.float32), "32FC1")
    answer = Detector(DetectSettings()).detect(_Incoming(message))
    assert len(answer.stars) == 0
    assert answer.trouble == text


class _Incoming:
    """An image as the detector sees it."""

    def __init__(self, message):
        self.message, self.header = message, message.header


def test_noise_without_stars_is_no_trouble():
    noise = np.random.default_rng(2).normal(100, 3, (SIZE, SIZE)).astype(np.float32)
    answer = Detector(DetectSettings()).detect(_Incoming(image_of(noise, "32FC1")))
    assert (len(answer.stars), answer.kind) == (0, "")


def test_each_kind_of_trouble_is_said_once_in_ten_seconds(capfd):
    with open_bench() as bench:
        client = Client(bench)
        for _ in range(3):
            client.refuse(broken(encoding="yuv422"))
        client.refuse(broken(step=100))
    lines = [line for line in capfd.readouterr().err.splitlines() if "[ERROR]" in line]
    assert [line.split("]: ")[1][:14] for line in lines] == ["Image encoding", "Image step 100"]


def test_a_mask_hides_a_star_and_a_dark_frame_what_it_has(tmp_path):
    mask, dark = np.zeros(GOOD.shape, np.uint8), np.zeros(GOOD.shape, np.uint16)
    mask[30:50, 20:40] = 1
    dark[:] = GOOD
    dark[80:, :40] = 100
    np.save(tmp_path / "mask.npy", mask)
    np.save(tmp_path / "dark.npy", dark)
    with open_bench() as bench:
        client = Client(bench, {"mask_file": str(tmp_path / "mask.npy")})
        assert len(detected_from_cloud(client.send(image_of(GOOD)))) == 3
    with open_bench() as bench:
        client = Client(bench, {"dark_file": str(tmp_path / "dark.npy")})
        stars = detected_from_cloud(client.send(image_of(sky(seed=2))))
        np.testing.assert_allclose(stars["x"][0], STARS[3, 0] - 0.5, atol=0.1)
        client.refuse(image_of(GOOD[:100]))
        assert client.node.health.refused["unusable"] == 1


def test_a_mask_that_hides_all_is_refused_in_one_line(tmp_path):
    np.save(tmp_path / "mask.npy", np.full(GOOD.shape, 255, np.uint8))
    with open_bench() as bench, pytest.raises(ParameterError, match="hides every pixel: it has 0"):
        bench.start(CentroidNode, {"mask_file": str(tmp_path / "mask.npy")})


def test_a_mask_that_is_not_there_is_refused_in_one_line(tmp_path):
    with open_bench() as bench, pytest.raises(ParameterError) as caught:
        bench.start(CentroidNode, {"mask_file": str(tmp_path / "none.png")})
    assert str(caught.value) == f"{tmp_path}/none.png cannot be read: there is no such file"


def test_compressed_images_are_read():
    pytest.importorskip("PIL", reason="Pillow is not installed")
    with open_bench() as bench:
        client = Client(bench, {"image_transport": "compressed"})
        message = compressed_from_picture(Picture(GOOD), new_header())
        stars = detected_from_cloud(client.send(message))
        np.testing.assert_allclose(stars["x"], STARS[:, 0] - 0.5, atol=0.05)
        message.data = message.data[:100]
        client.refuse(message)
        assert client.node.health.refused["compressed"] == 1


def test_compressed_without_pillow_is_refused_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with open_bench() as bench, pytest.raises(ParameterError) as caught:
        bench.start(CentroidNode, {"image_transport": "compressed"})
    assert str(caught.value) == (
        "image_transport compressed needs Pillow: apt install python3-pil, or pip install Pillow"
    )


def test_a_best_effort_driver_is_heard():
    with open_bench() as bench:
        client = Client(bench, reliability=ReliabilityPolicy.BEST_EFFORT)
        assert len(detected_from_cloud(client.send(image_of(GOOD)))) == 4


def test_threshold_and_number_change_while_the_node_runs():
    with open_bench() as bench:
        client = Client(bench)
        done = client.node.set_parameters([Parameter("max_stars", value=2)])
        assert done[0].successful
        assert len(detected_from_cloud(client.send(image_of(GOOD)))) == 2
        refused = client.node.set_parameters([Parameter("psf_sigma_px", value=0.1)])
        assert refused[0].reason == (
            "parameter psf_sigma_px is 0.1: it must be 0 (find it out) or from 0.4 to 12 px"
        )


def test_the_newest_image_is_kept_and_the_others_are_counted():
    """The thread is held at the first image until three more have come."""
    seen, done = [], []
    first_is_there, go_on = (threading.Event() for _ in range(2))
    ended = threading.Event()

    def detect(image):
        seen.append(image)
        first_is_there.set()
        assert go_on.wait()
        return image

    def take(answer):
        done.append(answer)
        if len(done) == 2:
            ended.set()

    worker = Worker(lambda: None, detect, take)
    worker.put("first")
    assert first_is_there.wait()
    for image in ("second", "third", "fourth"):
        worker.put(image)
    go_on.set()
    assert ended.wait()
    worker.finish()
    assert seen == done == ["first", "fourth"]
    assert worker.n_overtaken == 2


def test_every_image_is_answered_or_counted_as_dropped():
    """However fast they come: here 30 at once."""
    with open_bench() as bench:
        client = Client(bench)
        client.send(image_of(GOOD))
        messages = [image_of(GOOD) for _ in range(30)]
        for message in messages:
            client.images.publish(message)
        last = stamp_ns(messages[-1].header)
        bench.until(lambda: client.clouds.at(last), "centroids of the last image")
        answered = len(client.clouds.messages)
        health = client.node.health
        assert answered + health.n_dropped == 31
        assert health.refused.total() == 0


def test_health_tells_what_the_images_are_like(client):
    diagnostics = client.bench.inbox(DiagnosticArray, "/diagnostics")
    client.bench.until(lambda: diagnostics.n_publishers, "publisher of diagnostics")
    client.send(image_of(GOOD))
    seen = len(diagnostics.messages)
    client.bench.until(lambda: len(diagnostics.messages) > seen, "report")
    name = f"{client.bench.namespace.lstrip('/')}/centroid_node: images"
    values = health_from_diagnostics(diagnostics.messages[-1], name)
    assert values["stars"] == "4"
    assert values["saturated_stars"] == "0"
    assert float(values["background"]) == pytest.approx(100.0, abs=0.5)
    assert float(values["noise"]) == pytest.approx(3.0, abs=0.5)
    assert float(values["psf_sigma_px"]) == pytest.approx(1.2, abs=0.1)
    assert float(values["latency_p95_ms"]) > 0
    assert {"dropped", "refused", "last_reason", "saturation_level", "images_per_s"} <= set(values)


def test_parameters_are_described():
    assert all(parameter.description for parameter in CENTROID_PARAMETERS)
