"""From an image to its attitude: latency, CPU and lost images, composed and as processes.

    python benchmark/camera_cost.py [--seconds 20] [--repeat 1] [--exact]

A driver (this process) publishes rendered images and their camera_info at a fixed rate. Once
centroid_node and identify_node are processes of their own, so that with the driver there are
three; once they are composed in one. Latency is from the driver's call that publishes an image to
its receiving the attitude. CPU is that of the nodes, in percent of one core, without the driver's.
With `--exact` the camera is taken at its word: identify_node learns nothing of it, which takes it
most of its time. An image is lost if it is neither answered by `solution` nor counted as dropped
by either node. Wall time depends on what else the machine does: compare the rows of one run.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

from dataclasses import replace

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from node_cost import cpu_s

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.render import render
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.health import report_from_status
from star_tracker.msg_adapters.image import Picture, image_from_picture
from star_tracker.msg_adapters.stamp import nanoseconds_from_header
from star_tracker.nodes.sky_parameters import SkyImageParameters
from star_tracker.optics.camera import PIXEL_ORIGINS

#: Size, field of view, encoding and rate of each stream.
STREAMS = {
    "640 x 480, 50 Hz": (SkyImageParameters(rate_hz=50.0), "mono8"),
    "1936 x 1216, 10 Hz": (
        SkyImageParameters(rate_hz=10.0, width_px=1936, height_px=1216), "mono16"
    ),
}
#: How the nodes are started: the modules of each process.
WAYS = {"three processes": ("centroid_node", "identify_node"), "composed": ("camera_to_attitude",)}
_N_IMAGES, _RATE_DEG_S = 8, 0.05
_TIMEOUT_S, _WARM_UP = 120.0, 20


class Driver(Node):
    """Publishes images, and notes when their attitudes come."""

    def __init__(self, images: Sequence[Image], infos: Sequence[CameraInfo]) -> None:
        super().__init__("driver")
        self._messages = list(zip(images, infos, strict=True))
        self.sent: dict[int, float] = {}
        self.latency_ms: dict[int, float] = {}
        self.solutions: set[int] = set()
        #: Images that each node says it dropped, and how often it has said so.
        self._dropped = {"centroid_node: images": 0, "identify_node: health": 0}
        self._n_reports = dict.fromkeys(self._dropped, 0)
        self.create_subscription(QuaternionStamped, "attitude", self._on_attitude, 100)
        self.create_subscription(DiagnosticArray, "solution", self._on_solution, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 100)
        qos = QoSProfile(depth=5)
        self._images = self.create_publisher(Image, "image", qos)
        self._infos = self.create_publisher(CameraInfo, "camera_info", qos)

    @property
    def connected(self) -> bool:
        """Whether the chain listens and speaks."""
        heard = [p.get_subscription_count() for p in (self._images, self._infos)]
        return min(heard) > 0 and self.count_publishers("attitude") > 0

    @property
    def dropped(self) -> int:
        """Images that the nodes say they dropped."""
        return sum(self._dropped.values())

    @property
    def n_reports(self) -> int:
        """How often both nodes have said so."""
        return min(self._n_reports.values())

    def send(self) -> None:
        """Publish the next image."""
        image, info = self._messages[len(self.sent) % len(self._messages)]
        stamp = self.get_clock().now().to_msg()
        image.header.stamp = info.header.stamp = stamp
        self.sent[nanoseconds_from_header(image.header)] = time.monotonic()
        self._infos.publish(info)
        self._images.publish(image)

    def _on_attitude(self, message: QuaternionStamped) -> None:
        stamp = nanoseconds_from_header(message.header)
        self.latency_ms[stamp] = 1e3 * (time.monotonic() - self.sent[stamp])

    def _on_solution(self, message: DiagnosticArray) -> None:
        self.solutions.add(nanoseconds_from_header(message.header))

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name in self._dropped:
                self._dropped[status.name] = int(report_from_status(status)[2]["dropped"])
                self._n_reports[status.name] += 1


def messages_of(sky: SkyImageParameters, encoding: str) -> tuple[list[Image], list[CameraInfo]]:
    """Render the stream's images; return the messages of them and of their camera."""
    catalog = StarCatalog.hipparcos(limiting_magnitude=8.0, min_separation_deg=0.0)
    told = replace(sky, encoding=encoding, rate_deg_s=(0.0, _RATE_DEG_S, 0.0), sidereal=False)
    header, camera = Header(frame_id="camera"), told.camera
    images = [
        image_from_picture(Picture(render(
            camera, told.rotation_at(i / told.rate_hz)[0], catalog,
            replace(told.settings, seed=i),
        ).image), encoding, header)
        for i in range(_N_IMAGES)
    ]
    counted = camera.moved(-PIXEL_ORIGINS["center"])
    return images, [info_from_camera(counted, header) for _ in range(_N_IMAGES)]


