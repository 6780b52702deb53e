"""Start it: ros2 launch mbd_ros web_view.launch.py scene:=..."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The node with the parameter file of the package and the scene of the user."""
    share = FindPackageShare("mbd_ros")
    arm = PathJoinSubstitution([share, "config", "scenes", "controlled_arm.yaml"])
    parameters = PathJoinSubstitution([share, "config", "nodes", "web_view.yaml"])
    node = LifecycleNode(
        package="mbd_ros",
        executable="web_view",
        name="web_view",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[
            LaunchConfiguration("web_view_parameters"),
            {
                "scene": ParameterValue(LaunchConfiguration("scene"), value_type=str),
                "autostart": ParameterValue(LaunchConfiguration("autostart"), value_type=bool),
                "use_sim_time": ParameterValue(
                    LaunchConfiguration("use_sim_time"), value_type=bool
                ),
            },
        ],
        remappings=[("joint_states", LaunchConfiguration("joint_states"))],
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value=arm, description="Scene file"),
            DeclareLaunchArgument(
                "web_view_parameters",
                default_value=parameters,
                description="Parameter file of this node",
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
                "joint_states",
                default_value="joint_states",
                description="Topic of joint states",
            ),
            node,
        ]
    )
