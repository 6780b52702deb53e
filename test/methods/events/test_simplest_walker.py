"""The simplest walker as a mechanism: one step of both gaits, as feet lose their mass."""

import math

import numpy as np
import pytest

import mbd_ros as mbd

# Just after a strike: stance leg from the slope normal, its rate, swing leg from the stance leg,
# its rate; then the period, unit of time sqrt(l / g). Integrated in 80-bit arithmetic. Source of
# the model: M. Garcia, A. Chatterjee, A. Ruina, M. Coleman, J. Biomech. Eng. 120, 1998, 281-288.
GAITS = {
    (0.009, "long"): (
        0.20031090054424709,
        -0.19983247300495235,
        0.40062180108849418,
        -0.015822999948309382,
        3.8824637528513741,
    ),
    (0.009, "short"): (
        0.19393736981018181,
        -0.20386692744200692,
        0.38787473962036361,
        -0.015144260853191567,
        3.0961058680781637,
    ),
    (0.004, "long"): (
        0.15338956487623631,
        -0.15608014667568143,
        0.30677912975247262,
        -0.0072871974491234962,
        3.8526134617509813,
    ),
    (0.004, "short"): (
        0.14877838696961965,
        -0.15880667345760566,
        0.29755677393923929,
        -0.0069786544989918931,
        3.1165055983480140,
    ),
}


def walker(slope, state, foot):
    """The walker on a slope [rad] with feet of some mass, in a state after a strike."""
    th, th_rate, phi, phi_rate, _ = state
    scene = mbd.load_scene("simplest_walker_step")
    robot = {
        **scene.entries["robot"],
        "gravity": [math.sin(slope), 0.0, -math.cos(slope)],
    }
    initial = {
        "position": {
            **{"travel": -math.sin(th), "height": math.cos(th)},
            **{"left_hip": -th, "right_hip": phi - th},
        },
        "velocity": {
            **{"travel": -math.cos(th) * th_rate, "height": -math.sin(th) * th_rate},
            **{"left_hip": -th_rate, "right_hip": phi_rate - th_rate},
        },
    }
    method = {"type": "dop853", "tolerance": 1.0e-12}
    scene = scene.with_(robot=robot, initial=initial, integrator=method)
    leg = foot, np.array((0.0, 0.0, -1.0)), np.zeros((3, 3))
    return scene.with_inertias({"left_leg": leg, "right_leg": leg})


def after_step(slope, state, foot):
    """State after a step in the coordinates of the reference, and the time of the strike."""
    events = walker(slope, state, foot).simulate(state[-1] + 0.1)["events"]
    assert len(events["time"]) == 1
    left, right = (
        np.array([events[f"{leg}_hip.{what}.after"][0] for what in ("position", "velocity")])
        for leg in ("left", "right")
    )
    phi = right - left
    return np.array([-left[0], -left[1], phi[0], phi[1], events["time"][0]])


@pytest.mark.parametrize("gait", GAITS, ids=str)
def test_step_leads_back_to_its_start_in_the_limit_of_feet_without_mass(gait):
    """The scuff at mid-stance is no strike; the trend in the mass of the feet is linear."""
    state = np.array(GAITS[gait])
    one, two = (after_step(gait[0], state, foot) for foot in (1.0e-6, 2.0e-6))
    assert np.abs(one - state).max() < 3.0e-5
    assert np.abs(2.0 * one - two - state).max() < 2.0e-9
