"""Replay the eight star maps into identify_node: `ros2 launch star_tracker replay.launch.py`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from star_tracker.resources import resource_path


def generate_launch_description() -> LaunchDescription:
    """Start both nodes; the end of the replay ends the launch."""
    replay = Node(
        package="star_tracker", executable="replay_node", output="screen",
        parameters=[{
            "rate_hz": ParameterValue(LaunchConfiguration("rate_hz"), value_type=float),
            "loop": ParameterValue(LaunchConfiguration("loop"), value_type=bool),
            "noise_px": ParameterValue(LaunchConfiguration("noise_px"), value_type=float),
        }],
    )
    identify = Node(
        package="star_tracker", executable="identify_node", output="screen",
        parameters=[LaunchConfiguration("params_file"), {"use_camera_info": True}],
    )
    return LaunchDescription([
        DeclareLaunchArgument(
            "params_file", default_value=str(resource_path("config/fov12.yaml")),
            description="parameters of identify_node",
        ),
        DeclareLaunchArgument("rate_hz", default_value="10.0", description="frames per second"),
        DeclareLaunchArgument("loop", default_value="false", description="replay without end"),
        DeclareLaunchArgument("noise_px", default_value="0.0", description="noise added, px"),
        identify,
        replay,
        RegisterEventHandler(
            OnProcessExit(target_action=replay, on_exit=[EmitEvent(event=Shutdown())])
        ),
    ])
