"""Lost-in-space star identification and attitude determination.

The core of this package imports no ROS: numpy and scipy only. ROS 2 stands at the rim, in
`star_tracker.nodes` and in the package `msg_adapters`.
"""
