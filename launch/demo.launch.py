"""The demo live, in real time: ros2 launch mbd_ros demo.launch.py folder:=demo_out.

`mbd-ros demo arm -o demo_out` makes the folder: scenes, gains, and a bag with the reference, which
is played to the controller once the nodes are up. What they say is recorded in `record`.
"""

from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, TimerAction
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

REFERENCE = "/sliding_mode_controller/joint_trajectory"
RECORDED = (
    *("/joint_states", "/simulator/commands", "/simulator/constraint_forces"),
    *("/simulator/markers", "/sliding_mode_controller/state", REFERENCE),
    *("/inverse_dynamics/joint_torques", "/inverse_dynamics/constraint_forces", "/diagnostics"),
)
START = 5.0  # s until the nodes are up


def generate_launch_description() -> LaunchDescription:
    """Plant, controller with wrong masses, inverse dynamics, reference, recorder and RViz."""
    share = FindPackageShare("mbd_ros")
    arm = PathJoinSubstitution([share, "config", "scenes", "controlled_arm.yaml"])
    urdf = PathJoinSubstitution([share, "config", "robots", "prosthetic_arm.urdf"])
    layout = PathJoinSubstitution([share, "config", "rviz", "demo.rviz"])
    folder = LaunchConfiguration("folder")
    return LaunchDescription(
        [
            DeclareLaunchArgument("folder", default_value="demo_out"),
            DeclareLaunchArgument("watched", default_value=arm, description="Undisturbed scene"),
            DeclareLaunchArgument("urdf", default_value=urdf),
            DeclareLaunchArgument("fixed_frame", default_value="torso"),
            DeclareLaunchArgument("record", default_value="live_bag", description="New bag"),
            *loop(folder),
            *view(layout),
            *bags(folder),
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
    ]


def view(layout: PathJoinSubstitution) -> list[Action]:
    """Frames of the links, and RViz."""
    command = Command(["cat ", LaunchConfiguration("urdf")])
    description = {"robot_description": ParameterValue(command, value_type=str)}
    publisher, fixed = "robot_state_publisher", LaunchConfiguration("fixed_frame")
    return [
        Node(package=publisher, executable=publisher, parameters=[description]),
        Node(package="rviz2", executable="rviz2", arguments=["-d", layout, "-f", fixed]),
    ]


def bags(folder: LaunchConfiguration) -> list[Action]:
    """What records the topics, and what plays the reference once the nodes are up."""
    bag, record = PathJoinSubstitution([folder, "bag"]), LaunchConfiguration("record")
    recorder = ExecuteProcess(cmd=["ros2", "bag", "record", "-s", "mcap", "-o", record, *RECORDED])
    reference = ExecuteProcess(cmd=["ros2", "bag", "play", bag, "--topics", REFERENCE])
    return [recorder, TimerAction(period=START, actions=[reference])]
