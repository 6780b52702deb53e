"""The stability map finds what is wrong when something is, and nothing when nothing is."""

import json
import re
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.applications.report.items import Item
from mbd_ros.applications.report.stability import kind as stability
from mbd_ros.applications.report.stability import long_runs, reference_motion, verdicts
from mbd_ros.applications.report.stability.kind import equations
from mbd_ros.applications.report.stability.oracle import Oracle
from mbd_ros.applications.report.stability.page import row_label
from mbd_ros.applications.report.stability.reference_motion import Grid, reference, starting_rate
from mbd_ros.applications.report.stability.scene_text import load
from mbd_ros.applications.report.stability.scenes import extremes, mechanism, random_scene, rods
from mbd_ros.applications.report.stability.verdicts import (
    FITTING,
    METHODS,
    VERDICTS,
    Case,
    asked_step,
    chooses_steps,
    fitted,
    is_another,
    judge,
    longest_step,
    room,
    tiers,
)
from mbd_ros.core.dynamics.composed_system import ComposedSystem
from mbd_ros.core.dynamics.kkt import Kkt
from mbd_ros.core.rows.frame_rows import PairRows
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, SceneError, SolveError
from mbd_ros.methods.projection.assembly import assemble, violation
from mbd_ros.parts.constraints.distance import Distance
from mbd_ros.parts.forces.joint_spring import JointSpring
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.parts.stabilization.projection import Projection
from mbd_ros.scene.reading.coupling_entries import coupling_kinds

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


def test_the_oracle_asks_a_constraint_that_it_does_not_know(monkeypatch):
    """Which may read points, as one of another package does."""
    row = next(row for row in extremes(False) if row.name == FOUR_BAR)
    known, moved = Oracle(row.load()), row.load().scene.initial
    monkeypatch.setattr("mbd_ros.applications.report.stability.oracle._KNOWN", {})
    asked = Oracle(row.load())
    moved = moved._replace(q=moved.q + 0.1)
    assert known.violation(moved) > 1e-3
    assert asked.violation(moved) == pytest.approx(known.violation(moved), rel=1e-12)


@pytest.mark.parametrize("begin", [0.0, 0.1])
def test_a_force_that_is_not_a_number_is_wrong(monkeypatch, begin):
    right = JointSpring.force

    def force(self, k, x, u):
        return right(self, k, x, u) * (np.nan if x.t >= begin else 1.0)

    monkeypatch.setattr(JointSpring, "force", force)
    outcome = stability.run({"row": SPRING})
    assert kinds(outcome)["equations"] == "WRONG"
    assert "not finite" in outcome["cells"][0]["text"]
    assert "WRONG" not in list(kinds(outcome).values())[1:]  # those stop, with a reason


def test_a_soft_constraint_is_wrong(monkeypatch):
    """A stiff spring with a damper in place of the rows, and no projection."""

    right, data = Kkt.accelerator, {}

    def soft(self, mode):
        right(self, mode)
        k, rows = self.mechanism.k, self._rigid.constraints
        model = self.mechanism.model
        data[self] = model.createData()

        def accelerate(t, q, v, u, out):
            k.refresh(q, v)
            J, g = rows.jacobian(k, State(t, q, v)), rows.residual(k, State(t, q, v))
            pull = -J.T.dot(1.0e4 * g + 1.0e2 * J.dot(v))
            out[...] = pin.aba(model, data[self], q, v, pull)

        return accelerate

    monkeypatch.setattr(Kkt, "accelerator", soft)
    monkeypatch.setattr(Projection, "correct", lambda self, system, x: x)
    row = next(row for row in extremes(False) if row.name == FOUR_BAR)
    case = Case(row.load(), Grid(0.02, 4))
    for verdict in (equations(case, ["plain"]), judge(case, "rk4", 0.1)):
        assert verdict.kind == "WRONG"
        assert "open" in verdict.text


