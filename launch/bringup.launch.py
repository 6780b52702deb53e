"""A robot that moves by itself: ros2 launch mbd_ros bringup.launch.py.

Simulator, controller, a reference that repeats, inverse dynamics, and robot_state_publisher where
it is installed. The arguments of the included files may be given too.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.action import Action
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, LogInfo
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from mbd_ros.nodes.launching import SHARED, declared, node, shared_file, typed

CONTROLLERS = ["sliding_mode_controller", "qp_controller"]


def generate_launch_description() -> LaunchDescription:
    """The loop, what leads it, and what watches it; one scene, namespace and time for all."""
    urdf = shared_file("config", "robots", "prosthetic_arm.urdf")
    return LaunchDescription(
        [
            *declared(*SHARED),
            DeclareLaunchArgument(
                "urdf", default_value=urdf, description="Robot of that scene, for its frames"
            ),
            DeclareLaunchArgument(
                "controller",
                default_value=CONTROLLERS[0],
                choices=CONTROLLERS,
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
    path = [shared_file("launch"), "/", name, ".launch.py"]
    return IncludeLaunchDescription(PythonLaunchDescriptionSource(path))


def player() -> LifecycleNode:
    """What leads the controller."""
    controller = LaunchConfiguration("controller")
    topics = {name: [controller, f"/{name}"] for name in ("joint_trajectory", "state")}
    return node("reference_player", [], topics, "use_sim_time")


def frames() -> Action:
    """Frames of the links."""
    publisher = "robot_state_publisher"
    try:
        get_package_prefix(publisher)
    except PackageNotFoundError:
        return LogInfo(msg=f"{publisher} is not installed: left out, there are no frames on /tf")
    command = Command(['cat "', LaunchConfiguration("urdf"), '"'])
    description = ParameterValue(command, value_type=str)
    return Node(
        package=publisher,
        executable=publisher,
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            {"robot_description": description, "use_sim_time": typed("use_sim_time", bool)}
        ],
    )
