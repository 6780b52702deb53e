"""The stability map finds what is wrong when something is, and nothing when nothing is."""

import json
import re

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.constraints.distance import Distance
from mbd_ros.core.forward.bilateral_system import BilateralSystem
from mbd_ros.core.manifold.assembly import assemble, drift
from mbd_ros.core.rows.pair_rows import PairRows
from mbd_ros.core.state import State
from mbd_ros.core.system import System
from mbd_ros.forces.joint_spring import JointSpring
from mbd_ros.integrators.rk4 import Rk4
from mbd_ros.report.items import Item
from mbd_ros.report.stability import kind as stability
from mbd_ros.report.stability import long_runs
from mbd_ros.report.stability.cases import METHODS, Case
from mbd_ros.report.stability.equations import equations
from mbd_ros.report.stability.extreme_scenes import extremes, mechanism, rods
from mbd_ros.report.stability.motion import Grid
from mbd_ros.report.stability.random_scenes import random_scene
from mbd_ros.report.stability.reference_motion import starting_rate
from mbd_ros.report.stability.scene_text import load
from mbd_ros.report.stability.verdicts import judge
from mbd_ros.report.stability.witness import Witness
from mbd_ros.stabilization.projection import Projection

FOUR_BAR, SPRING = "redundant_rows-closed_1_times", "stiffness-1e3_N_m_at_1_ms"


def kinds(outcome):
    return {cell["method"]: cell["kind"] for cell in outcome["cells"]}


def test_a_clean_row_has_no_wrong_cell_and_every_method():
    found = kinds(stability.run({"row": FOUR_BAR}))
    assert "WRONG" not in found.values()
    assert set(found) == {"equations", *METHODS}
    assert found["dopri5"] == found["dop853"] == "converged"
    assert found["semi_implicit_euler"] == "bounded"


@pytest.mark.parametrize(
    ("part", "row"), [(PairRows, FOUR_BAR), (Distance, "redundant_rows-x09_cranks")]
)
def test_a_wrong_sign_in_a_constraint_drift_is_wrong(monkeypatch, part, row):
    right = part._drift
    monkeypatch.setattr(part, "_drift", lambda self, *given: -right(self, *given))
    outcome = stability.run({"row": row})
    assert kinds(outcome)["equations"] == "WRONG"
    text = next(cell["text"] for cell in outcome["cells"] if cell["method"] == "equations")
    assert "accelerates" in text


@pytest.mark.parametrize("begin", [0.0, 0.1])
def test_a_force_that_is_not_a_number_is_wrong(monkeypatch, begin):
    right = JointSpring.force

    def force(self, data, x):
        return right(self, data, x) * (np.nan if x.t >= begin else 1.0)

    monkeypatch.setattr(JointSpring, "force", force)
    outcome = stability.run({"row": SPRING})
    assert kinds(outcome)["equations"] == "WRONG"
    assert "not finite" in outcome["cells"][0]["text"]
    assert "WRONG" not in list(kinds(outcome).values())[1:]  # those stop, with a reason


def test_a_soft_constraint_is_wrong(monkeypatch):
    """A stiff spring with a damper in place of the rows, and no projection."""

    def soft(self, t, q, v, u=None):
        self.refresh(q, v)
        J = self.constraints.jacobian(self.data, State(t, q, v))
        g = self.constraints.residual(self.data, State(t, q, v))
        return pin.aba(self.model, self.data, q, v, -J.T.dot(1.0e4 * g + 1.0e2 * J.dot(v)))

    monkeypatch.setattr(BilateralSystem, "acceleration", soft)
    monkeypatch.setattr(Projection, "correct", lambda self, system, x: x)
    row = next(row for row in extremes(False) if row.name == FOUR_BAR)
    case = Case(row.load(), Grid(0.02, 4))
    for verdict in (equations(case, ["auto"]), judge(case, "rk4", 0.1)):
        assert verdict.kind == "WRONG"
        assert "open" in verdict.text


def test_an_exception_of_another_kind_is_wrong(monkeypatch):
    def failing(self, t, q, v, u=None):
        if t > 0.05:
            raise ZeroDivisionError("float division by zero")
        return right(self, t, q, v, u)

    right = System.acceleration
    case = Case(mechanism({}, *rods((1.0,)))(), Grid(0.02, 5))
    monkeypatch.setattr(System, "acceleration", failing)
    verdict = judge(case, "rk4", 0.1)
    assert (verdict.kind, verdict.text) == ("WRONG", "ZeroDivisionError: float division by zero")


