"""Work-precision: front and interpolation, converged motion, and what is found to be wrong."""

import json

import numpy as np
import pytest
from report_runs import RUNS, run_of

from mbd_ros.api import load_scene
from mbd_ros.applications.report.items import Item
from mbd_ros.applications.report.left_out import kind as left_out
from mbd_ros.applications.report.left_out.kind import operations
from mbd_ros.applications.report.precision import kind as precision
from mbd_ros.applications.report.precision.converged import (
    Choice,
    approach,
    compiles,
    formulations,
    known,
    snippet,
)
from mbd_ros.applications.report.precision.kind import between
from mbd_ros.applications.report.precision.reference_problems import PROBLEMS, SCENES
from mbd_ros.applications.report.precision.text import brief, compose, power
from mbd_ros.applications.report.precision.work_precision import Point, cheapest, cost_at, front
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.scene.schema.strict_yaml import read_mapping

PENDULUM = f"{SCENES}/a01_pendulum_maximal.yaml"
TIMES = (0.5, 1.0)
POINTS = [Point(1.0, 1e-2), Point(10.0, 1e-4), Point(20.0, 1e-3), Point(100.0, 1e-6)]


def timeless(outcome):
    """An outcome without what a clock has measured."""
    runs = outcome["runs"]
    return [{k: v for k, v in run.items() if k not in ("seconds", "spread")} for run in runs]


def item(family, quick=True):
    (found,) = [i for i in precision.items([PENDULUM], quick) if i.name.endswith(f".{family}")]
    return found


@pytest.fixture(scope="module")
def rk4():
    work = item("rk4")
    return work, json.loads(json.dumps(precision.run(work.spec)))


def test_compiled_runs_stand_beside_plain_ones_and_agree():
    """Same steps, so the same errors; what takes no native steps has none."""
    runs = precision.run(item("dop853").spec)["runs"]
    errors = {
        solver: {
            (run["dt"], run["integrator"].get("tolerance")): run["position"]
            for run in runs
            if run["solver"] == solver and run["stabilization"] == {"type": "projection"}
        }
        for solver in ("plain", "compiled")
    }
    both = errors["plain"].keys() & errors["compiled"].keys()
    assert len(both) >= 4
    for key in both:
        assert errors["compiled"][key] == pytest.approx(errors["plain"][key], rel=1e-3, abs=1e-11)
    assert not compiles(load_scene(PENDULUM), {"type": "shake"})


def test_front_keeps_what_nothing_beats():
    assert front(POINTS) == [0, 1, 3]
    assert front([*POINTS, Point(5.0, np.nan), Point(0.5, np.inf), Point(1.0, 0.5)]) == [0, 1, 3]
    assert front([]) == []


def test_cost_between_two_runs_follows_a_power_law():
    assert cost_at(POINTS, 1e-3) == pytest.approx(10**0.5)
    assert cost_at(POINTS, 1e-4) == pytest.approx(10.0)
    assert cost_at(POINTS, 1.0) == 1.0  # nothing is known of cheaper runs
    assert cost_at(POINTS, 1e-7) is None


def test_cheapest_run_is_one_that_was_made():
    assert cheapest(POINTS, 1e-3) == 1
    assert cheapest(POINTS, 1e-9) is None


def test_converged_motion_agrees_with_the_closed_form_and_a_second_method():
    motion = known(PENDULUM, TIMES)
    assert motion.published < 1e-12 and motion.agreement < 1e-12 and not motion.is_wrong
    assert motion.check.startswith("gauss_legendre")


def test_errors_of_an_item_are_the_same_twice(rk4):
    work, outcome = rk4
    first = timeless(outcome)
    assert json.dumps(first) == json.dumps(timeless(precision.run(work.spec)))
    done = [run for run in first if "position" in run]
    assert {run["solver"] for run in done} == {"plain", "qp"}
    assert {run["stabilization"]["type"] for run in done} == {"projection", "baumgarte", "none"}
    assert min(run["position"] for run in done) < 1e-6


def test_section_names_the_cheapest_choice_as_lines_of_a_scene(rk4, tmp_path):
    reference = item("reference")
    section = precision.section([(reference, precision.run(reference.spec)), rk4])
    assert section.wrong == [] and set(section.figures) == {"precision_a01_pendulum_maximal"}
    (lines,) = [lines for title, lines in section.snippets.items() if title.endswith("1e-6")]
    file = tmp_path / "chosen.yaml"
    file.write_text(f"{lines}\n", encoding="utf-8")
    assert {"integrator", "dt", "stabilization"} <= set(read_mapping(file))


def test_headline_is_what_to_take_and_what_it_costs():
    known_motion = {"method": "dop853", "check": None, "agreement": 1e-12, "rattle": ""}
    entry = {"times": [1.0], "runs": RUNS, "reference": known_motion}
    failed = {"times": [1.0], "runs": [], "reference": {"failed": "SolveError: no step"}}
    section = compose({"arm": entry, "leg": failed})
    (headline,) = [table for table in section.tables if table.title in section.headline]
    assert headline.columns == ["scene", "span", "error 1e-3", "error 1e-6", "error 1e-9"]
    chosen = "2.5 ms: dop853, tolerance 1e-8, kkt, no stabilization"
    assert headline.rows[0] == ["arm", "1 s", "1 ms: rk4, dt 0.01 s", chosen, "-"]
    assert headline.rows[1][2].startswith("stopped")
    references = section.tables[-1]
    assert references.title == "References" and references.title not in section.headline
    assert references.rows[0] == ["arm", "dop853", "none", "1.0e-12", "-", "-"]
    assert references.rows[1][1] == "stopped: SolveError: no step"
    assert list(section.snippets) == ["arm, error 1e-3", "arm, error 1e-6"]


