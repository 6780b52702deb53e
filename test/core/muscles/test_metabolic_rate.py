"""Metabolic rates of muscles, and motions that cost least of them."""

import numpy as np
import pytest
from prediction_scenes import mass

from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError

MUSCLE = {
    "type": "degroote_fregly",
    "name": "pull",
    "path": {"points": [{"frame": "ground"}, {"frame": "mass"}]},
    "max_isometric_force": 900.0,
    "optimal_fiber_length": 0.1,
    "tendon_slack_length": 0.05,
    "pennation_angle": 0.3,
    "tendon": "rigid",
}
# length [m], speed [m/s], activation, excitation, rate [W] of Bhargava2004SmoothedMuscleMetabolics
# of OpenSim 4.6 with use_smoothing, less the basal rate
OPENSIM = (
    (0.126657523896, 0.070766760474, 0.375156959886, 0.599763237052, 10.07551957),
    (0.153800421288, -0.695153825216, 0.032641271893, 0.823970318813, 57.05048677),
    (0.128154781003, -0.425070462325, 0.97581904209, 0.471452967222, 143.5584328),
    (0.168552301589, -0.037834866081, 0.633505414922, 0.164591767063, 22.26072709),
    (0.15444024608, 0.588872491429, 0.522253961968, 0.731601781953, -5.728750807e-14),
    (0.156998803276, -0.697549698837, 0.747901036435, 0.587455599614, 107.24287),
    (0.131088736166, -0.750381197648, 0.8509061475, 0.473839125119, 96.31167321),
    (0.160317674685, 0.606100480409, 0.705564304267, 0.904254720881, -4.440892099e-16),
    (0.13764743828, 0.481454033576, 0.446836213809, 0.918163252836, -4.440892099e-16),
    (0.171520666224, -0.644073104431, 0.150530105793, 0.228307463584, 31.75349947),
)


def on_rail():
    """A mass that a muscle pulls along a rail."""
    return mass(3.0).with_(muscles=[MUSCLE], actuators=None)


@pytest.mark.parametrize(("length", "speed", "activation", "excitation", "rate"), OPENSIM)
def test_rates_are_those_of_opensim(length, speed, activation, excitation, rate):
    scene = on_rail()
    system, (muscle,) = scene.system(), scene.muscles
    x = State(0.0, np.array([length]), np.array([speed]), np.array([activation]))
    system.k.refresh(x.q, x.v, Reads.DRIFT)
    found = muscle.metabolic_rate(system.k, x, np.array([excitation]))
    assert found == pytest.approx(rate, rel=1.0e-8, abs=1.0e-8)


def test_the_cost_is_the_integral_of_the_rates():
    """With the basal rate, 1.2 W/kg; by the states and excitations that were found."""
    spring = {"type": "joint_spring", "joint": "slide", "stiffness": 2.0e3, "damping": 100.0}
    start = {"position": {"slide": 0.16}}
    scene = on_rail().with_(initial=start, forces=[spring | {"rest": 0.16}])
    task = {
        "duration": 0.3,
        "end": {"slide.position": 0.14},
        "goals": [{"type": "metabolic"}, {"type": "effort", "weight": 1.0}],
        "tolerance": 1.0e-5,
    }
    result = scene.predict(task)
    costs = dict(zip(result["goals"]["goal"], result["goals"]["value"], strict=True))
    samples, system, (muscle,) = result["samples"], scene.system(), scene.muscles
    rates = []
    columns = ("slide.position", "slide.velocity", "pull.activation", "pull.excitation")
    for t, q, v, a, e in zip(samples["time"], *(samples[one] for one in columns), strict=True):
        x = State(t, np.array([q]), np.array([v]), np.array([a]))
        system.k.refresh(x.q, x.v, Reads.DRIFT)
        rates.append(muscle.metabolic_rate(system.k, x, np.array([e])))
    whole = np.trapezoid(rates, samples["time"]) + 0.3 * 1.2 * 3.0
    assert costs["metabolic"] == pytest.approx(whole, rel=1.0e-2)
    assert costs["metabolic"] > 1.2


def test_a_scene_without_muscles_has_no_metabolic_rate():
    with pytest.raises(SceneError, match="no muscles"):
        mass().predict({"duration": 1.0, "goals": [{"type": "metabolic"}]})
