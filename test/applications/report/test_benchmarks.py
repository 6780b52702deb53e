"""Motion of the benchmark mechanisms against the published one.

Every problem runs for as long as three seconds of computing allow; `make soak` runs the whole.
"""

from typing import NamedTuple

import pytest

from mbd_ros.api import load_scene
from mbd_ros.applications.report.precision.reference_problems import (
    PROBLEMS,
    at_times,
    error,
    reference,
)

BY_NAME = {problem.name: problem for problem in PROBLEMS}


class Run(NamedTuple):
    """How a problem is run: `until` is the last sample of the short test [s], None for all."""

    until: float | None = None
    integrator: dict | None = None
    dt: float | None = None


DOP853 = {"type": "dop853"}
TO_1E12 = {"type": "dop853", "tolerance": 1e-12}
SHORT = {"a02_four_bars_40": 1.0, "a05_governor": 2.0}
DEFAULT = {problem.name: Run(SHORT.get(problem.name)) for problem in PROBLEMS}
BEST = {problem.name: Run(SHORT.get(problem.name), DOP853) for problem in PROBLEMS} | {
    # Every toggle multiplies the rounding error of a stage that falls next to it: few stages
    "a02_four_bars_40": Run(1.0, {"type": "dopri5"}, 5e-3),
    "a05_governor": Run(None, {"type": "gauss_legendre", "stages": 3}, 5e-3),  # stiff
    "x01_light_inner": Run(None, {"type": "dopri5", "tolerance": 1e-12}, 0.05),
    "x02_four_bar_1e-4": Run(None, TO_1E12, 0.05),
    "x02_four_bar_1e-6": Run(None, TO_1E12, 0.05),
    "x06_chain": Run(None, DOP853, 5e-4),
    "s01_parabola": Run(),  # forces switch: the scene's own filippov finds the events
}


def deviation(name, run, whole=False):
    """Error of a run of the scene, and the reference that says how large it may be."""
    problem, scene = BY_NAME[name], load_scene(BY_NAME[name].scene)
    known = reference(problem.reference)
    until = known.times[-1] if whole or run.until is None else run.until
    times = known.times[known.times <= until]
    simulation = scene.simulation(integrator=run.integrator, dt=run.dt)
    states = at_times(simulation.run(scene.initial, times[-1]), times)
    return error(problem, scene.robot, states), known


@pytest.mark.parametrize("name", DEFAULT)
def test_scene_as_it_stands_is_precise_to_low(name):
    found, known = deviation(name, DEFAULT[name])
    assert found <= known.low


@pytest.mark.parametrize("name", BEST)
def test_best_integrator_is_precise_to_high(name):
    found, known = deviation(name, BEST[name])
    assert found <= known.high


@pytest.mark.soak
@pytest.mark.parametrize("name", [name for name, run in DEFAULT.items() if run.until])
def test_scene_as_it_stands_is_precise_to_low_over_the_whole_time(name):
    found, known = deviation(name, DEFAULT[name], whole=True)
    assert found <= known.low


@pytest.mark.soak
@pytest.mark.parametrize("name", [name for name, run in BEST.items() if run.until])
def test_best_integrator_is_precise_to_high_over_the_whole_time(name):
    found, known = deviation(name, BEST[name], whole=True)
    assert found <= known.high


def test_andrews_mechanism_agrees_to_nine_digits():
    """The published list itself is good to 9.6 digits; ours come from 25."""
    found, _ = deviation("ts_andrews", BEST["ts_andrews"])
    assert found <= 1e-9


@pytest.mark.parametrize("offset", [0.0, 0.25])
def test_redundant_cranks_share_the_load_with_the_smallest_norm(offset):
    """At rest 60 deg aside: m g cos 60 in all; the first moment puts the rest in proportion."""
    scene = load_scene(BY_NAME["x09_cranks_offset" if offset else "x09_cranks"].scene)
    simulation = scene.simulation()
    tensions = -simulation.system.evaluate(simulation.start(scene.initial)).lam
    share, more = 9.81 / 2 / 3, offset * 9.81 / 4
    assert tensions == pytest.approx([share - more, share, share + more], abs=1e-12)