def test_steps_are_finer_where_a_wanted_error_is_reached():
    """1e-3 between 5 and 2 ms, where 5 ms stopped; 1e-6 between 1 ms and 500 us; 1e-9 nowhere."""
    steps = {0.005: None, 0.002: 6.8e-4, 0.001: 3.2e-5, 5e-4: 6.2e-7, 2e-4: 2.7e-9}
    rungs = [run_of({"type": "adams"}, 1.0, error) | {"dt": dt} for dt, error in steps.items()]
    del rungs[0]["position"]
    rungs.append(run_of({"type": "adams"}, 1.0, 0.0) | {"dt": 1e-4, "left_out": "too long"})
    assert [choice.dt for choice in between(rungs)] == [2.5e-3, 3.2e-3, 4e-3, 6.4e-4, 8e-4]
    assert between(rungs[1:4]) == between(rungs)[3:]  # of the coarsest nothing is known


def test_how_far_times_may_be_off_is_said():
    runs = [{**RUNS[0], "spread": spread} for spread in [0.02] * 98 + [0.5, 0.04, 0.03]]
    text = compose({"arm": {"times": [1.0], "runs": runs}}).text
    assert "99 of 100 runs agree within 4%" in text[-1]
    assert "spread" not in compose({"arm": {"times": [1.0], "runs": []}}).text[-1].lower()


def test_choices_that_are_the_same_are_pasted_once():
    known_motion = {"agreement": 1e-12}
    section = compose({"arm": {"times": [1.0], "runs": RUNS[2:], "reference": known_motion}})
    assert list(section.snippets) == ["arm, error 1e-3 and 1e-6"]


def test_what_a_scene_has_by_itself_is_not_said():
    entry = {"type": "adams", "order": 6}
    assert (
        brief(Choice("plain", {"type": "projection"}, entry, 5e-3)) == "adams order 6, dt 0.005 s"
    )
    assert brief(Choice("qp", {"type": "baumgarte"}, entry, 5e-3)).endswith(", qp, baumgarte")
    assert [power(x) for x in (1e-3, 1e-12, 1.0, 2e-5)] == ["1e-3", "1e-12", "1e0", "2e-5"]


def test_snippet_names_a_formulation_that_is_not_the_usual_one():
    text = snippet(Choice("kkt", {"type": "none"}, {"type": "adams", "order": 6}, 1e-3))
    assert text.splitlines() == [
        "solver: {type: kkt}",
        "stabilization: {type: none}",
        "integrator: {type: adams, order: 6}",
        "dt: 0.001",
    ]


def test_formulations_are_those_that_differ():
    assert formulations(load_scene(PENDULUM)) == ["plain", "qp"]
    coupled = load_scene(f"{SCENES}/arm7_swing_coupled.yaml")
    assert formulations(coupled) == ["plain", "kkt", "qp"]
    assert formulations(load_scene(f"{SCENES}/arm7_swing.yaml")) == ["plain"]


@pytest.mark.parametrize("name", ["a01_pendulum_maximal", "x02_four_bar_1e-2"])
def test_a_wrong_sign_in_a_drift_is_found(name, monkeypatch):
    right = ConstraintRows.accelerations

    def wrong(self, k, x):
        J, drift = right(self, k, x)
        return J, -drift

    path, times = f"{SCENES}/{name}.yaml", TIMES[:1] if name.startswith("a01") else (0.25,)
    assert not approach(load_scene(path), known.__wrapped__(path, times)).is_wrong
    monkeypatch.setattr(ConstraintRows, "accelerations", wrong)
    motion = known.__wrapped__(path, times)
    assert motion.is_wrong  # the published motion
    assert approach(load_scene(path), motion).is_wrong  # and without one


def test_every_problem_is_in_the_report():
    names = {i.name.split(".")[0] for i in precision.items([], False)}
    assert {problem.name for problem in PROBLEMS} <= names


def test_left_out_measures_parts_and_imports():
    (work,) = left_out.items([PENDULUM], True)
    outcome = json.loads(json.dumps(left_out.run(work.spec)))
    assert "distance" in " ".join(outcome["parts"]) and "rclpy" not in outcome["libraries"]
    assert 0 < outcome["rows"] < outcome["step"] and outcome["aba"] < outcome["evaluation"]
    assert outcome["operations_loads"] == 0 < outcome["operations_rows"] < outcome["operations"]
    assert isinstance(work, Item)
    (row,) = left_out.section([(work, outcome)]).tables[0].rows
    assert row[-2:] == ["0", str(outcome["operations_rows"])]


def test_operations_are_those_of_parts_that_are_named():
    leg = load_scene("package://mbd_ros/config/scenes/four_bar_leg.yaml")
    found, bare = operations(leg), operations(leg.without(("forces", "constraints")))
    assert found["operations_loads"] > 0 and found["operations_rows"] > 0
    assert bare["operations_loads"] == bare["operations_rows"] == 0
    assert bare["operations"] < found["operations"] - found["operations_rows"]
    untraced = operations(load_scene(f"{SCENES}/s01_parabola.yaml"))
    assert set(untraced) == {"uncounted"}