def test_an_exception_of_another_kind_is_wrong(monkeypatch):
    def failing(self, mode=()):
        accelerate = right(self, mode)

        def fail(t, *given):
            if t > 0.05:
                raise ZeroDivisionError("float division by zero")
            accelerate(t, *given)

        return fail

    right = ComposedSystem.accelerator
    case = Case(mechanism({}, *rods((1.0,)))(), Grid(0.02, 5))
    monkeypatch.setattr(ComposedSystem, "accelerator", failing)
    verdict = judge(case, "rk4", 0.1)
    assert (verdict.kind, verdict.text) == ("WRONG", "ZeroDivisionError: float division by zero")


def test_a_method_that_does_not_converge_to_the_reference_is_wrong(monkeypatch):
    """A method for a weaker gravity is stable, smooth and wrong at every step."""
    case = Case(mechanism({}, *rods((1.0,)))(), Grid(0.05, 6))
    right = Rk4.prepare

    def prepare(self, system, dt):
        accelerate = system.accelerator()

        def weaker(t, q, v, u, out):
            accelerate(t, q, v, u, out)
            out *= 0.99

        system.accelerator = lambda mode=(): weaker
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


def faster(right):
    """All velocities after the start are a million times too large."""

    def motion(*given, **others):
        found = right(*given, **others)
        states = [State(x.t, x.q, x.v * (1.0e6 if k else 1.0)) for k, x in enumerate(found.states)]
        return found._replace(states=states)

    return motion


@pytest.mark.parametrize("method", ["rk4", "dopri5", "gauss_legendre"])
def test_garbage_after_the_start_never_converges(monkeypatch, method):
    """Also where the step is longer than what is known of the motion."""
    case = Case(load(random_scene(1321)), Grid(0.001, 12))
    right, known = judge(case, method, 0.1), case.reference
    case.reference = known._replace(horizon=1)
    blind = judge(case, method, 0.1)
    monkeypatch.setattr(verdicts, "motion", faster(verdicts.motion))
    monkeypatch.setattr(verdicts, "_HALVINGS", 2)
    for case.reference in (known, known._replace(horizon=1)):
        for factor in (0.1, 10.0):
            assert judge(case, method, factor).kind in ("warned", "WRONG")
    assert (blind.kind, blind.error) == ("not comparable", np.inf)
    assert (right.kind, right.error > 0.0) == ("converged", True)


def test_a_run_is_not_led_anywhere_by_shorter_ones_that_cannot_be_compared(monkeypatch):
    """The first run is off by a known error; of those with halved steps nothing is known."""
    case = Case(mechanism({}, *rods((1.0,)))(), Grid(0.05, 6))
    errors = iter([0.01, *[np.inf] * 20])
    right = verdicts._Run._attempt
    monkeypatch.setattr(
        verdicts._Run, "_attempt", lambda self, dt: (right(self, dt)[0], next(errors))
    )
    assert judge(case, "rk4", dt=0.01).kind == "WRONG"


@pytest.mark.parametrize("is_known", [True, False])
def test_a_silent_error_whose_shorter_runs_all_stop(monkeypatch, is_known):
    """Wrong where the reference goes on, not comparable where it stops too."""
    case = Case(mechanism({}, *rods((1.0,)))(), Grid(0.05, 6))
    if not is_known:
        case.reference = case.reference._replace(reason="SolveError: stops at t = 1 s")
    prepare = Rk4.prepare

    def stopping(self, system, dt):
        accelerate = system.accelerator()

        def stop(t, q, v, u, out):
            if dt < 0.009:
                raise SolveError("no acceleration at t = 0 s")
            accelerate(t, q, v, u, out)
            out *= 0.9

        system.accelerator = lambda mode=(): stop
        return prepare(self, system, dt)

    monkeypatch.setattr(Rk4, "prepare", stopping)
    verdict = judge(case, "rk4", dt=0.01)
    assert verdict.kind == ("WRONG" if is_known else "not comparable")
    assert "shorter steps do not help; with steps of" in verdict.text


