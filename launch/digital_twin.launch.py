"""Start it: ros2 launch mbd_ros digital_twin.launch.py scene:=..."""

from launch import LaunchDescription
from mbd_ros.nodes.launching import node_launch


def generate_launch_description() -> LaunchDescription:
    """The node with the parameter file of the package and the scene of the user."""
    return node_launch("digital_twin", "joint_states")
