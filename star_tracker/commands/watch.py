"""`star_tracker watch`: a live view of a running identify_node, the command that needs ROS."""

import argparse
import sys

from rich.console import Console

from star_tracker.commands.options import check_positive


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--namespace", metavar="NS", default="/", help="namespace of the node (%(default)s)"
    )
    parser.add_argument(
        "--once", action="store_true",
        help="print one view and end, with exit code 2 if nothing was heard",
    )
    parser.add_argument(
        "--json", action="store_true",
        help="print JSON, a line for each frame, with --once one line in all",
    )
    parser.add_argument(
        "--stars", metavar="N", type=int, default=20,
        help="most stars to list; JSON has all (%(default)s)",
    )
    parser.add_argument(
        "--timeout-s", metavar="S", type=float, default=10.0,
        help="how long --once waits for a frame and a report, s (%(default)s)",
    )


def execute(options: argparse.Namespace) -> None:
    """Watch. Raises ValueError where ROS is missing or nothing is heard in time."""
    check_positive(options, "stars", "timeout_s")
    try:
        # Here, as all other commands work without ROS.
        from star_tracker.nodes.watch.node import watch  # noqa: PLC0415
        from star_tracker.nodes.watch.outputs import Once, print_lines, screen  # noqa: PLC0415
        from star_tracker.nodes.watch.record import json_line  # noqa: PLC0415
        from star_tracker.nodes.watch.view import view_of  # noqa: PLC0415
    except ImportError as error:
        raise ValueError(
            f"this command needs ROS 2, which cannot be imported ({error}): source ROS 2 Jazzy, "
            "or run it in an environment that has rclpy"
        ) from error
    console = Console()
    if options.once:
        once = Once(
            lambda watched, now_s: print(json_line(watched, watched.frame)) if options.json
            else console.print(view_of(watched, now_s, options.stars)), options.timeout_s,
        )
        code = watch(once, options.namespace)
        if once.silent:
            raise ValueError(
                f"nothing heard of an identify_node in namespace {options.namespace} within "
                f"{options.timeout_s:g} s: start one, or give its --namespace and ROS_DOMAIN_ID"
            )
    elif options.json:
        code = watch(print_lines, options.namespace)
    elif console.is_terminal:
        with screen(console, options.stars) as draw:
            code = watch(draw, options.namespace)
    else:
        raise ValueError("standard output is no terminal: add --once or --json")
    if code:
        sys.exit(code)
