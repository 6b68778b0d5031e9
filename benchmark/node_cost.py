"""What identify_node costs: CPU from its start to its first answer, memory and CPU when idle.

    python benchmark/node_cost.py [--idle-s 10] [--repeat 3]

Starts the node as a process with a warm cache, sends the first star map once it listens, and reads
the process's CPU time when the answer is here; then its resident memory and what it takes of one
core while no frame comes, without and with `use_camera_info`. CPU time hardly depends on what else
the machine does; wall time does, and is printed beside it.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.point_cloud import Centroids, cloud_from_centroids
from star_tracker.maps.star_map import paper_maps

MAP1 = paper_maps((1,))[0]
_TIMEOUT_S = 600.0


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process so far, user and system, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rss_mb(pid: int) -> float:
    """Return the resident memory of a process, MB."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1e3


class Client(Node):
    """Sends one frame and notices its answer."""

    def __init__(self) -> None:
        super().__init__("node_cost")
        self.answers = 0
        self.create_subscription(DiagnosticArray, "solution", self._on_solution, 10)
        self._centroids = self.create_publisher(PointCloud2, "centroids", 10)
        self._infos = self.create_publisher(CameraInfo, "camera_info", 10)

    def _on_solution(self, _: DiagnosticArray) -> None:
        self.answers += 1

    def first_answer(self, with_info: bool) -> None:
        """Send a frame once the node listens and speaks; return when it is answered."""
        stop = time.monotonic() + _TIMEOUT_S
        wanted = [self._centroids, *([self._infos] if with_info else [])]
        while any(p.get_subscription_count() == 0 for p in wanted) or (
            self.count_publishers("solution") == 0
        ):
            rclpy.spin_once(self, timeout_sec=0.02)
            if time.monotonic() > stop:
                raise TimeoutError("identify_node does not listen")
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id="camera")
        if with_info:
            self._infos.publish(info_from_camera(MAP1.camera, header))
        self._centroids.publish(cloud_from_centroids(Centroids(MAP1.xy_px), header))
        while self.answers == 0:
            rclpy.spin_once(self, timeout_sec=0.05)
            if time.monotonic() > stop:
                raise TimeoutError("the frame is not answered")


def measure(with_info: bool, idle_s: float) -> str:
    """Run one node and return its line of the table."""
    info = str(with_info).lower()
    started = time.monotonic()
    rclpy.init()
    client = Client()
    with subprocess.Popen([
        sys.executable, "-m", "star_tracker.nodes.identify_node", "--ros-args",
        "-p", "parity:=mirrored", "-p", f"use_camera_info:={info}", "--log-level", "warn",
    ]) as node:
        try:
            client.first_answer(with_info)
            first_s, wall_s = cpu_s(node.pid), time.monotonic() - started
            client.destroy_node()
            rclpy.shutdown()
            time.sleep(2.0)
            before = cpu_s(node.pid)
            time.sleep(idle_s)
            idle = 100 * (cpu_s(node.pid) - before) / idle_s
            memory = rss_mb(node.pid)
        finally:
            node.terminate()
    return f"{info:>11}  {first_s:11.2f}  {wall_s:6.2f}  {idle:8.2f}  {memory:6.0f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--idle-s", type=float, default=10.0, help="length of the idle time, s")
    parser.add_argument("--repeat", type=int, default=3, help="nodes of each kind")
    options = parser.parse_args()
    print("camera_info  first, CPU s  wall s  idle, %  RSS, MB")
    for with_info in (False, True):
        for _ in range(options.repeat):
            print(measure(with_info, options.idle_s), flush=True)


if __name__ == "__main__":
    main()
