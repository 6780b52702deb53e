"""Node `sliding_mode_controller`: see `controller`."""

from mbd_ros.nodes.controller.laws import OTHERS, parameters
from mbd_ros.nodes.controller.node import ControllerNode


class SlidingModeControllerNode(ControllerNode):
    """Sliding mode, super-twisting and their simpler relatives, or a law of another package."""

    NAME = "sliding_mode_controller"
    PARAMETERS = parameters(OTHERS, "sliding_mode", takes_code=True)
