"""Linear couplings as mimic joints against the elimination that takes any law."""

import dataclasses

import numpy as np
import pytest

from mbd_ros.applications.report.stability.scene_text import joint, link, robot
from mbd_ros.core.dynamics import tiers
from mbd_ros.core.dynamics.reduced import Mimic, Reduced, mimic_model
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.coupling_functions import Linear, Polynomial
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.parts.forces.joint_spring import JointSpring

KINDS = ("continuous", "revolute", "prismatic", "revolute", "prismatic", "continuous")
CHAIN = {"j2": Coupling("j0", Linear(-0.3, 0.1)), "j5": Coupling("j2", Linear(1.7, -0.4))}
PAIR = {"j3": Coupling("j1", Linear(0.5, 1.5)), "j4": Coupling("j1", Linear(0.2))}


def tree(parents=range(-1, 5)):
    """Six joints of all kinds with rotor inertias."""
    rng, elements = np.random.default_rng(3), []
    for i, (kind, parent) in enumerate(zip(KINDS, parents, strict=True)):
        ends = (f"b{parent}" if i else "world", f"b{i}")
        at, rpy, axis = rng.uniform(-0.4, 0.4, (3, 3))
        elements.append(joint(f"j{i}", kind, ends, at, rpy, axis / np.linalg.norm(axis)))
        elements.append(link(f"b{i}", 1.0 + i, rng.uniform(-0.1, 0.1, 3), np.eye(3) * 0.1))
    found = read_robot(robot(*elements))
    model = found.model.copy()
    model.armature = rng.uniform(0.1, 2.0, model.nv)
    return dataclasses.replace(found, model=model)


def loads(robot, stiffness):
    springs = [JointSpring(robot, joint=name, stiffness=stiffness) for name in ("j1", "j2")]
    return Loads(robot.model.nv, springs if stiffness else ())


@pytest.mark.parametrize("stiffness", [0.0, 40.0], ids=["free", "loaded"])
@pytest.mark.parametrize("laws", [CHAIN, PAIR, CHAIN | PAIR], ids=["chain", "pair", "both"])
def test_accelerations_and_multipliers_are_those_of_the_elimination(laws, stiffness, monkeypatch):
    robot = tree()
    couplings = Couplings(robot, laws)
    mimic = build_system(robot, couplings, [], loads(robot, stiffness))
    monkeypatch.setattr(tiers, "mimic_model", lambda *given: None)
    general = build_system(robot, couplings, [], loads(robot, stiffness))
    assert isinstance(mimic._motion, Mimic) and isinstance(general._motion, Reduced)
    rng = np.random.default_rng(5)
    for _ in range(20):
        x = State(0.0, *rng.normal(size=(2, general.nv)))
        x = general.expand(x)
        found, expected = mimic.evaluate(x), general.evaluate(x)
        assert found.a == pytest.approx(expected.a, rel=1e-11, abs=1e-11)
        assert found.lam == pytest.approx(expected.lam, rel=1e-11, abs=1e-11)
        forces = rng.normal(size=(6, 2))
        wanted = expected.respond(forces)
        assert found.respond(forces) == pytest.approx(wanted, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize(
    ("laws", "parents"),
    [
        ({"j2": Coupling("j3", Linear(0.5))}, range(-1, 5)),
        ({"j2": Coupling("j0", Polynomial([0.0, 1.0, 0.2]))}, range(-1, 5)),
        ({f"j{i}": Coupling("j0", Linear(0.5)) for i in range(1, 6)}, range(-1, 5)),
        ({"j1": Coupling("j0", Linear(0.5))}, (-1, 0, 1, 1, 3, 4)),
    ],
    ids=["parent further out", "not linear", "one coordinate left", "branches beyond"],
)
def test_what_has_no_mimic_joint_is_eliminated_as_any_law(laws, parents):
    robot = tree(parents)
    couplings = Couplings(robot, laws)
    assert mimic_model(robot, couplings) is None
    assert isinstance(build_system(robot, couplings, [], loads(robot, 0.0))._motion, Reduced)
