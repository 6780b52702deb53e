"""What joints pass on, as quantities of `mbd-ros predict`."""

import casadi as ca
import numpy as np
import pytest
from prediction_scenes import biped, four_bar

import mbd_ros as mbd
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError
from mbd_ros.features.prediction.modes import build_phase_modes
from mbd_ros.features.prediction.task import predict_task
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads, JointReactions
from mbd_ros.optimal_control.phase_equations import LETTERS, PhaseEquations
from mbd_ros.optimal_control.quantities import Quantities
from mbd_ros.scene.runs.compiling import traced

TILTED = {"type": "applied_wrench", "frame": "shank", "force": [5.0, 1.0, -3.0]}
PUSHED = {
    "external_wrenches": {"push": {"frame": "foot", "expressed_in": "world", "threshold": 0.1}},
    "forces": [TILTED | {"torque": [1.0, 0.0, 0.5], "point": [0.1, 0.0, 0.0]}],
    "robot": {"base": "floating"},
}
# the tendon of a muscle that goes behind the knee while that is bent
BENT = {"joint": "knee", "upper": -0.2}
BACK = [
    {"frame": "femoral_pylon", "xyz": [-0.04, 0.0, -0.2]},
    {"frame": "femoral_pylon", "xyz": [-0.05, 0.0, -0.4], "within": BENT},
    {"frame": "shank", "xyz": [-0.03, 0.01, -0.1]},
]
MUSCLE = {
    "type": "degroote_fregly",
    "name": "hamstrings",
    "path": {"points": BACK},
    "max_isometric_force": 800.0,
    "optimal_fiber_length": 0.2,
    "tendon_slack_length": 0.1,
    "tendon": "rigid",
}
SCENES = {
    "a free base, loads and couplings": lambda: mbd.scene_from(PUSHED, urdf="prosthetic_leg"),
    "a loop": lambda: four_bar()[0],
    "a foot on the ground": lambda: biped()[0],
    "points that come and go": lambda: mbd.scene_from(
        {"muscles": [MUSCLE]}, urdf="prosthetic_leg"
    ),
}


def sensed(scene):
    """The scene with a wrench and an effort sensor in every joint."""
    sensors = {}
    for i, joint in enumerate(scene.robot.joints):
        sensors |= {f"w{i}": {"type": "wrench", "joint": joint.name}}
        sensors |= {f"e{i}": {"type": "effort", "joint": joint.name}}
    return scene.with_(sensors=sensors)


def phase_of(scene):
    """The first phase of a scene, its system and its mode."""
    task = predict_task({"duration": 1.0, "goals": [{"type": "effort"}]}, "predict")
    _, system, mode, _ = build_phase_modes(scene, task)[0]
    return PhaseEquations(traced(scene, system, (), mode).equations), system, mode


@pytest.mark.parametrize("name", SCENES)
def test_loads_and_sensors_are_those_of_newton_and_euler(name):
    """Against the recursion of Pinocchio at random states, accelerations and multipliers."""
    scene = sensed(SCENES[name]())
    robot, rng = scene.robot, np.random.default_rng(0)
    phase, system, mode = phase_of(scene)
    of, sizes = Quantities(phase, scene.sensors), phase.sizes
    every = [of.find(pattern) for pattern in ("w*", "e*", "*.load.*")]
    symbols = [phase.symbols[key] for key in ("t", *LETTERS)]
    results = [ca.densify(ca.vertcat(*(one.value for one in part))) for part in every]
    asked, lifted = ca.Function("asked", symbols, results), _lifting(phase)
    rows = ConstraintRows(system.bilateral.constraints.blocks, robot.model.nv)
    reactions = JointReactions(robot, rows, (), system.loads.forces)
    start = system.reduce(scene.initial)
    for _ in range(3):
        v, a = rng.normal(size=(2, sizes.nv))
        u, lam = rng.normal(size=sizes.nu), rng.normal(size=sizes.m)
        q = system.chart.integrate(start.q, 0.3 * rng.normal(size=sizes.nv))
        z = np.tile([0.4, 0.08], sizes.nz)[: sizes.nz]
        given = (0.0, q, v, z, a, np.zeros(sizes.nz), u, lam)
        wrenches, efforts, passed = (one.full().ravel() for one in asked(*given))
        x, whole = system.expand(State(0.0, q, v, z, mode)), lifted(q, v, a).full().ravel()
        felt = reactions.solve(x, whole, lam, (), u).local
        assert wrenches.reshape(-1, 6) == near(felt)
        axes = [robot.axis(joint) for joint in robot.joints]
        along = np.array([one.dot(axis) for one, axis in zip(felt, axes, strict=True)])
        assert efforts == near(along)
        system.k.refresh(x.q, x.v)
        assert passed.reshape(-1, 6) == near(_loads(scene, system, reactions, x, whole, lam, u))


