"""Start the node `simulator`: ros2 launch mbd_ros simulator.launch.py scene:=..."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The node with the parameter file of the package and the scene of the user."""
    share = FindPackageShare("mbd_ros")
    arm = PathJoinSubstitution([share, "config", "scenes", "prosthetic_arm.yaml"])
    parameters = PathJoinSubstitution([share, "config", "nodes", "simulator.yaml"])
    node = LifecycleNode(
        package="mbd_ros",
        executable="simulator",
        name="simulator",
        namespace="",
        output="screen",
        parameters=[
            LaunchConfiguration("parameters"),
            {
                "scene": LaunchConfiguration("scene"),
                "publish_clock": LaunchConfiguration("publish_clock"),
            },
        ],
        remappings=[
            ("joint_states", LaunchConfiguration("joint_states")),
            ("~/commands", LaunchConfiguration("commands")),
        ],
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value=arm, description="Scene file"),
            DeclareLaunchArgument("parameters", default_value=parameters),
            DeclareLaunchArgument("joint_states", default_value="joint_states"),
            DeclareLaunchArgument("commands", default_value="simulator/commands"),
            DeclareLaunchArgument("publish_clock", default_value="false"),
            node,
        ]
    )