@pytest.mark.parametrize("rate", [3.0, 23.0, 170.0])
@pytest.mark.parametrize("method", [name for name in METHODS if not chooses_steps(name)])
def test_steps_are_those_of_their_labels_and_differ(method, rate):
    """Every step fits at least twice, none is far from what was asked for, no two are alike."""
    ran, recommended = [], longest_step(method, rate)
    for factor in (0.03, 0.1, 0.3, 1.0, 2.0, 5.0, 10.0):
        longest = min(4.9, max(asked_step(name, rate, factor) for name in METHODS))
        grid = room(Grid(0.01, 12), longest)
        dt = fitted(grid, min(asked_step(method, rate, factor), longest), factor <= 1.0)
        assert FITTING * dt <= grid.span * (1.0 + 1.0e-9)
        quarters = 4.0 * dt / grid.interval
        assert min(abs(quarters - round(quarters)), abs(4.0 / quarters % 1.0 - 0.5) - 0.5) < 1e-6
        assert 0.66 <= dt / min(factor * recommended, longest) <= 1.23
        assert factor > 1.0 or dt <= factor * recommended * (1.0 + 1.0e-9)
        ran.append(dt)
    assert all(b > 1.2 * a for a, b in pairwise(ran) if b < 4.0)


def test_ten_times_the_recommended_step_is_run_at_ten_times():
    outcome = stability.run({"row": "step-10_x_recommended_arm7_swing_coupled"})
    cells = {cell["method"]: cell for cell in outcome["cells"][1:]}
    assert set(cells) == {name for name in METHODS if not chooses_steps(name)}
    assert all(cell["ran"] == pytest.approx(10.0, rel=0.2) for cell in cells.values())
    assert outcome["span"] >= FITTING * max(cell["dt"] for cell in cells.values())
    assert "WRONG" not in kinds(outcome).values()
    assert len({cell["dt"] for cell in cells.values()}) > 4


def test_labels_say_what_was_run_and_compared():
    cells = [{"ran": 0.0}, {"ran": 4.8}, {"ran": 9.0}, {"ran": 7.9}]
    row = {"label": "10 x recommended, arm", "factor": 10.0, "cells": cells}
    row |= {"known_until": 50.0, "span": 600.0}
    assert row_label(row) == "10 x recommended, arm (4.8 to 7.9 x) (compared to 50 of 600 s)"
    assert row_label({**row, "known_until": 600.0, "cells": cells[2:3]}) == row["label"]
    assert not is_another(10.0, 8.5)


def test_a_scene_of_ours_that_cannot_be_built_is_wrong(monkeypatch):
    def failing(text):
        raise SceneError("scene.yaml: joints: no such joint 'j0'")

    monkeypatch.setattr(stability, "load", failing)
    outcome = stability.run({"first": 1, "count": 2})
    section = stability.section([(Item("stability", "a", {"first": 1}, 1.0), outcome)])
    assert len(section.wrong) == 2
    assert "must not stop: SceneError" in section.wrong[0]


