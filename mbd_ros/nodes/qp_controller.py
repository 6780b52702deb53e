"""Node `qp_controller`: see `controller`."""

import sys

from mbd_ros.nodes.controller import ControllerNode
from mbd_ros.nodes.controller_parameters import QP
from mbd_ros.nodes.process import run


class QpControllerNode(ControllerNode):
    """Tracking by a constrained QP."""

    NAME = "qp_controller"
    PARAMETERS = QP


def main() -> int:
    """Entry point `qp_controller`."""
    return run(QpControllerNode)


if __name__ == "__main__":
    sys.exit(main())