def test_a_method_that_does_not_converge_to_the_reference_is_wrong(monkeypatch):
    """A method for a weaker gravity is stable, smooth and wrong at every step."""
    case = Case(mechanism({}, *rods((1.0,)))(), Grid(0.05, 6))
    right = Rk4.prepare

    def prepare(self, system, dt):
        acceleration = system.acceleration
        system.acceleration = lambda *given: 0.99 * acceleration(*given)
        return right(self, system, dt)

    assert judge(case, "rk4", dt=0.01).kind == "converged"
    monkeypatch.setattr(Rk4, "prepare", prepare)
    verdict = judge(case, "rk4", dt=0.01)
    assert verdict.kind == "WRONG"
    assert "shorter steps do not help" in verdict.text


def test_garbage_of_a_long_step_is_warned_of():
    row = next(row for row in extremes(False) if row.name == "step-5_x_recommended_arm7_swing")
    case = Case(row.load(), row.grid)
    assert judge(case, "rk4", 5.0).kind == "warned"
    assert judge(case, "dop853", 5.0).kind == "converged"


def test_random_scenes_are_the_same_for_the_same_seed_and_load():
    assert random_scene(7) == random_scene(7)
    assert random_scene(7) != random_scene(8)
    scenes = [load(random_scene(seed)).scene for seed in range(40)]
    assert {len(scene.robot.joints) for scene in scenes} >= {1, 6, 12}
    assert {joint.kind for scene in scenes for joint in scene.robot.joints} == {
        *("revolute", "prismatic", "continuous")
    }
    assert sum(scene.has_loops for scene in scenes) > 5
    assert sum(bool(scene.laws) for scene in scenes) > 5
    assert sum(any(c.bounds is not None for c in scene.constraints) for scene in scenes) > 5
    assert sum(bool(scene.forces) for scene in scenes) > 20


def test_a_batch_of_random_scenes_is_right_and_repeats():
    spec = {"first": 11, "count": 5}
    outcome = stability.run(spec)
    assert not [row for row in outcome["random"] if stability.is_wrong(row)]
    assert all(len(row["cells"]) == 4 for row in outcome["random"])
    assert json.dumps(stability.run(spec)) == json.dumps(outcome)


def test_a_wrong_random_scene_fails_the_report_and_is_kept(monkeypatch):
    right = PairRows._drift
    monkeypatch.setattr(PairRows, "_drift", lambda self, *given: -right(self, *given))
    outcome = stability.run({"first": 1, "count": 1})
    row = outcome["random"][0]
    assert row["scene"] == random_scene(1).scene
    section = stability.section([(Item("stability", "a", {}, 1.0), outcome)])
    assert any("random scene 1" in line and "'first': 1" in line for line in section.wrong)


def test_items_are_many_and_have_names_for_files():
    rows = stability.items([], quick=False)
    assert sum(item.spec.get("count", 0) for item in rows) >= 2000
    names = [item.name for item in rows]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+", name) for name in names)
    assert sum(item.seconds for item in stability.items([], quick=True)) < 60


def test_a_scene_of_a_user_is_run_at_several_steps():
    rows = stability.items(["package://mbd_ros/config/scenes/prosthetic_arm.yaml"], quick=True)
    assert [item.spec["factor"] for item in rows] == [0.1, 1.0, 10.0]
    outcome = stability.run(rows[0].spec)
    assert "WRONG" not in kinds(outcome).values()
    section = stability.section([(rows[0], outcome)])
    assert section.figures["stability_map"] is not None
    assert not section.wrong


def test_no_outcome_is_a_section_too():
    assert stability.section([]).text
    assert long_runs.section([]).text


@pytest.mark.parametrize("seed", [5, 8, 17, 58])
def test_witness_agrees_with_every_tier(seed):
    loaded = load(random_scene(seed))
    witness = Witness(loaded)
    for tier in Case(loaded, Grid(0.001, 1)).tiers("rk4"):
        system = loaded.scene.system(solver={"type": tier})
        y = assemble(system, system.reduce(loaded.scene.initial))
        assert witness.complaints(system, y) == []
        assert witness.violation(system.expand(y)) <= 1e-11
        assert drift(system, y).position <= 1e-11


@pytest.mark.parametrize("method", ["rattle", "dopri5"])
def test_long_runs_keep_energy_and_constraints(method):
    outcome = long_runs.run({"scene": "four_bar", "method": method, "steps": 1000})
    assert outcome["wrong"] == ""
    assert max(outcome["series"]["open"]) < 1e-12
    section = long_runs.section([(Item("long_runs", "a", {}, 1.0), outcome)])
    assert list(section.figures) == ["long_four_bar"]
    assert not section.wrong


def test_a_long_run_that_drifts_is_wrong(monkeypatch):
    monkeypatch.setattr(Projection, "correct", lambda self, system, x: x)
    monkeypatch.setattr(PairRows, "_drift", lambda self, *given: np.zeros(2))
    outcome = long_runs.run({"scene": "four_bar", "method": "dopri5", "steps": 500})
    assert "open" in outcome["wrong"]


def test_starting_rate_of_a_scene_at_rest_is_finite():
    assert 0.0 < starting_rate(mechanism({}, *rods((1.0,)))().scene) < 10.0
