"""The baseline of the node benchmark: a bare typed echo on SingleThreadedExecutor."""

import sys

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState


def main() -> int:
    """Echo `joint_states` on `~/joint_torques` until killed."""
    rclpy.init(args=sys.argv)
    node = Node("inverse_dynamics")
    publisher = node.create_publisher(JointState, "~/joint_torques", 10)
    node.create_subscription(
        JointState, "joint_states", publisher.publish, qos_profile_sensor_data
    )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while True:
            executor.spin_once(timeout_sec=1.0)
    except ExternalShutdownException:
        return 0


if __name__ == "__main__":
    sys.exit(main())
