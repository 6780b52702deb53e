"""Start it: ros2 launch mbd_ros marker_kinematics.launch.py scene:=..."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The node with the parameter file of the package and the scene of the user."""
    share = FindPackageShare("mbd_ros")
    leg = PathJoinSubstitution([share, "config", "scenes", "marked_leg.yaml"])
    parameters = PathJoinSubstitution([share, "config", "nodes", "marker_kinematics.yaml"])
    node = LifecycleNode(
        package="mbd_ros",
        executable="marker_kinematics",
        name="marker_kinematics",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[
            LaunchConfiguration("marker_kinematics_parameters"),
            {
                "scene": ParameterValue(LaunchConfiguration("scene"), value_type=str),
                "autostart": ParameterValue(LaunchConfiguration("autostart"), value_type=bool),
                "use_sim_time": ParameterValue(
                    LaunchConfiguration("use_sim_time"), value_type=bool
                ),
            },
        ],
        remappings=[("markers", LaunchConfiguration("markers"))],
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value=leg, description="Scene file"),
            DeclareLaunchArgument(
                "marker_kinematics_parameters",
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
                "markers",
                default_value="markers",
                description="Topic of the markers",
            ),
            node,
        ]
    )
