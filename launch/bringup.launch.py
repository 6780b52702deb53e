"""A robot that moves by itself: ros2 launch mbd_ros bringup.launch.py.

Simulator, controller, a reference that repeats, inverse dynamics, and robot_state_publisher where
it is installed. The arguments of the included files may be given too.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.action import Action
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, LogInfo
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The loop, what leads it, and what watches it; one scene, namespace and time for all."""
    share = FindPackageShare("mbd_ros")
    arm = PathJoinSubstitution([share, "config", "scenes", "controlled_arm.yaml"])
    urdf = PathJoinSubstitution([share, "config", "robots", "prosthetic_arm.urdf"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value=arm, description="Scene file"),
            DeclareLaunchArgument(
                "urdf", default_value=urdf, description="Robot of that scene, for its frames"
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of nodes and topics"
            ),
            DeclareLaunchArgument(
                "autostart", default_value="true", description="Configure and activate at once"
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Live in the simulated time of /clock, which the simulator publishes",
            ),
            DeclareLaunchArgument(
                "controller",
                default_value="sliding_mode_controller",
                choices=["sliding_mode_controller", "qp_controller"],
                description="Node that controls",
            ),
            *(included(name) for name in ("simulator", "inverse_dynamics")),
            included(LaunchConfiguration("controller")),
            player(),
            frames(),
        ]
    )


def included(name: str | LaunchConfiguration) -> IncludeLaunchDescription:
    """The launch file of a node."""
    files = PathJoinSubstitution([FindPackageShare("mbd_ros"), "launch"])
    path = [files, "/", name, ".launch.py"]
    return IncludeLaunchDescription(PythonLaunchDescriptionSource(path))


def player() -> LifecycleNode:
    """What leads the controller."""
    controller = LaunchConfiguration("controller")
    return LifecycleNode(
        package="mbd_ros",
        executable="reference_player",
        name="reference_player",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[
            {
                "scene": ParameterValue(LaunchConfiguration("scene"), value_type=str),
                "autostart": ParameterValue(LaunchConfiguration("autostart"), value_type=bool),
                "use_sim_time": ParameterValue(
                    LaunchConfiguration("use_sim_time"), value_type=bool
                ),
            }
        ],
        remappings=[
            ("joint_trajectory", [controller, "/joint_trajectory"]),
            ("state", [controller, "/state"]),
        ],
    )


def frames() -> Action:
    """Frames of the links."""
    publisher = "robot_state_publisher"
    try:
        get_package_prefix(publisher)
    except PackageNotFoundError:
        return LogInfo(msg=f"{publisher} is not installed: left out, there are no frames on /tf")
    command = Command(['cat "', LaunchConfiguration("urdf"), '"'])
    return Node(
        package=publisher,
        executable=publisher,
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            {
                "robot_description": ParameterValue(command, value_type=str),
                "use_sim_time": ParameterValue(
                    LaunchConfiguration("use_sim_time"), value_type=bool
                ),
            }
        ],
    )
