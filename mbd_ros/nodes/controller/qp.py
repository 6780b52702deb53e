"""Node `qp_controller`: see `controller`."""

from mbd_ros.nodes.controller.node import ControllerNode
from mbd_ros.nodes.controller.parameters import QP


class QpControllerNode(ControllerNode):
    """Tracking by a constrained QP."""

    NAME = "qp_controller"
    PARAMETERS = QP
