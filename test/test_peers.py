"""Other packages on the same scenes; nothing fails where they are not installed."""

import importlib.util

import numpy as np
import pytest

from mbd_ros.errors import DivergedError
from mbd_ros.report.peers import kind as peers
from mbd_ros.report.peers.contenders import compete, task_of
from mbd_ros.report.peers.text import compose, ratio
from mbd_ros.report.precision.converged import known
from mbd_ros.report.precision.pareto import Point
from mbd_ros.report.precision.reference_problems import SCENES
from mbd_ros.scene import load_scene

needs_mujoco = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None,
    reason="mujoco is not installed: pip install mujoco",
)
needs_drake = pytest.mark.skipif(
    importlib.util.find_spec("pydrake") is None, reason="drake is not installed: pip install drake"
)
TIMES = (0.05, 0.1)


def off(name, run):
    """Largest distance of a peer to the converged motion [rad]."""
    motion = known(f"{SCENES}/{name}.yaml", TIMES)
    states, seconds = run.run(TIMES)
    assert seconds > 0
    pairs = zip(states, motion.states, strict=True)
    return max(np.abs(x.q - theirs.q).max() for x, theirs in pairs)


def task(name):
    return task_of(load_scene(f"{SCENES}/{name}.yaml"))


def test_a_peer_that_is_missing_is_named_with_its_install_line(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert peers.items([], False) == []
    section = peers.section([])
    assert section.tables == () and section.headline == ()
    text = " ".join(section.text)
    assert "pip install mujoco" in text and "pip install drake" in text


def test_ratio_is_taken_at_equal_error():
    ours = [Point(1.0, 1e-4), Point(2.0, 1e-6)]
    theirs = [Point(4.0, 1e-3), Point(40.0, 1e-5), Point(400.0, 1e-7)]
    assert ratio(ours, theirs, 1e-6) == pytest.approx(40.0 * 10**0.5 / 2.0)
    assert ratio(ours, theirs, 1e-8) is None


def outcome_of(*costs):
    """One run a package, all equally precise; costs in ms per simulated s."""
    runs = []
    for package, cost in costs:
        run = {"package": package, "setup": "x", "solver": "auto", "stabilization": None}
        run |= {"integrator": {"type": "rk4"}, "dt": 1e-3, "seconds": 1e-3 * cost, "spread": 0.0}
        runs.append(run | {"position": 5e-7, "configuration": 5e-7})
    return {"runs": runs, "agreement": 1e-12, "check": "x", "setups": [], "span": 0.5}


def test_costs_stand_side_by_side():
    outcome = outcome_of(("mbd_ros", 2.0), ("MuJoCo", 5.0))
    section = compose([("arm7_swing", outcome), ("leg", outcome_of(("mbd_ros", 1.0)))], [])
    table = section.tables[0]
    assert table.title in section.headline
    assert table.columns == ("scene", "span", "error", "mbd_ros", "MuJoCo")
    assert table.rows[1] == ["arm7_swing", "0.5 s", "1e-6", "2 ms", "5 ms, 2.5 x"]
    assert table.rows[2] == ["arm7_swing", "0.5 s", "1e-8", "not reached", "reaches 5.0e-07 only"]
    assert table.rows[4] == ["leg", "0.5 s", "1e-6", "1 ms", "-"]


@pytest.mark.parametrize(
    ("precise", "shown"),
    [
        ((), ["2 ms", "5 ms, 2.5 x"]),
        ((0,), ["≤ 2 ms", "5 ms, ≥ 2.5 x"]),
        ((1,), ["2 ms", "≤ 5 ms, ≤ 2.5 x"]),
        ((0, 1), ["≤ 2 ms", "≤ 5 ms"]),
    ],
)
def test_a_cost_at_more_precision_than_asked_is_marked(precise, shown):
    outcome = outcome_of(("mbd_ros", 2.0), ("MuJoCo", 5.0))
    for i in precise:
        outcome["runs"][i]["position"] = 1e-6 / 3.1
    section = compose([("arm7_swing", outcome)], [])
    assert section.tables[0].rows[1][3:] == shown
    assert any("≤" in text for text in section.text)


def test_runs_that_are_not_repeated_say_nothing_of_the_spread():
    outcome = outcome_of(("mbd_ros", 2.0), ("MuJoCo", 5.0))
    outcome["runs"][0]["spread"], outcome["runs"][1]["spread"] = 0.2, None
    text = compose([("arm7_swing", outcome)], []).text[-1]
    assert "of the 1 runs that were made more than once" in text and "within 20%" in text


class Planted:
    """A contender that ends in what it is told, after a time [s]."""

    package, setup, record = "planted", "x", {}

    def __init__(self, states, seconds):
        self._states, self._seconds = states, seconds

    def run(self, times):
        return self._states, self._seconds


def test_a_run_is_judged_by_all_its_samples_and_by_its_repeats():
    path = f"{SCENES}/arm7_swing.yaml"
    motion = known(path, TIMES)
    lost = [motion.states[0], motion.states[1]._replace(q=np.full(7, np.nan))]
    contenders = [Planted(lost, 1e-3), Planted(motion.states, 1e-3), Planted(motion.states, 9.0)]
    found = compete(load_scene(path), contenders, motion, 3)
    assert found[0]["stopped"] == "far off"  # although its first sample is right
    assert found[1]["spread"] == 0.0 and found[2]["spread"] is None


@pytest.mark.parametrize(("cost", "judged"), [(2.9, "does not hold"), (3.1, "holds")])
def test_a_demand_is_held_against_the_best_peer(cost, judged):
    outcome = outcome_of(("mbd_ros", 1.0), ("MuJoCo", cost), ("Drake", 50.0))
    tables = {table.title: table.rows for table in compose([("arm7_swing", outcome)], []).tables}
    assert tables["Demands"] == [["arm7_swing", "1e-6", f"{cost:.1f}", "3", judged]]
    outcome["runs"][0]["position"] = 1e-3  # less precise than peers
    missed = {t.title: t.rows for t in compose([("arm7_swing", outcome)], []).tables}
    assert missed["Demands"][0][2:] == ["0.0", "3", "does not hold"]
    quick = compose([("arm7_swing", outcome | {"quick": True})], [])
    assert "Demands" not in [table.title for table in quick.tables]


def test_scenes_of_a_user_have_no_peers():
    assert peers.items([f"{SCENES}/arm7_swing.yaml"], False) == []


@needs_mujoco
@pytest.mark.parametrize(
    ("name", "allowed"),
    [("arm7_swing", 1e-8), ("arm7_swing_coupled", 1e-7), ("x02_four_bar_1e-2", 1e-5)],
)
def test_mujoco_runs_the_same_scene(name, allowed):
    """Order 4 at 0.2 ms; constraints are as stiff as MuJoCo takes them."""
    from mbd_ros.report.peers.mujoco_peer import MujocoRun

    assert off(name, MujocoRun(task(name), "mjINT_RK4", 2e-4, 1.0, True)) < allowed


@needs_mujoco
def test_the_stiffest_constraints_that_mujoco_bears_are_tried():
    """A share of 0.34 diverges; 0.38 is closer than twice as soft ones."""
    from mbd_ros.report.peers import mujoco_peer

    coupled = task("arm7_swing_coupled")
    shares = mujoco_peer._SHARES
    best = off("arm7_swing_coupled", run := mujoco_run(coupled, min(shares)))
    assert run.setup == "RK4, T = 0.38 dt, exact diagonal"
    assert best < off("arm7_swing_coupled", mujoco_run(coupled, 2.0 * min(shares)))
    with pytest.raises(DivergedError):
        mujoco_run(coupled, 0.34).run((1.0,))


def mujoco_run(of, share):
    from mbd_ros.report.peers.mujoco_peer import MujocoRun

    return MujocoRun(of, "mjINT_RK4", 1e-3, share, True)


@needs_drake
@pytest.mark.parametrize("fineness", [{"accuracy": 1e-9}, {"dt": 1e-3}])
def test_drake_runs_the_same_scene(fineness):
    from mbd_ros.report.peers.drake_peer import DrakeRun

    run = DrakeRun(task("arm7_swing"), "runge_kutta5", **fineness)
    assert off("arm7_swing", run) < 1e-7
    assert ("fixed" in run.setup) == ("dt" in fineness)


@needs_drake
def test_fixed_steps_are_fixed():
    """Order 5: half the step is 32 times as precise, which error control would not be."""
    from mbd_ros.report.peers.drake_peer import DrakeRun

    arm = task("arm7_swing")
    coarse, fine = (off("arm7_swing", DrakeRun(arm, "runge_kutta5", dt=dt)) for dt in (0.01, 5e-3))
    assert 2**4 < coarse / fine < 2**7


@needs_drake
def test_drake_closes_loops_on_the_world():
    """Its discrete plant has order 1."""
    from mbd_ros.report.peers.drake_peer import DrakeRun

    assert off("x02_four_bar_1e-2", DrakeRun(task("x02_four_bar_1e-2"), "", dt=2e-4)) < 1e-3
