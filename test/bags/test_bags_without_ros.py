"""Bags are written and read where there is no ROS, with the same bytes as where there is."""

from bag_files import raw_messages
from processes import completed

#: What a process does: nothing of ROS can be imported in it.
WITHOUT_ROS = """
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top == "rclpy" or top.endswith(("_msgs", "_interfaces")):
            raise ModuleNotFoundError(f"No module named {top!r}", name=top)

sys.meta_path.insert(0, NoRos())
from star_tracker.commands import cli
folder = sys.argv[1]
assert cli.main(["make-bag", f"{folder}/maps.mcap", "--maps", "1,6"]) == 0
assert cli.main(["make-bag", f"{folder}/images.db3", "--images", "--maps", "1"]) == 0
for name in ("maps.mcap", "images.db3"):
    assert cli.main(
        ["solve", "--jobs", "1", "--deadline-ms", "1e9", f"{folder}/{name}",
         "--output-bag", f"{folder}/of-{name}"]
    ) == 0
"""


def test_bags_are_made_and_solved_without_ros(tmp_path, solver_compiled):
    printed = completed("-c", WITHOUT_ROS, tmp_path).stdout.splitlines()
    assert [line.split()[0] for line in printed if not line.startswith(str(tmp_path))] == [
        "SOLVED"
    ] * 3
    topics = [topic for topic, *_ in raw_messages(tmp_path / "of-maps.mcap")]
    assert sorted(set(topics)) == [
        "/attitude", "/boresight_deg", "/identified_stars", "/imu", "/solution"
    ]
    assert len(topics) == 10
    from star_tracker.commands import cli

    here = tmp_path / "here.mcap"
    assert cli.main(["make-bag", str(here), "--maps", "1,6"]) == 0
    assert raw_messages(here) == raw_messages(tmp_path / "maps.mcap")
