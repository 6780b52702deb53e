"""Random scenes with contacts, looked at by an oracle that shares nothing with the solver.

A run is right, or it ends with an error that names a contact. It is wrong where bodies overlap,
where energy comes from nowhere, or where a step needs an impulse that no touch can give. A step
that is too long for a light body between heavy ones moves them out of one another: it lifts them.
"""

from collections import Counter

import numpy as np
import pytest
from contact_oracle import Oracle
from random_contacts import MAKERS, case

from mbd_ros.api import scene_from
from mbd_ros.errors import SolveError

SHARE = 0.4  # of the time after which most of them rest
DEPTH = 1e-9  # of the size of a body
UNLIKE = 0.3  # of the impulses: the oracle does not know in which order a step meets bodies
GAIN = 1e-4  # of the energy, in a step of a motion with spin
LIFT = 0.02  # the same, of a step that lifts bodies
RESIDUAL = 1e-8  # m/s or N s, of the largest speed or impulse, in all but few scenes


def verdict(seed):
    """Right, an error by name, lifted, or left: a step says large residuals; never wrong."""
    scenario = case(seed)
    scene = scene_from(scenario.scene, urdf=scenario.urdf)
    simulation, states = scene.simulation(dt=scenario.dt), []
    try:
        states.extend(simulation.run(scene.initial, SHARE * scenario.duration))
    except SolveError as error:
        assert any(pair.name in str(error) for pair in scenario.pairs)
        return "error"
    G = scene.couplings.jacobian if "couplings" in scenario.scene else None
    oracle = Oracle(scene.robot.model, scenario.pairs, scene.robot.origin, G)
    found = oracle.worst(states)
    assert found.depth <= DEPTH * scenario.scale, seed
    assert found.unlike <= UNLIKE, seed
    assert found.gain <= LIFT, seed
    speed = max(np.abs(x.v).max() for x in states)
    size = max(1.0, speed, *(body["mass"] * speed for body in scenario.scene["bodies"].values()))
    if max(simulation.stepper.residuals) > RESIDUAL * size:
        return "left"
    return "right" if found.gain <= GAIN else "lifted"


@pytest.mark.parametrize("seed", [3, 4, 5, 17, 21, 114, 174])
def test_random_contacts_are_right(seed):
    assert verdict(seed) == "right"


def test_there_are_scenes_of_all_kinds():
    cases = [case(seed) for seed in range(2 * len(MAKERS))]
    assert {one.kind for one in cases} == MAKERS.keys()


@pytest.mark.soak
def test_of_a_thousand_random_scenes_none_is_wrong():
    """Up to 20 contacts and mass ratios of a million; few end with an error or lift bodies."""
    outcomes = Counter(verdict(seed) for seed in range(1000))
    assert outcomes["error"] <= 30, outcomes
    assert outcomes["lifted"] + outcomes["left"] <= 6, outcomes


def test_a_light_ball_between_heavy_ones_lifts_none_of_them():
    """It meets them more often in one step than a step gives back: 1.7 cm of overlap, once."""
    scenario = case(31)
    scene = scene_from(scenario.scene)
    states = list(scene.simulation(dt=scenario.dt).run(scene.initial, 52 * scenario.dt))
    found = Oracle(scene.robot.model, scenario.pairs, scene.robot.origin).worst(states[45:])
    assert found.gain <= 1e-4 and found.depth <= DEPTH * scenario.scale


def test_friction_against_slips_that_go_on_does_no_work_through_those_that_end():
    """A light box stops at once below a heavy one, while one below it slides on."""
    scenario = case(82)
    scene = scene_from(scenario.scene)
    states = list(scene.simulation(dt=scenario.dt).run(scene.initial, 2 * scenario.dt))
    found = Oracle(scene.robot.model, scenario.pairs, scene.robot.origin).worst(states)
    assert found.gain <= 1e-10
