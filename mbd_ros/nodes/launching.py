"""Common code of the launch files; `launch` comes with ROS, and only they import it.

Launch files can be included together, and an argument of one is seen by the next: what has one
name means one thing for all of them.
"""

from collections.abc import Mapping
from typing import Any

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

ARGUMENTS = {  # name -> default, description
    "namespace": ("", "Namespace of nodes and topics"),
    "autostart": ("true", "Configure and activate at once"),
    "use_sim_time": (
        "false",
        "Live in the simulated time of /clock, which the simulator publishes",
    ),
    "joint_states": ("joint_states", "Topic of joint states"),
    "commands": ("simulator/commands", "Topic from the controller to the simulator"),
}
TOPICS = {"joint_states": "joint_states", "commands": "~/commands"}  # argument -> in the node
SHARED = ("namespace", "autostart", "use_sim_time")


def shared_file(*path: str) -> PathJoinSubstitution:
    """A file of the installed package."""
    return PathJoinSubstitution([FindPackageShare("mbd_ros"), *path])


def declared(*names: str) -> list[DeclareLaunchArgument]:
    """Some of `ARGUMENTS`, after the scene."""
    scene = shared_file("config", "scenes", "controlled_arm.yaml")
    return [
        DeclareLaunchArgument("scene", default_value=scene, description="Scene file"),
        *(
            DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in ARGUMENTS.items()
            if name in names
        ),
    ]


def typed(argument: str, value_type: type) -> ParameterValue:
    """An argument as the value of a parameter."""
    return ParameterValue(LaunchConfiguration(argument), value_type=value_type)


def node(name: str, files: list[Any], topics: Mapping[str, Any], clock: str) -> LifecycleNode:
    """A node of this package in the namespace, scene and time of the launch.

    Args:
        name: Of the executable, and of the node.
        topics: Name in the node -> name or argument.
        clock: Its parameter that takes `use_sim_time`.
    """
    arguments = {"scene": typed("scene", str), "autostart": typed("autostart", bool)}
    return LifecycleNode(
        package="mbd_ros",
        executable=name,
        name=name,
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[*files, {**arguments, clock: typed("use_sim_time", bool)}],
        remappings=list(topics.items()),
    )


def node_launch(name: str, *topics: str, clock: str = "use_sim_time") -> LaunchDescription:
    """A node with the parameter file of the package and the scene of the user.

    Args:
        name: Of the executable, and of the node.
        topics: Those of `TOPICS` that are arguments.
        clock: Its parameter that takes `use_sim_time`.
    """
    file = f"{name}_parameters"
    parameters = DeclareLaunchArgument(
        file,
        default_value=shared_file("config", "nodes", f"{name}.yaml"),
        description="Parameter file of this node",
    )
    named = {TOPICS[topic]: LaunchConfiguration(topic) for topic in topics}
    started = node(name, [LaunchConfiguration(file)], named, clock)
    return LaunchDescription([*declared(*SHARED, *topics), parameters, started])
