"""Node `sliding_mode_controller`: see `controller`."""

from mbd_ros.nodes.controller import ControllerNode
from mbd_ros.nodes.controller_parameters import SLIDING_MODE


class SlidingModeControllerNode(ControllerNode):
    """Sliding mode, super-twisting and their simpler relatives."""

    NAME = "sliding_mode_controller"
    PARAMETERS = SLIDING_MODE
