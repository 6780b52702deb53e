"""Excitations of a whole motion, with the dynamics of activations and tendons."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbd_ros as mbd
from mbd_ros.core.muscles.array_numbers import ArrayNumbers
from mbd_ros.errors import MbdError

pytest.importorskip("casadi", reason="casadi is optional (extra: compiled)")


@pytest.fixture(scope="module")
def swing():
    leg = mbd.load_scene("muscle_leg")
    return leg, leg.simulate(0.3, dt=0.01)


@pytest.fixture(scope="module")
def excited(swing):
    leg, motion = swing
    return leg.muscle_forces(motion, reserves=1.0, dynamics="tendon", tolerance=1e-3)["samples"]


def test_excitations_integrated_again_give_the_activations(swing, excited):
    leg, t = swing[0], excited["time"]
    for muscle in leg.muscles:
        times = muscle.dynamics.rising, muscle.dynamics.falling
        e = excited[f"{muscle.name}.excitation"]
        found = excited[f"{muscle.name}.activation"]

        def rate(now, a, e=e, times=times):
            lack = np.interp(now, t, e) - a
            side, factor = 0.5 * np.tanh(0.1 * lack), 0.5 + 1.5 * a
            return lack * ((side + 0.5) / (times[0] * factor) + (0.5 - side) * factor / times[1])

        again = solve_ivp(rate, (t[0], t[-1]), found[:1], t_eval=t, rtol=1e-8, atol=1e-10)
        assert np.abs(again.y[0] - found).max() < 0.03  # excitations are linear between samples


def test_forces_balance_what_the_motion_needs(swing, excited):
    leg = swing[0]
    lacking = [excited[name] for name in excited if name.endswith(".lacking")]
    assert np.abs(lacking).max() < 1e-9
    for muscle in leg.muscles:
        activation = excited[f"{muscle.name}.activation"]
        assert (activation >= muscle.dynamics.least - 1e-9).all() and (activation <= 1.0).all()


def test_fibres_move_as_their_balance_with_the_tendon_says(swing, excited):
    from mbd_ros.core.inverse.muscle_dynamics import DEFAULTS, MuscleDynamics, muscles_with

    muscles = muscles_with(MuscleDynamics("tendon", *DEFAULTS), swing[0].muscles)
    elastic = [muscle for muscle in muscles if muscle.is_elastic]
    assert elastic
    for muscle in elastic:
        length, fiber, a = (
            excited[f"{muscle.name}.{name}"] for name in ("length", "fiber_length", "activation")
        )
        law = muscle.contraction
        velocity = law.beside_elastic_tendon(ArrayNumbers, a, length, fiber).velocity
        moved = np.gradient(fiber, excited["time"], edge_order=2)
        assert np.abs(velocity - moved)[2:-2].max() < 0.02 * law.fastest
        assert excited[f"{muscle.name}.force"] == pytest.approx(
            law.tendon(ArrayNumbers, length, fiber), abs=1e-9
        )


def test_a_finer_mesh_changes_little(swing):
    leg, motion = swing
    coarse, fine = (
        leg.muscle_forces(motion, reserves=10.0, dynamics="activation", interval=one)["samples"]
        for one in (0.02, 0.005)
    )
    off = [np.abs(coarse[n] - fine[n]).max() for n in coarse if n.endswith(".activation")]
    assert max(off) < 1e-3


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"interval": 0.01}, "muscles.dynamics: is missing, interval says more of it"),
        ({"dynamics": "activation", "passive": True}, "for frames one by one"),
        ({"dynamics": "all"}, "expected one of activation, tendon"),
    ],
)
def test_what_cannot_be_is_named(swing, options, said):
    leg, motion = swing
    with pytest.raises(MbdError, match=said):
        leg.muscle_forces(motion, **options)


def test_a_motion_that_muscles_cannot_produce_names_what_lacks(swing):
    leg, motion = swing
    weak = leg.with_({f"{part.name}.max_isometric_force": 1.0 for part in leg.muscles})
    with pytest.raises(MbdError, match=r"lacks most: \w+ at 0\.\d+ s .*; give reserves"):
        weak.muscle_forces(motion, dynamics="activation", interval=0.1)
