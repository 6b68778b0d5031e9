"""`star_tracker make-bag`: the star maps as a bag that `ros2 bag play` streams. No ROS."""

import argparse
from pathlib import Path

from star_tracker.bags.recording import Recording, record_maps
from star_tracker.bags.writing import STORAGES, new_bag
from star_tracker.commands.options import add_json_argument, check_positive, json_text
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.maps.star_map import paper_maps


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the bag, the maps and how they become frames."""
    parser.add_argument(
        "output", type=Path, metavar="OUTPUT",
        help="the bag; a name in .mcap or .db3 is one file, any other a folder that is new",
    )
    add_json_argument(parser)
    parser.add_argument(
        "--maps", default="1,2,3,4,5,6,7,8", metavar="N,N", help="numbers, in order (%(default)s)"
    )
    parser.add_argument(
        "--images", action="store_true",
        help="images rendered of the maps' sky in place of their centroids",
    )
    parser.add_argument(
        "--storage", choices=tuple(STORAGES), help="of a bag that is a folder (mcap)"
    )
    parser.add_argument(
        "--rate-hz", type=float, default=10.0, metavar="HZ",
        help="frames a second, Hz (%(default)s)",
    )
    parser.add_argument(
        "--frame-id", default="camera", metavar="NAME", help="of the headers (%(default)s)"
    )
    parser.add_argument(
        "--bits", type=int, default=12, metavar="N",
        help="bits of an image's pixels; up to 8 give mono8, more mono16 (%(default)s)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N",
        help="of the images' noise, each has one more than the one before (%(default)s)",
    )


def execute(options: argparse.Namespace) -> None:
    """Write the bag. Raises ValueError for what cannot be used."""
    check_positive(options, "rate_hz")
    try:
        numbers = tuple(int(word) for word in options.maps.split(","))
    except ValueError as error:
        raise ValueError(
            f"--maps {options.maps!r} is no list of numbers: give some of 1 to 8, such as 1,2"
        ) from error
    maps = paper_maps(numbers)
    rendered = RenderSettings(bits=options.bits, seed=options.seed) if options.images else None
    recording = Recording(options.rate_hz, options.frame_id, rendered)
    with new_bag(options.output, options.storage) as writer:
        record_maps(writer, maps, recording)
    what = "images" if options.images else "centroids"
    if options.json:
        print(json_text({
            "output": str(options.output), "maps": list(numbers), "frames": what,
            "messages": writer.n_written,
        }))
    else:
        n_maps = f"{len(maps)} map{'s' if len(maps) > 1 else ''}"
        print(f"{options.output}: {what} of {n_maps}, {writer.n_written} messages")