def spin_until(
    executor: SingleThreadedExecutor, condition: Callable[[], bool], what: str
) -> None:
    """Spin until a condition holds. Raises TimeoutError."""
    stop = time.monotonic() + _TIMEOUT_S
    while not condition():
        executor.spin_once(timeout_sec=0.02)
        if time.monotonic() > stop:
            raise TimeoutError(what)


def stream(driver: Driver, executor: SingleThreadedExecutor, rate_hz: float, n: int) -> None:
    """Publish n images at a rate."""
    next_s = time.monotonic()
    for _ in range(n):
        driver.send()
        next_s += 1 / rate_hz
        while (left_s := next_s - time.monotonic()) > 0:
            executor.spin_once(timeout_sec=left_s)


def started(stack: ExitStack, way: str, told: Sequence[str]) -> list[subprocess.Popen[bytes]]:
    """Start the nodes, which end with the stack, and tell identify_node something."""
    running = [
        stack.enter_context(subprocess.Popen([
            sys.executable, "-m", f"star_tracker.nodes.{module}", "--ros-args", "--log-level",
            "warn", *([] if module == "centroid_node" else told),
        ])) for module in WAYS[way]
    ]
    for process in running:
        stack.callback(process.terminate)
    return running


def warm_up(driver: Driver, executor: SingleThreadedExecutor) -> None:
    """Send the first images, which wait for compiled code and do not count."""
    spin_until(executor, lambda: driver.connected, "the nodes do not listen")
    while len(driver.latency_ms) < _WARM_UP:
        stream(driver, executor, 5.0, 1)
    spin_until(executor, lambda: driver.solutions >= {max(driver.sent)}, "no last answer")


def dropped_by_now(driver: Driver, executor: SingleThreadedExecutor) -> int:
    """Return how many images the nodes say they dropped, in reports that began from now on."""
    seen = driver.n_reports
    spin_until(executor, lambda: driver.n_reports > seen + 1, "no report")
    return driver.dropped


def measure(way: str, name: str, options: argparse.Namespace) -> str:
    """Run the nodes on a stream and return its line of the table."""
    sky, encoding = STREAMS[name]
    images = messages_of(sky, encoding)
    told = ["-p", "use_camera_info:=true"]
    if options.exact:
        told += ["-p", "camera_info_tolerance_percent:=0.0"]
    with ExitStack() as stack:
        running = started(stack, way, told)
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        driver, executor = Driver(*images), SingleThreadedExecutor()
        executor.add_node(driver)
        stack.callback(driver.destroy_node)
        warm_up(driver, executor)
        warm, dropped = set(driver.sent), dropped_by_now(driver, executor)
        before, begun = sum(cpu_s(p.pid) for p in running), time.monotonic()
        stream(driver, executor, sky.rate_hz, round(options.seconds * sky.rate_hz))
        cpu = 100 * (sum(cpu_s(p.pid) for p in running) - before) / (time.monotonic() - begun)
        n_dropped = dropped_by_now(driver, executor) - dropped
        sent = set(driver.sent) - warm
        latency = [driver.latency_ms[stamp] for stamp in sent if stamp in driver.latency_ms]
        answered = len(driver.solutions & sent)
    p50, p95 = np.percentile(latency, [50, 95])
    return (
        f"{name:<20} {way:<16} {len(sent):5d} {answered:8d} {len(latency):6d} {n_dropped:7d} "
        f"{len(sent) - answered - n_dropped:4d} {p50:7.1f} {p95:7.1f} {cpu:6.1f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each stream, s")
    parser.add_argument("--repeat", type=int, default=1, help="runs of each row")
    parser.add_argument("--exact", action="store_true", help="the camera is known exactly")
    options = parser.parse_args()
    print(
        f"{'stream':<20} {'nodes':<16}  sent answered solved dropped lost  p50 ms  p95 ms  CPU %"
    )
    for name in STREAMS:
        for _ in range(options.repeat):
            for way in WAYS:
                print(measure(way, name, options), flush=True)


if __name__ == "__main__":
    main()
