"""Phases, guards and resets: walkers with closed forms and published gaits."""

import math

import numpy as np
import pytest

import mbd_ros as mbd

# Rimless wheel of 8 spokes of 1 m, mass at the hub, slope 0.08 rad, from 1.5 rad/s just after a
# strike: time of, and speed after, each of eleven strikes, by elliptic integrals. Source of the
# model: T. McGeer 1990; M. Coleman, A. Chatterjee, A. Ruina, Dyn. Stab. Syst. 12, 1997.
STRIKES = np.array(
    (
        (0.5932221719601549, 1.3133999453801017),
        (1.312896382708349, 1.2093507038021192),
        (2.142463550333285, 1.153812800638732),
        (3.0546034103141406, 1.1250161803206882),
        (4.020929442351426, 1.1103378402613007),
        (5.019208057362444, 1.1029254173707843),
        (6.035015827321006, 1.0992004615472617),
        (7.060033301881144, 1.0973332419357897),
        (8.089775299963145, 1.0963984396436859),
        (9.121910621957955, 1.0959307394863091),
        (10.155250521074246, 1.0956968145431283),
    )
)
ALPHA, STRIKE = math.pi / 8, "step.strike"


def wheel(inertia):
    """The rimless wheel whose hub has a moment of inertia [kg·m^2]."""
    hub = {"hub": (1.0, np.zeros(3), inertia * np.eye(3))}
    return mbd.load_scene("rimless_wheel").with_inertias(hub)


def strikes(scene, duration):
    """Events of a run."""
    events = scene.simulate(duration)["events"]
    return {name: values[events[STRIKE + ".event"] == 1.0] for name, values in events.items()}


def rolled(inertia):
    """Times and speeds of eleven strikes, shape (11, 2)."""
    events = strikes(wheel(inertia), 10.2)
    return np.column_stack((events["time"], events["wheel.velocity.after"]))


def test_rimless_wheel_strikes_as_in_closed_form():
    """The trend in the inertia of the hub, which the reference does not have, is linear."""
    one, two = rolled(1.0e-6), rolled(2.0e-6)
    assert one.shape == STRIKES.shape
    assert np.abs(one / STRIKES - 1.0).max() < 1.0e-5
    assert np.abs((2.0 * one - two) / STRIKES - 1.0).max() < 2.0e-10


def test_rimless_wheel_has_the_fixed_point_of_its_closed_form():
    """Speeds before and after a strike, and the period, of a roll that repeats itself."""
    period, minus, plus = 1.0345498114232794, 1.5492184049054594, 1.095462839647657
    found = []
    for inertia in (1.0e-6, 2.0e-6):
        scene = wheel(inertia)
        start = scene.entries["initial"]
        velocity = {name: plus / 1.5 * v for name, v in start["velocity"].items()}
        scene = scene.with_(initial={**start, "velocity": velocity})
        events = strikes(scene, 3.2)
        sides = (events[f"wheel.velocity.{side}"][-1] for side in ("before", "after"))
        found.append(np.array([events["time"][2] - events["time"][1], *sides]))
    limit = 2.0 * found[0] - found[1]
    assert np.abs(limit / (period, minus, plus) - 1.0).max() < 1.0e-9


def test_strike_keeps_the_angular_momentum_about_the_new_foot_and_loses_the_closed_form():
    """A hub of inertia I has w+ = w- (I + m l^2 cos 2 alpha) / (I + m l^2)."""
    inertia = 0.2
    events = strikes(wheel(inertia), 1.2)
    assert len(events["time"]) >= 1
    turn = 2.0 * ALPHA
    for i in range(len(events["time"])):
        before, after = (
            np.array(
                [events[f"{name}.{what}.{side}"][i] for name in ("travel", "height", "wheel")]
            )
            for what, side in (("velocity", "before"), ("velocity", "after"))
        )
        angle = events["wheel.position.after"][i]  # of the spoke that stands from now on
        arm = np.array((math.sin(angle), math.cos(angle)))  # from its foot to the hub
        momentum = [inertia * v[2] + arm[1] * v[0] - arm[0] * v[1] for v in (before, after)]
        assert momentum[1] == pytest.approx(momentum[0], rel=1.0e-12)
        share = (inertia + math.cos(turn)) / (inertia + 1.0)
        assert after[2] == pytest.approx(share * before[2], rel=1.0e-12)
        kinetic = 0.5 * (inertia + 1.0) * before[2] ** 2
        lost = events["energy.before"][i] - events["energy.after"][i]
        assert lost == pytest.approx(kinetic * (1.0 - share**2), abs=1.0e-11)


def spokes():
    """The wheel whose eight spokes strike one after the other, a phase each."""
    contacts, phases = [], {}
    for i in range(8):
        angle = -2.0 * ALPHA * i  # of the foot in the hub
        foot = {"frame": "hub", "points": [[-math.sin(angle), 0.0, -math.cos(angle)]]}
        between = [foot, {"half_space": [0, 0, 1]}]
        contacts.append(
            {"name": f"spoke_{i}", "type": "rigid", "between": between, "friction": 0.6}
        )
        then = (i + 1) % 8
        phases[f"on_{i}"] = {
            "contacts": [f"spoke_{i}"],
            "until": {"strike": {"touch_down": f"spoke_{then}"}},
            "then": f"on_{then}",
        }
    return mbd.load_scene("rimless_wheel").with_(contacts=contacts, phases=phases)


def test_spokes_that_strike_one_after_the_other_roll_as_one_that_is_relabelled():
    one = strikes(mbd.load_scene("rimless_wheel"), 4.2)
    events = spokes().simulate(4.2)["events"]
    np.testing.assert_allclose(events["time"], one["time"], rtol=0.0, atol=1.0e-9)
    speeds = events["wheel.velocity.after"], one["wheel.velocity.after"]
    np.testing.assert_allclose(*speeds, rtol=1.0e-9)
    np.testing.assert_array_equal(events["phase.after"], [1, 2, 3, 4, 5])


@pytest.mark.parametrize("kind", ["rk4", pytest.param("adams", marks=pytest.mark.soak), "dop853"])
def test_checkpoint_in_any_phase_goes_on_with_the_same_bits(kind):
    """Just before and after a strike, in a simulation that walked already."""
    scene = mbd.load_scene("simplest_walker").with_(integrator={"type": kind}, dt=0.02)
    simulation, states, kept = scene.simulation(), [], []
    for k, x in enumerate(simulation.run(scene.initial, 8.0)):
        states.append(x)
        if k in (190, 194, 195):
            kept.append((k, simulation.checkpoint()))
    for k, checkpoint in kept:
        for other in (simulation, scene.simulation()):
            rest = list(other.run(checkpoint, 8.0))
            assert [x.q.tobytes() for x in rest] == [x.q.tobytes() for x in states[k + 1 :]]
            assert [x.mode for x in rest] == [x.mode for x in states[k + 1 :]]
