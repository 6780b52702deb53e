"""Excitations of a whole motion, with the dynamics of activations and tendons."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbd_ros as mbd
from mbd_ros.core.muscles.curves import ArrayNumbers
from mbd_ros.errors import MbdError
from mbd_ros.features.muscles.muscle_trial import (
    Excited,
    MuscleDynamics,
    Trial,
    muscles_with,
)
from mbd_ros.features.muscles.trial import Points
from mbd_ros.optimal_control.mesh import RADAU, collocation

MESH = (0.02, 4, 1.0e-3)  # interval [s], degree, tolerance

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
    muscles = muscles_with(MuscleDynamics("tendon", *MESH), swing[0].muscles)
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


def known_trial(muscles, points):
    """Muscles at alternate sides of one joint, with one reserve."""
    t, ones = points.times_with_start, np.ones((len(points.times_with_start), len(muscles)))
    laws = [muscle.contraction for muscle in muscles]
    moved = 1.0 + 0.04 * np.sin(6.0 * t[:, None] + np.arange(len(muscles)))
    length = np.array([law.slack for law in laws]) + moved * [law.optimal for law in laws]
    sides = np.where(np.arange(len(muscles)) % 2, 0.04, -0.04)
    columns = np.tile(np.append(sides, 10.0), (len(t), 1, 1))
    needed, none = 20.0 * np.sin(8.0 * t)[:, None], 0.0 * ones
    strength = ones * [law.peak for law in laws]
    least = ones * [float(muscle.dynamics.least) for muscle in muscles]
    reserve = np.array([[-np.inf], [np.inf]])
    given = strength, none, columns, needed, np.array([20.0]), ones, none, none, least, reserve
    return Trial(np.diff(points.knots), length, *given)


@pytest.mark.parametrize("kind", ["activation", "tendon"])
def test_a_part_beside_a_known_rest_is_solved_as_the_whole_is(swing, kind):
    """Slopes of the cost beyond a part leave it at the optimum of the whole."""
    from mbd_ros.features.muscles.trial_program import MuscleProgram, Part

    muscles = muscles_with(MuscleDynamics(kind, *MESH), swing[0].muscles)
    points = Points(np.linspace(0.0, 0.4, 21), collocation(RADAU, 3))
    trial = known_trial(muscles, points)
    elastic = [i for i, muscle in enumerate(muscles) if muscle.is_elastic]
    fibers = np.array([muscles[i].contraction.optimal for i in elastic])
    ones = np.ones((len(points.times_with_start), 1))
    a, effort, lengths = 0.1 * ones * np.ones(len(muscles)), 0.0 * ones, ones * fibers
    guess = Excited(a, a, effort, lengths, 0.0 * lengths)
    given = muscles, trial, points.scheme, 2.0
    whole = MuscleProgram(*given).solve(guess, 1e-10, 500, False)
    solved = np.zeros(20, dtype=bool)
    solved[6:12] = True
    rest = np.append(True, np.repeat(~solved, 3))[:, None]
    start = Excited(*(np.where(rest, w, g) for w, g in zip(whole.excited, guess, strict=True)))
    part = MuscleProgram(*given, Part(solved, whole.slopes)).solve(start, 1e-10, 500, False)
    assert whole.is_good and part.is_good
    off = np.abs(np.hstack(part.excited) - np.hstack(whole.excited))
    assert off.max() < 1e-5
    assert part.cost == pytest.approx(whole.cost, rel=1e-6)


def test_intervals_are_halved_until_activations_are_as_good_as_asked(swing):
    leg, motion = swing
    given = {"reserves": 1.0, "dynamics": "activation"}
    coarse, mended, fine = (
        leg.muscle_forces(motion, **given, interval=width, tolerance=tolerance)["samples"]
        for width, tolerance in ((0.1, 1.0), (0.1, 1e-5), (0.005, 1.0))
    )
    names = [name for name in fine if name.endswith(".activation")]
    off = [max(np.abs(one[n] - fine[n]).max() for n in names) for one in (coarse, mended)]
    assert off[1] < 0.5 * off[0]


def test_a_cost_with_a_kink_has_an_optimum(swing):
    """Metabolic cost grows with the first power of excitations and reserves."""
    leg, motion = swing
    given = {"reserves": 1.0, "dynamics": "activation", "objective": "metabolic"}
    found = leg.muscle_forces(motion, **given)["samples"]
    assert np.abs([found[name] for name in found if name.endswith(".lacking")]).max() < 1e-9
    other = leg.muscle_forces(motion, **given, exponent=2)["samples"]
    names = [f"{muscle.name}.excitation" for muscle in leg.muscles]
    first, second = (np.array([one[name] for name in names]) for one in (found, other))
    assert (first < 0.02).mean() > (second < 0.02).mean()  # few do all the work


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"interval": 0.01}, "muscles.dynamics: is missing; interval needs it"),
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
    with pytest.raises(MbdError, match=r"residual forces: \w+ at 0\.\d+ s .*; add reserves"):
        weak.muscle_forces(motion, dynamics="activation", interval=0.1)
