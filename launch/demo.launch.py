"""The demo live, in real time: ros2 launch mbd_ros demo.launch.py folder:=demo_out.

`mbd-ros demo arm -o demo_out` makes the folder: scenes, gains, and a bag with the reference, which
`reference_player` sends when the controller listens and answers. What the nodes say is recorded in
`record`. What is not installed (robot_state_publisher, rviz2, ros2 bag) is left out and named.
"""

from datetime import datetime

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from mbd_ros.nodes.launching import shared_file

REFERENCE = "/sliding_mode_controller/joint_trajectory"
RECORDED = (
    *("/joint_states", "/simulator/commands", "/simulator/constraint_forces"),
    *("/simulator/markers", "/sliding_mode_controller/state", REFERENCE),
    *("/inverse_dynamics/joint_torques", "/inverse_dynamics/constraint_forces", "/diagnostics"),
)


def generate_launch_description() -> LaunchDescription:
    """Plant, controller with wrong masses, inverse dynamics, reference, recorder and RViz."""
    arm = shared_file("config", "scenes", "controlled_arm.yaml")
    urdf = shared_file("config", "robots", "prosthetic_arm.urdf")
    layout = shared_file("config", "rviz", "demo.rviz")
    folder = LaunchConfiguration("folder")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "folder", default_value="demo_out", description="What mbd-ros demo made"
            ),
            DeclareLaunchArgument("watched", default_value=arm, description="Undisturbed scene"),
            DeclareLaunchArgument("urdf", default_value=urdf, description="Robot, for its frames"),
            DeclareLaunchArgument(
                "fixed_frame", default_value="torso", description="Frame that stands in RViz"
            ),
            DeclareLaunchArgument(
                "record",
                default_value=f"live_bag_{datetime.now():%Y%m%d_%H%M%S}",
                description="Folder of the recording, which must not exist",
            ),
            *loop(folder),
            *view(layout),
            *recorder(),
        ]
    )


def loop(folder: LaunchConfiguration) -> list[Action]:
    """The closed loop, and the inverse dynamics that watches it."""
    plant, model, gains = (
        PathJoinSubstitution([folder, name])
        for name in ("plant.yaml", "model.yaml", "controller.yaml")
    )
    return [
        LifecycleNode(
            package="mbd_ros",
            executable="simulator",
            name="simulator",
            namespace="",
            output="screen",
            parameters=[{"scene": plant, "rate": 500.0}],
        ),
        LifecycleNode(
            package="mbd_ros",
            executable="sliding_mode_controller",
            name="sliding_mode_controller",
            namespace="",
            output="screen",
            parameters=[gains, {"scene": model}],
            remappings=[("~/commands", "/simulator/commands")],
        ),
        LifecycleNode(
            package="mbd_ros",
            executable="inverse_dynamics",
            name="inverse_dynamics",
            namespace="",
            output="screen",
            parameters=[{"scene": LaunchConfiguration("watched"), "cutoff": 20.0}],
        ),
        LifecycleNode(
            package="mbd_ros",
            executable="reference_player",
            name="reference_player",
            namespace="",
            output="screen",
            parameters=[{"bag": PathJoinSubstitution([folder, "bag"]), "repeat": False}],
            remappings=[
                ("joint_trajectory", REFERENCE),
                ("state", "/sliding_mode_controller/state"),
            ],
        ),
    ]


def view(layout: PathJoinSubstitution) -> list[Action]:
    """Frames of the links, and RViz."""
    command = Command(['cat "', LaunchConfiguration("urdf"), '"'])
    description = {"robot_description": ParameterValue(command, value_type=str)}
    publisher, fixed = "robot_state_publisher", LaunchConfiguration("fixed_frame")
    return [
        *where_installed(
            publisher, Node(package=publisher, executable=publisher, parameters=[description])
        ),
        *where_installed(
            "rviz2",
            Node(package="rviz2", executable="rviz2", arguments=["-d", layout, "-f", fixed]),
        ),
    ]


def recorder() -> list[Action]:
    """What records the topics."""
    record = LaunchConfiguration("record")
    words = ["ros2", "bag", "record", "-s", "mcap", "-o", record, *RECORDED]
    return where_installed("ros2bag", ExecuteProcess(cmd=words))


def where_installed(package: str, action: Action) -> list[Action]:
    """The action, or a line that says what is missing."""
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return [LogInfo(msg=f"{package} is not installed: left out")]
    return [action]
