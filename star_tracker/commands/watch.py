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
        help="most stars to list, as the screen has room; JSON has all (%(default)s)",
    )
    parser.add_argument(
        "--timeout-s", metavar="S", type=float, default=10.0,
        help="how long --once waits for a frame and a report, s (%(default)s)",
    )


def execute(options: argparse.Namespace) -> None:
    """Watch. Raises ValueError where ROS is missing or nothing is heard in time."""
    check_positive(options, "stars", "timeout_s")
    try:
        _watch(options)
    except KeyboardInterrupt:
        return  # before there was a node, which ends with exit code 0 too


def _watch(options: argparse.Namespace) -> None:
    try:
        # Here, as all other commands work without ROS.
        from star_tracker.nodes.watch import node as watch  # noqa: PLC0415
        from star_tracker.nodes.watch import outputs as watch_outputs  # noqa: PLC0415
        from star_tracker.nodes.watch import record as watch_record  # noqa: PLC0415
    except ImportError as error:
        raise ValueError(
            f"this command needs ROS 2, which cannot be imported ({error}): source ROS 2 Jazzy, "
            "or run it in an environment that has rclpy"
        ) from error
    console = Console()
    if options.once:
        once = watch_outputs.Once(console, options.stars, options.json, options.timeout_s)
        code, elsewhere = watch.watch(once, options.namespace)
        if once.silent:
            raise ValueError(_nothing_heard(options, elsewhere))
    elif options.json:
        code, _ = watch.watch(watch_outputs.Lines(watch_record.json_line), options.namespace)
    elif console.is_terminal:
        with watch_outputs.Screen(console, options.stars) as screen:
            code, _ = watch.watch(screen, options.namespace)
    else:
        code, _ = watch.watch(watch_outputs.Lines(watch_record.plain_line), options.namespace)
    if code:
        sys.exit(code)


def _nothing_heard(options: argparse.Namespace, elsewhere: list[str]) -> str:
    found = " or ".join(f"--namespace {namespace}" for namespace in elsewhere)
    remedy = f"there is one with {found}" if found else "start one, and mind ROS_DOMAIN_ID"
    return (
        f"nothing heard of an identify_node in namespace {options.namespace} within "
        f"{options.timeout_s:g} s: {remedy}"
    )
