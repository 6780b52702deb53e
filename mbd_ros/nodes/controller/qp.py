"""Node `qp_controller`: see `controller`."""

from mbd_ros.nodes.controller.laws import OF_QP, parameters
from mbd_ros.nodes.controller.node import ControllerNode


class QpControllerNode(ControllerNode):
    """Tracking by a constrained QP."""

    NAME = "qp_controller"
    PARAMETERS = parameters(OF_QP, "qp_tracking", takes_code=False)