def near(values):
    """Equal to 1e-11 of the largest component."""
    return pytest.approx(values, abs=1.0e-11 * np.abs(values).max())


def _loads(scene, system, reactions, x, a, lam, u):
    """Of all links in their own axes."""
    loads = JointLoads(scene.robot, reactions, list(scene.muscles))
    if not scene.muscles:
        felt = reactions.solve(x, a, lam, (), u).local[[one.row for one in loads.joint_links]]
        places = [scene.robot.places.points[one.child.number].at for one in loads.joint_links]
        turns = np.array([place.rotation for place in places])
        return (felt.reshape(-1, 2, 3) @ turns).reshape(-1, 6)
    tension = np.array([_tension(one, system.k, x, u) for one in scene.muscles])
    return loads.solve(x, a, tension, np.zeros(0), (), lam)[0]


def _lifting(phase):
    e, symbols = phase.equations, phase.symbols
    lifted = e.coordinates.lifted(ca.vertsplit(symbols["a"]))
    given = [symbols[key] for key in "qva"]
    return ca.Function("lifted", given, [ca.densify(ca.vertcat(*map(ca.SX, lifted)))])


def _tension(muscle, k, x, u):
    length, slope = muscle.path.measured(k, x)
    return muscle.tension(k, x, u, length, slope.dot(x.v))


TRACTION = "shank.load.force_z"
SWING = {"tolerance": 1.0e-4, "mesh": {"degree": 3, "intervals": 15}, "duration": 0.45}
SWING |= {"start": {"hip_flexion.position": -0.35, "knee.position": -0.3, "*.velocity": 0.0}}
SWING |= {"end": {"hip_flexion.position": 0.5, "knee.position": -0.05, "*.velocity": 0.0}}
EFFORT = {"type": "effort"}


def leg():
    """The prosthetic leg with a hinge for a knee."""
    robot = {"locked": {"knee_slide_x": 0.0, "knee_slide_y": 0.0}}
    return mbd.scene_from({"robot": robot}, urdf="prosthetic_leg")


def swing(*goals, **more):
    return leg().predict(SWING | {"goals": [EFFORT, *goals]} | more)


@pytest.fixture(scope="module")
def usual():
    """The leg swings forwards; what its knee passes on is only watched."""
    return swing({"type": "integral", "of": "shank.load.force_?", "weight": 0.0})


def test_a_prediction_has_the_loads_of_its_motion(usual):
    """`mbd-ros loads` of the same motion, whose free body is the shank."""
    theirs = leg().loads(usual, body="shank")["samples"]
    for axis in "xyz":
        found, expected = (
            usual["samples"][f"shank.load.force_{axis}"],
            theirs[f"knee.force_{axis}"],
        )
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1.0e-9 * 100.0)


def test_less_traction_of_a_knee_takes_more_effort(usual):
    """What if the socket may be pulled with four fifths of the force alone?"""
    peak = float(usual["samples"][TRACTION].max())
    spared = swing(bounds={TRACTION: [None, 0.8 * peak]})
    assert spared["samples"][TRACTION].max() < 0.8 * peak * (1.0 + 1.0e-4)
    assert TRACTION in [name for name, *_ in spared.metadata["active"]]
    assert 1.01 * usual.metadata["cost"] < spared.metadata["cost"] < 1.05 * usual.metadata["cost"]


def test_loads_are_tracked_and_asked_for_at_the_end(usual, tmp_path):
    """Those of the usual motion lead back to it; one at the end goes where a goal wants it."""
    usual.to(tmp_path / "usual.csv")
    of = [TRACTION, "shank.load.force_x"]
    goal = {"type": "tracking", "of": of, "file": str(tmp_path / "usual.csv"), "weight": 1.0e3}
    again = swing(goal)
    off = again["samples"][TRACTION] - usual["samples"][TRACTION]
    assert np.sqrt(np.mean(off**2)) < 1.0e-3 * usual["samples"][TRACTION].max()
    ended = swing({"type": "final", "of": TRACTION, "target": 40.0, "weight": 100.0})
    assert ended["samples"][TRACTION][-1] == pytest.approx(40.0, abs=0.1)


def test_what_has_no_load_is_named():
    """A polynomial has no points; forces have no rate of their own."""
    path = {"polynomial": {"joints": {"knee": [-1.0, 1.0]}, "terms": [[0, 0.3], [1, 0.02]]}}
    scene = mbd.scene_from({"muscles": [MUSCLE | {"path": path}]}, urdf="prosthetic_leg")
    task = {"duration": 0.2, "goals": [EFFORT, {"type": "final", "of": TRACTION}]}
    with pytest.raises(MbdError, match=r"hamstrings.*polynomial of joints, so nobody knows where"):
        scene.predict(task)
    with pytest.raises(MbdError, match=f"smoothness: {TRACTION} depends on forces"):
        swing({"type": "smoothness", "of": TRACTION})
