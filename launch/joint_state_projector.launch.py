"""Start the node: ros2 launch mbd_ros joint_state_projector.launch.py scene:=..."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The node with the parameter file of the package and the scene of the user."""
    share = FindPackageShare("mbd_ros")
    leg = PathJoinSubstitution([share, "config", "scenes", "prosthetic_leg.yaml"])
    parameters = PathJoinSubstitution([share, "config", "nodes", "joint_state_projector.yaml"])
    node = LifecycleNode(
        package="mbd_ros",
        executable="joint_state_projector",
        name="joint_state_projector",
        namespace="",
        output="screen",
        parameters=[
            LaunchConfiguration("parameters"),
            {
                "scene": LaunchConfiguration("scene"),
                "use_sim_time": LaunchConfiguration("use_sim_time"),
            },
        ],
        remappings=[("joint_states", LaunchConfiguration("joint_states"))],
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value=leg, description="Scene file"),
            DeclareLaunchArgument("parameters", default_value=parameters),
            DeclareLaunchArgument("joint_states", default_value="joint_states"),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            node,
        ]
    )