@pytest.mark.parametrize(("at", "kind"), [("", "WRONG"), (" at t = 0.1 s", "stopped")])
def test_a_reference_that_stops_is_wrong_unless_it_is_expected_there(monkeypatch, at, kind):
    """Expected stops name their place; a scene of a user may stop anywhere that it names."""
    right = reference_motion.first

    def stopping(scene, grid):
        states = right(scene, grid).states
        return reference_motion.Motion(states[: len(states) // 2], f"SolveError: locked{at}")

    monkeypatch.setattr(reference_motion, "first", stopping)
    row = next(row for row in extremes(False) if row.name == FOUR_BAR)
    assert kinds(stability.extreme_row(row))["equations"] == "WRONG"
    assert kinds(stability.extreme_row(row._replace(stops="locked")))["equations"] == kind
    assert kinds(stability.extreme_row(row._replace(stops="apart")))["equations"] == "WRONG"
    assert kinds(stability.random_row(3))["equations"] == "WRONG"
    user = stability.user_row("package://mbd_ros/config/scenes/prosthetic_arm.yaml", 1.0)
    assert kinds(user)["equations"] == kind


def test_a_map_in_which_most_runs_stop_is_wrong():
    cell = {
        "method": "rk4",
        "factor": 0.1,
        "ran": 0.1,
        "dt": 0.1,
        "tier": "plain",
        "text": "t = 1",
    }
    stopped, converged = ({**cell, "kind": k, "error": 0.1} for k in ("stopped", "converged"))
    item = Item("stability", "a", {"first": 1}, 1.0)
    for stops in (30, 31):
        cells = [*[stopped] * stops, *[converged] * (60 - stops)]
        wrong = stability.section([(item, {"random": [{"seed": 1, "cells": cells}]})]).wrong
        assert bool(wrong) == (stops > 30)


def test_the_page_says_what_cells_and_numbers_mean():
    outcome = stability.run({"row": FOUR_BAR})
    section = stability.section([(Item("stability", "a", {"row": FOUR_BAR}, 1.0), outcome)])
    text = " ".join(section.text)
    assert all(f"{kind}: " in text for kind in VERDICTS)
    assert "power of ten" in text


def test_a_long_smooth_motion_is_known_to_its_end():
    """The second method needs a tolerance of 1e-9 after 100 s."""
    row = next(row for row in extremes(False) if row.label == "pendulum, 10 min")
    found = reference(row.load().scene, Grid(50.0, 5))
    assert (found.horizon, found.second) == (6, "dopri5")


def test_random_scenes_are_the_same_for_the_same_seed_and_load():
    assert random_scene(7) == random_scene(7)
    assert random_scene(7) != random_scene(8)
    scenes = [load(random_scene(seed)).scene for seed in range(40)]
    assert {len(scene.robot.joints) for scene in scenes} >= {1, 6, 12}
    assert {joint.kind for scene in scenes for joint in scene.robot.joints} == {
        *("revolute", "prismatic", "continuous")
    }
    assert sum(scene.has_loops for scene in scenes) > 5
    assert sum(bool(coupling_kinds(scene)) for scene in scenes) > 5
    assert sum(any(not c.law.is_rigid for c in scene.constraints) for scene in scenes) > 5
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
def test_oracle_agrees_with_every_tier(seed):
    loaded = load(random_scene(seed))
    oracle = Oracle(loaded)
    for tier in tiers(loaded.scene, "rk4"):
        system = loaded.scene.system(solver={"type": tier})
        y = assemble(system, system.reduce(loaded.scene.initial))
        assert oracle.complaints(system, y) == []
        assert oracle.violation(system.expand(y)) <= 1e-11
        assert violation(system, y).position <= 1e-11


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


def test_long_runs_have_every_method_on_every_scene():
    rows = long_runs.items([], quick=False)
    assert len(rows) == len(long_runs.LONG_SCENES) * 5
    assert {item.spec["steps"] for item in rows} == {100_000, 1_000_000}


def test_a_long_run_whose_velocities_leave_the_constraints_is_wrong(monkeypatch):
    spec = {"scene": "four_bar", "method": "generalized_alpha", "steps": 500}
    assert long_runs.run(spec)["wrong"] == ""
    monkeypatch.setattr(Oracle, "rate", lambda self, x: 1.0e-3)
    for method in ("rk4", "generalized_alpha"):
        assert "per second" in long_runs.run({**spec, "method": method})["wrong"]


def test_a_long_run_that_stops_at_once_keeps_the_reason(monkeypatch):
    def failing(self, x):
        raise DivergedError("diverged at t = 0 s")

    monkeypatch.setattr(Oracle, "energy", failing)
    outcome = long_runs.run({"scene": "pendulum", "method": "rk4", "steps": 100})
    assert outcome["wrong"] == "stopped: DivergedError: diverged at t = 0 s"
    section = long_runs.section([(Item("long_runs", "a", {}, 1.0), outcome)])
    assert section.wrong == ["pendulum, rk4: stopped: DivergedError: diverged at t = 0 s"]


def test_starting_rate_of_a_scene_at_rest_is_finite():
    assert 0.0 < starting_rate(mechanism({}, *rods((1.0,)))().scene) < 10.0


@pytest.mark.parametrize("family", ["mounted", "gimbal lock"])
def test_far_scenes_and_gimbal_lock_are_held_against_other_equations(family):
    for row in (row for row in extremes(False) if row.family == family):
        assert row.known is not None
        cells = {cell["method"]: cell for cell in stability.extreme_row(row)["cells"]}
        assert all(cell["kind"] != "WRONG" for cell in cells.values())
        assert cells["equations"]["kind"] == "converged"
        assert cells["dop853"]["kind"] == "converged" and cells["dop853"]["error"] <= 1e-7
