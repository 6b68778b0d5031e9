"""The demo: identify_node and replay_node as two processes, and a table of what was found.

`ros2 run star_tracker star_tracker_demo`, or `make demo`. Then a rendered image goes through
sky_image_node, centroid_node and identify_node. The exit code is 0 only if every star of the eight
maps has the paper's number, every boresight is where the map was computed for, and the image's
is that of the truth.
"""

import argparse
import os
import random
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from star_tracker.commands.cli import INTERRUPTED
from star_tracker.commands.compile import compile_solver
from star_tracker.compiled import cache_state
from star_tracker.geometry.spherical import separation, unit_vectors
from star_tracker.identification.labels import StarState
from star_tracker.maps.star_map import StarMap, paper_maps
from star_tracker.nodes.demo_frames import TIMEOUT_S, Collector, Result, Row, process
from star_tracker.nodes.demo_image import collect_image, grade_image
from star_tracker.resources import resource_path

#: Largest boresight error. Rounding to 0.01 px leaves some tenths of an arcsecond; of the seven
#: stars of map 3 three are moved by 2 to 3 px (84 arcsec each), and the fit with them.
_BORESIGHT_LIMIT_ARCSEC = 2.0
_BORESIGHT_LIMIT_MAP3_ARCSEC = 90.0


HEAD = (
    "map", "camera", "right", "ident", "displ", "RA deg", "Dec deg", "roll deg", "error\"",
    "log10 FA", "solve ms",
)
_WIDTHS = (5, 13, 7, 5, 5, 9, 9, 9, 7, 8, 8)


def grade(star_map: StarMap, result: Result) -> Row:
    """Hold a result against what is known about its map."""
    faults = []
    stars = result.stars
    if len(stars) != len(star_map.labels):
        faults.append(f"{len(stars)} stars came back, not {len(star_map.labels)}")
        stars = np.zeros(len(star_map.labels), stars.dtype)
    right = stars["star_number"] == star_map.star_number
    faults += [
        f"{star_map.labels[i]} is star {star_map.star_number[i]}, "
        f"labelled {stars['star_number'][i] or 'nothing'}"
        for i in np.flatnonzero(~right)
    ]
    error = float("nan")
    if result.boresight_deg is None or star_map.pose is None:
        faults.append(f"no attitude: {result.values.get('reason', 'no reason given')}")
    else:
        truth = np.array([star_map.pose.ra_deg, star_map.pose.dec_deg])
        error = 3600 * np.degrees(separation(
            unit_vectors(*np.radians(truth)), unit_vectors(*np.radians(result.boresight_deg[:2]))
        ))
        is_map3 = star_map.name == "map 3"
        limit = _BORESIGHT_LIMIT_MAP3_ARCSEC if is_map3 else _BORESIGHT_LIMIT_ARCSEC
        if not error <= limit:
            faults.append(f"boresight is {error:.1f} arcsec off, more than {limit:g}")
    identified = int((stars["state"] == StarState.IDENTIFIED).sum())
    displaced = int((stars["state"] == StarState.DISPLACED).sum())
    pose = np.full(3, np.nan) if result.boresight_deg is None else result.boresight_deg
    camera = f"{star_map.camera.fov_deg:.0f} deg/{star_map.camera.width_px}"
    cells = (
        star_map.name[-1], camera, f"{right.sum()}/{len(right)}", str(identified), str(displaced),
        *(f"{angle:.4f}" for angle in pose), f"{error:.2f}",
        result.values.get("log10_false_alarms", "-"), result.values.get("solve_ms", "-"),
    )
    return Row(cells, int(right.sum()), identified, displaced, tuple(faults))


def collect(folder: Path | None, rate_hz: float) -> list[Result]:
    """Run both nodes on the maps of `folder` and return what was published, in order of the maps.

    Raises TimeoutError where an answer is missing and RuntimeError where a node fails.
    """
    arguments = ["-p", f"rate_hz:={rate_hz}"]
    if folder is not None:
        arguments += ["-p", f"folder:={folder}"]
    config = str(resource_path("config/fov12.yaml"))
    with ExitStack() as stack:
        stack.enter_context(
            process("identify_node", ["--params-file", config, "-p", "use_camera_info:=true"])
        )
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        collector = Collector(expected=8)
        executor = SingleThreadedExecutor()
        executor.add_node(collector)
        stack.callback(executor.shutdown)
        stack.callback(collector.destroy_node)
        executor.spin_until_future_complete(collector.connected, timeout_sec=TIMEOUT_S)
        if not collector.connected.done():
            raise TimeoutError(f"identify_node did not appear within {TIMEOUT_S:g} s")
        replay = stack.enter_context(process("replay_node", arguments))
        executor.spin_until_future_complete(collector.complete, timeout_sec=TIMEOUT_S)
        if not collector.complete.done():
            raise TimeoutError(
                f"only {len(collector.results)} of 8 maps were answered within {TIMEOUT_S:g} s"
            )
        if (code := replay.wait(timeout=TIMEOUT_S)) != 0:
            raise RuntimeError(f"replay_node ended with exit code {code}")
        return collector.results


def report(maps: Sequence[StarMap], results: Sequence[Result], image: Row) -> bool:
    """Print the table, the image's row last; return whether everything is right."""
    rows = [grade(star_map, result) for star_map, result in zip(maps, results, strict=True)]
    print("\n" + "  ".join(f"{h:>{w}}" for h, w in zip(HEAD, _WIDTHS, strict=True)))
    for row in (*rows, image):
        print("  ".join(f"{c:>{w}}" for c, w in zip(row.cells, _WIDTHS, strict=True)))
    total = sum(len(star_map.labels) for star_map in maps)
    right, identified = sum(r.n_right for r in rows), sum(r.n_identified for r in rows)
    displaced = sum(r.n_displaced for r in rows)
    solved = sum(not row.faults for row in rows)
    print(
        f"\n{solved} of {len(rows)} maps right, {right} of {total} labels equal to the paper's "
        f"({identified} identified, {displaced} displaced)"
    )
    print(f"1 rendered image: {image.n_right} of {image.n_identified} labels right")
    for star_map, row in zip(maps, rows, strict=True):
        for fault in row.faults:
            print(f"WRONG {star_map.name}: {fault}")
    for fault in image.faults:
        print(f"WRONG image: {fault}")
    return solved == len(rows) and not image.faults


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit code."""
    parser = argparse.ArgumentParser(prog="star_tracker_demo", description=__doc__.split("\n")[0])
    parser.add_argument("--folder", type=Path, help="other maps than the shipped ones")
    parser.add_argument("--rate-hz", type=float, default=10.0, help="frames per second")
    options = parser.parse_args(args)
    # A domain of its own on this machine only: other robots are not disturbed, nor disturb.
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randrange(1, 102)))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    try:
        maps = paper_maps(folder=options.folder)
        compile_solver(cache_state())  # so that no node is waited for while it compiles
        results = collect(options.folder, options.rate_hz)
        image = grade_image(*collect_image())
    except (TimeoutError, RuntimeError, ValueError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):  # the latter by SIGTERM
        return INTERRUPTED
    return 0 if report(maps, results, image) else 1


if __name__ == "__main__":
    sys.exit(main())
