"""Scenes that two commits are compared on: those of the package, and planted ones.

Planted scenes stand here as text and name robots of the package, so that both commits read the
same ones.
"""

from pathlib import Path
from typing import NamedTuple

_ROBOTS = "package://mbd_ros/config/robots"
_SCENES = "package://mbd_ros/config/scenes"
_ARM7 = f"robot: {{urdf: {_ROBOTS}/arm7.urdf}}\n"
_LEG = f"robot: {{urdf: {_ROBOTS}/prosthetic_leg.urdf}}\n"
_FREE = f"robot: {{urdf: {Path(__file__).with_name('satellite.urdf')}, base: floating}}\n"
_SPUN = "initial: {velocity: {swing: 3.0, twist: -1.0}}\n"
_FOUR_BAR = f"""robot: {{urdf: {_ROBOTS}/four_bar_leg.urdf}}
constraints:
- {{type: loop_closure, kind: point, directions: xz, frame_a: posterior_bar,
   point_a: [-0.007, 0.0, -0.051], frame_b: shank, point_b: [-0.059, 0.0, 0.002]}}
"""
_BENT = """initial:
  position: {hip_flexion: 0.3, knee_anterior: -0.8844343782453666,
    knee_tibial: 0.18630267744763485, knee_posterior: -1.1433094128214365}
"""
_THROWN = (
    "initial: {position: {joint2: 0.5, joint4: 1.2}, velocity: {joint1: 1.0, joint3: -2.0}}\n"
)
_START = "initial: {position: {joint2: 0.5}, velocity: {joint1: 1.0, joint3: -2.0}}\n"
_COUPLED = "couplings: {joint4: {parent: joint2, factor: 0.5}}\n"
_BENT_ANKLE = "couplings: {ankle: {parent: knee, polynomial: [0, 0.1, 0.05]}}\n"
_FREE_METHODS = ("semi_implicit_euler", "rk4", "adams", "dopri5", "dop853", "gauss_legendre")
_ROW_METHODS = (*_FREE_METHODS, "generalized_alpha", "rattle", "shake")


def _method(name: str) -> str:
    return f"integrator: {{type: {name}}}\n"


class Planted(NamedTuple):
    """A scene as text, and how long it runs [s]."""

    text: str
    seconds: float = 0.2


EMBEDDED = {  # file of the package -> seconds
    **{
        f"{_SCENES}/{name}.yaml": 0.2
        for name in (
            "empty",
            "arm7",
            "prosthetic_arm",
            "prosthetic_leg",
            "four_bar_leg",
            "controlled_arm",
            "controlled_four_bar",
        )
    },
    **{
        f"{_SCENES}/benchmark/{name}.yaml": seconds
        for name, seconds in (
            ("a01_pendulum_maximal", 0.2),
            ("a02_four_bars_2", 0.2),
            ("a03_andrews", 0.002),
            ("a04_bricard", 0.1),
            ("a05_governor", 0.02),
            ("p01_spherical_pendulum", 0.2),
            ("s01_parabola", 0.5),
            ("ts_car_axis", 0.05),
            ("x09_cranks", 0.1),
        )
    },
}
PLANTED = {
    "stops": Planted(
        f"{_ARM7}constraints:\n- {{type: joint_stop, joint: joint2, upper: 0.55,\n"
        f"   time_constant: 0.01}}\n{_THROWN}"
    ),
    "stop before loop": Planted(
        _FOUR_BAR.replace(
            "constraints:\n",
            "constraints:\n- {type: joint_stop, joint: ankle, lower: -0.01, upper: 0.01,\n"
            "   time_constant: 0.01}\n",
        )
        + _BENT
    ),
    "qp tier": Planted(f"{_FOUR_BAR}{_BENT}solver: {{type: qp}}\n", 0.05),
    "dry friction": Planted(
        f"{_LEG}constraints:\n- {{type: dry_friction, joint: knee, limit: 2.0,\n"
        "   time_constant: 0.002}\n"
        "initial: {position: {knee: -0.5}}\n"
    ),
    "limited drive": Planted(
        f"{_LEG}constraints:\n- {{type: prescribed_motion, joint: hip_flexion, limit: 30.0,\n"
        "   time_constant: 0.02, harmonic: {amplitude: 0.3, angular_frequency: 6.0}}\n"
    ),
    "exact drive": Planted(
        f"{_ARM7}constraints:\n"
        "- {type: prescribed_motion, joint: joint1, polynomial: [0, 0, 2]}\n"
    ),
    "loads": Planted(
        f"{_ARM7}forces:\n- {{type: joint_spring, joint: joint2, stiffness: 30.0, damping: 0.5}}\n"
        "- {type: joint_friction, joint: joint1, coulomb: 0.4, viscous: 0.05}\n"
        "- {type: point_spring, frame_a: universe, point_a: [0, 0, 1], frame_b: link7,"
        " stiffness: 50.0}\n- {type: gravity_compensation, factor: 0.5}\n" + _THROWN
    ),
    "floating": Planted(_FREE + _SPUN),
    "floating rk4": Planted(f"{_FREE}{_SPUN}integrator: {{type: rk4}}\n"),
    "floating, held": Planted(
        f"{_FREE}{_SPUN}constraints:\n- {{type: frame_anchor, frame: trunk, kind: point,\n"
        "   position: [0, 0, 0]}\n"
    ),
    "floating, coupled": Planted(
        f"{_FREE}couplings: {{twist: {{parent: swing, factor: 0.5}}}}\n"
        "initial: {velocity: {swing: 3.0}}\n"
    ),
    "coupled kkt": Planted(f"{_ARM7}{_COUPLED}{_START}solver: {{type: kkt}}\n"),
    "adaptive": Planted(f"{_ARM7}{_THROWN}integrator: {{type: dop853, tolerance: 1e-9}}\n"),
    "filippov": Planted(
        f"{_LEG}forces:\n- {{type: switching_force, velocity: {{knee: [0, 1]}},\n"
        "   above: {knee: -1.5}, below: {knee: 1.5}}\nintegrator: {type: filippov}\n"
        "initial: {position: {knee: -0.5}}\n"
    ),
    **{f"free {name}": Planted(f"{_ARM7}{_THROWN}{_method(name)}", 0.1) for name in _FREE_METHODS},
    **{
        f"coupled {name}": Planted(f"{_ARM7}{_COUPLED}{_START}{_method(name)}", 0.1)
        for name in _FREE_METHODS
    },
    **{
        f"loop {name}": Planted(f"{_FOUR_BAR}{_BENT}{_method(name)}", 0.05)
        for name in _ROW_METHODS
    },
}
COSTS = {  # what is counted -> the scene
    "aba": Planted(f"{_ARM7}{_THROWN}"),
    "reduced": Planted(_LEG + _BENT_ANKLE),
    "kkt": Planted(f"{_ARM7}{_COUPLED}{_START}solver: {{type: kkt}}\n"),
    "loop": Planted(_FOUR_BAR + _BENT),
    "rk4": Planted(f"{_ARM7}{_THROWN}integrator: {{type: rk4}}\n"),
    "adams": Planted(f"{_ARM7}{_THROWN}integrator: {{type: adams}}\n"),
}
