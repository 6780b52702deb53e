"""A prosthetic leg that differs from its description, for tests of what learns the difference."""

import numpy as np

import mbd_ros as mbd

LEG = "prosthetic_leg"


def worn_leg(smoothing, *more):
    """The leg with friction and with 0.8 kg on its foot, which no description knows.

    `smoothing` [rad/s] is where its dry friction bends; `more` are forces beside it.
    """
    leg = mbd.load_scene(LEG)
    one = leg.robot.inertias()["foot"]
    heavy = (one.mass + 0.8, [0.03, 0.0, -0.05], np.array(one.inertia) + 0.004 * np.eye(3))
    pairs = zip(leg.couplings.independent, (2.5, 2.0, 1.0), (0.6, 0.5, 0.3), strict=True)
    rubbing = [
        {"type": "gear_friction", "joint": j, "coulomb": c, "viscous": d, "smoothing": smoothing}
        for j, c, d in pairs
    ]
    return leg.with_inertias({"foot": heavy}).with_(forces=[*rubbing, *more])
