"""Start the node: ros2 launch mbd_ros qp_controller.launch.py scene:=..."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The node with the parameter file of the package and the scene of the user."""
    share = FindPackageShare("mbd_ros")
    arm = PathJoinSubstitution([share, "config", "scenes", "controlled_arm.yaml"])
    parameters = PathJoinSubstitution([share, "config", "nodes", "qp_controller.yaml"])
    node = LifecycleNode(
        package="mbd_ros",
        executable="qp_controller",
        name="qp_controller",
        namespace="",
        output="screen",
        parameters=[
            LaunchConfiguration("parameters"),
            {
                "scene": LaunchConfiguration("scene"),
                "use_sim_time": LaunchConfiguration("use_sim_time"),
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
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            node,
        ]
    )
