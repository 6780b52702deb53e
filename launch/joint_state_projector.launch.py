"""Start it: ros2 launch mbd_ros joint_state_projector.launch.py scene:=..."""

from launch import LaunchDescription
from mbd_ros.nodes.launching import node_launch


def generate_launch_description() -> LaunchDescription:
    """The node with the parameter file of the package and the scene of the user."""
    return node_launch("joint_state_projector", "joint_states")
