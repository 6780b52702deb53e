"""A bare rclpy timer at 1 kHz: says once per second how late 99 % of its ticks began."""

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.task import Future

PERIOD = 1e-3
LINE = "lateness of 99 % of the ticks: "


def main() -> None:
    """Runs until it is killed."""
    rclpy.init()
    node = rclpy.create_node("timer")
    late: list[float] = []

    def tick() -> None:
        # The timer has moved on to its next tick: rcl keeps it on a grid.
        late.append(PERIOD - 1e-9 * timer.time_until_next_call())
        if len(late) == round(1.0 / PERIOD):
            node.get_logger().info(f"{LINE}{np.percentile(late, 99):.9f}")
            late.clear()

    timer = node.create_timer(PERIOD, tick)
    executor = EventsExecutor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_until_future_complete(Future(), timeout_sec=1.0)


if __name__ == "__main__":
    main()
