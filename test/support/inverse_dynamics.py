"""Cases that several tests share: inverse dynamics."""

from places import ROOT

from mbd_ros.core.model.coupling_functions import Polynomial, natural_cubic_spline
from mbd_ros.core.model.couplings import Coupling

CONFIG = ROOT / "config"


ARM = (CONFIG / "robots/arm7.urdf").read_text(encoding="utf-8")


CHAIN = {  # joint2 <- joint1 <- joint6 <- joint3: parents further out on the arm
    "joint2": Coupling("joint1", Polynomial([0.2, -0.4, 0.3, 0.1])),
    "joint1": Coupling("joint6", natural_cubic_spline([-2.0, -0.4, 0.5, 2.0], [1, 0.2, 0.4, -1])),
    "joint6": Coupling("joint3", Polynomial([0.0, 0.7, 0.2])),
    "joint4": Coupling("joint5", Polynomial([0.3, -1.5])),
}
