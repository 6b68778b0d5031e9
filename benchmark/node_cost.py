"""What identify_node costs: CPU from its start to its first answer, memory and CPU when idle.

    python benchmark/node_cost.py [--idle-s 10] [--repeat 3]

Starts the node as a process with a warm cache (compiled code, and Python's own bytecode, which is
kept even where the environment forbids it), waits until it says that it is ready, sends the
first star map and reads the process's CPU time when the answer is here; then its resident memory
and what it takes of one core while no frame comes. CPU time hardly depends on what else the
machine does; wall time does, and is printed beside it. The rows: the paper's camera and catalogue,
a camera of which only the size is told (the defaults), and one that `camera_info` tells.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.point_cloud import Centroids, cloud_from_centroids
from star_tracker.resources import resource_path

MAP1 = paper_maps((1,))[0]
#: What the node of each row is told.
TOLD = {
    "paper": ("--params-file", str(resource_path("config/fov12.yaml"))),
    "defaults": ("-p", "width_px:=512", "-p", "height_px:=512"),
    "camera_info": ("-p", "use_camera_info:=true"),
}
_TIMEOUT_S = 600.0
#: Where Python may not keep its bytecode it compiles all modules at each start.
_ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


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
        self.answers, self.ready = 0, False
        self.create_subscription(DiagnosticArray, "solution", self._on_solution, 10)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        self._centroids = self.create_publisher(PointCloud2, "centroids", 10)
        self._infos = self.create_publisher(CameraInfo, "camera_info", 10)

    def _on_solution(self, _: DiagnosticArray) -> None:
        self.answers += 1

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "identify_node: health":
                self.ready = not status.message.startswith("starting")

    def connected(self, with_info: bool) -> bool:
        """Whether the node listens, speaks and is ready."""
        wanted = [self._centroids, *([self._infos] if with_info else [])]
        heard = all(p.get_subscription_count() > 0 for p in wanted)
        return self.ready and heard and self.count_publishers("solution") > 0

    def send(self, with_info: bool) -> None:
        """Publish the frame, and before it its camera where that is wanted."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id="camera")
        if with_info:
            self._infos.publish(info_from_camera(MAP1.camera, header))
        self._centroids.publish(cloud_from_centroids(Centroids(MAP1.xy_px), header))

    def spin_until(self, condition: Callable[[], bool], node: subprocess.Popen[bytes]) -> None:
        """Spin until a condition holds. Raises TimeoutError, also where the node has ended."""
        stop = time.monotonic() + _TIMEOUT_S
        while not condition():
            rclpy.spin_once(self, timeout_sec=0.02)
            if time.monotonic() > stop or node.poll() is not None:
                raise TimeoutError("identify_node does not answer")


def measure(name: str, idle_s: float) -> str:
    """Run one node and return its line of the table."""
    with_info, started = name == "camera_info", time.monotonic()
    rclpy.init()
    client = Client()
    with subprocess.Popen([
        sys.executable, "-m", "star_tracker.nodes.identify_node", "--ros-args", *TOLD[name],
        "--log-level", "warn",
    ], env=_ENVIRONMENT) as node:
        try:
            client.spin_until(lambda: client.connected(with_info), node)
            ready_mb = rss_mb(node.pid)
            client.send(with_info)
            client.spin_until(lambda: client.answers > 0, node)
            first_s, wall_s = cpu_s(node.pid), time.monotonic() - started
            client.destroy_node()
            rclpy.shutdown()
            time.sleep(2.0)
            before = cpu_s(node.pid)
            time.sleep(idle_s)
            idle = 100 * (cpu_s(node.pid) - before) / idle_s
            after_mb = rss_mb(node.pid)
        finally:
            node.terminate()
    return (
        f"{name:<11}  {first_s:11.2f}  {wall_s:6.2f}  {idle:7.2f}  {ready_mb:9.0f}  "
        f"{after_mb:9.0f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--idle-s", type=float, default=10.0, help="length of the idle time, s")
    parser.add_argument("--repeat", type=int, default=3, help="nodes of each kind")
    options = parser.parse_args()
    warm = (
        "import star_tracker.nodes.identify_node\n"
        "from star_tracker.commands.compile import exercise_solver\nexercise_solver()\n"
    )
    subprocess.run([sys.executable, "-c", warm], env=_ENVIRONMENT, check=True)
    print("camera       first, CPU s  wall s  idle, %  ready, MB  after, MB")
    for name in TOLD:
        for _ in range(options.repeat):
            print(measure(name, options.idle_s), flush=True)


if __name__ == "__main__":
    main()
