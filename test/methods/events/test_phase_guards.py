"""Guards and resets of phases, on mechanisms with closed forms."""

import math

import numpy as np
import pytest
from mechanisms import double_pendulum, joint, link, urdf
from phase_guards import GROUND, MASS, METHOD, G, slider

import mbd_ros as mbd
from mbd_ros.errors import MbdError

ON_GROUND = {"contacts": ["sole"]}


def ends(scene, duration):
    """Times, phases before and after of all ends of phases."""
    events = scene.simulate(duration)["events"]
    return [
        (t, int(before), int(after))
        for t, before, after in zip(
            events["time"], events["phase.before"], events["phase.after"], strict=True
        )
        if before != after
    ]


def test_joint_guard_acts_in_its_direction_alone():
    """Thrown up with 3 m/s past 0.3 m: once on the way up, once on the way down."""
    speed, level = 3.0, 0.3
    root = math.sqrt(speed**2 - 2.0 * G * level)
    times = {"up": (speed - root) / G, "down": (speed + root) / G}
    for way, t in times.items():
        guard = {"joint": "slide", "at": level, "direction": way}
        flight = {"until": {"passes": guard}, "then": "after"}
        after = {"until": {"late": {"time": 9.0}}, "then": "after"}
        found = ends(slider({"flight": flight, "after": after}, speed=speed), 0.58)
        assert found == [(pytest.approx(t, abs=1e-9), 0, 1)]


def test_guard_acts_only_after_it_has_left_zero_and_where_its_condition_holds():
    """From 0 on the way up; back at 0 it acts, unless its condition does not hold there."""
    speed = 3.0
    flight = {"until": {"back": {"joint": "slide", "direction": "down"}}, "then": "after"}
    after = {"until": {"late": {"time": 9.0}}, "then": "after"}
    scene = slider({"flight": flight, "after": after}, speed=speed)
    assert ends(scene, 0.7) == [(pytest.approx(2.0 * speed / G, abs=1e-9), 0, 1)]
    back = {"joint": "slide", "direction": "down", "when": {"joint": "slide", "above": 0.1}}
    scene = slider(
        {"flight": {"until": {"back": back}, "then": "after"}, "after": after}, speed=3.0
    )
    assert ends(scene, 0.7) == []


def test_time_ends_a_phase_exactly_and_begins_anew_with_it():
    phases = {
        "one": {"until": {"over": {"time": 0.123456789}}, "then": "two"},
        "two": {"until": {"over": {"time": 0.2}}, "then": "one"},
    }
    found = ends(slider(phases, height=5.0), 0.5)
    times = np.cumsum([0.123456789, 0.2, 0.123456789])
    assert found == [
        (pytest.approx(t, rel=1e-15), i % 2, (i + 1) % 2) for i, t in enumerate(times)
    ]


def test_held_contact_lifts_off_where_its_force_ends_and_comes_down_plastically():
    """A spring over the mass, stretched by m g / k in the middle of its swing, lifts it."""
    spring = {"type": "joint_spring", "joint": "slide", "stiffness": 200.0, "rest": 0.05}
    phases = {
        "stance": {
            "contacts": ["sole"],
            "until": {"rise": {"lift_off": "sole"}},
            "then": "flight",
        },
        "flight": {"until": {"down": {"touch_down": "sole"}}, "then": "stance"},
    }
    scene = slider(phases, height=0.2, forces=[spring])
    scene = scene.with_(initial={"position": {"slide": 0.2}, "phase": "flight"})
    events = scene.simulate(1.0)["events"]
    # height of rest and half swing: h = rest - m g / k, hits 0 at cos(w t) = -h / (0.2 - h)
    rate = math.sqrt(200.0 / MASS)
    mean = 0.05 - MASS * G / 200.0
    swing = 0.2 - mean
    hit = math.acos(-mean / swing) / rate
    assert events["time"] == pytest.approx([hit], abs=1e-9)
    speed = swing * rate * math.sin(rate * hit)
    assert events["sole.normal.impulse"] == pytest.approx([MASS * speed], rel=1e-9)
    assert events["energy.lost"] == pytest.approx([0.5 * MASS * speed**2], rel=1e-9)
    assert events["slide.velocity.after"] == pytest.approx([0.0], abs=1e-15)


def test_force_of_a_held_contact_is_a_guard():
    """A mass that is held on the ground under a swinging load lifts off where n = 0."""
    bob, rail = link("bob", 1.0), joint("bob_slide", "prismatic", "mass", "bob")
    robot = urdf(
        link("world"), link("mass", MASS), bob, joint("slide", "prismatic", "world", "mass"), rail
    )
    spring = {"type": "joint_spring", "joint": "bob_slide", "stiffness": 100.0}
    swing, rate = 0.5, 10.0
    start = {"position": {"bob_slide": -G / 100.0 - swing}}
    for guard, level in (({"lift_off": "sole"}, 0.0), ({"force": "sole", "at": 10.0}, 10.0)):
        phases = {
            "stance": {"contacts": ["sole"], "until": {"rise": guard}, "then": "flight"},
            "flight": {"until": {"late": {"time": 9.0}}, "then": "stance"},
        }
        entries = {"contacts": [GROUND], "phases": phases, "initial": start, "forces": [spring]}
        scene = mbd.scene_from({**entries, "integrator": METHOD, "dt": 0.01}, urdf=robot)
        # n = m g - k x with x = -g / w^2 - swing cos(w t): n = 3 g + 100 swing cos(w t)
        cosine = (level - 3.0 * G) / (100.0 * swing)
        t = math.acos(cosine) / rate
        assert ends(scene, 0.4) == [(pytest.approx(t, abs=1e-9), 0, 1)]


def test_contact_that_the_next_phase_does_not_hold_bounces_with_its_restitution():
    ball = {**GROUND, "restitution": 0.5}
    reset = {"impact": ["sole"]}
    flight = {"until": {"hit": {"touch_down": "sole"}}, "then": "flight", "reset": reset}
    events = slider({"flight": flight}, height=0.5, contacts=[ball]).simulate(0.7)["events"]
    fall = math.sqrt(2.0 * 0.5 / G)
    assert events["time"] == pytest.approx([fall, 2.0 * fall], abs=1e-9)
    speeds = G * fall * np.array([0.5, 0.25])
    assert events["slide.velocity.after"] == pytest.approx(speeds, rel=1e-9)


def test_constraint_of_the_next_phase_holds_after_an_impact():
    """A knee that locks where it is straight."""
    lock = {"name": "lock", "type": "prescribed_motion", "joint": "joint_2", "polynomial": [0.0]}
    phases = {
        "free": {
            "constraints": [],
            "until": {"straight": {"joint": "joint_2"}},
            "then": "locked",
        },
        "locked": {"constraints": ["lock"], "until": {"late": {"time": 0.3}}, "then": "free"},
    }
    scene = mbd.scene_from(
        {
            **{"constraints": [lock], "phases": phases, "integrator": METHOD, "dt": 0.01},
            "initial": {
                "position": {"joint_2": -0.4},
                "velocity": {"joint_1": 1.0, "joint_2": 2.0},
            },
        },
        urdf=double_pendulum(),
    )
    result = scene.simulate(2.0)
    events = result["events"]
    assert len(events["time"]) >= 1
    assert events["joint_2.velocity.after"][0] == pytest.approx(0.0, abs=1e-13)
    assert events["energy.lost"][0] > 0.0
    locked = result["samples"]["phase"] == 1.0
    assert np.abs(result["samples"]["joint_2.position"][locked]).max() < 1e-10


def test_two_guards_at_once_follow_the_order_of_the_scene():
    """Both are named in the event; the first one says what comes next."""
    late = {"until": {"late": {"time": 9.0}}, "then": "first"}
    pair = {
        "low": {"joint": "slide", "at": 0.1, "then": "first"},
        "half": {"joints": {"slide": 0.5}, "at": 0.05, "then": "second"},
    }
    for order, after in ((("low", "half"), 1), (("half", "low"), 2)):
        until = {name: pair[name] for name in order}
        phases = {"fall": {"until": until}, "first": late, "second": late}
        events = slider(phases, height=0.5).simulate(0.4)["events"]
        assert events["phase.after"].tolist()[0] == after
        assert events["fall.low.event"][0] == events["fall.half.event"][0] == 1.0


GROUNDED = {"half_space": [0, 0, 1]}
LATE = {"until": {"late": {"time": 9.0}}}


def free(body, contact, phases, **more):
    """A free body and its contact, where phases say."""
    contact = {"name": "sole", "type": "rigid", "friction": 0.5, **contact}
    entries = {"bodies": {"body": body}, "contacts": [contact], "phases": phases}
    return mbd.scene_from({**entries, "integrator": METHOD, "dt": 0.01, **more})


def test_round_body_that_is_held_rolls():
    """A ball on a slope: 5/7 of the acceleration of one that slides; friction is 2/7 of it."""
    ball = {"shape": {"sphere": 0.1}, "mass": 2.0, "pose": {"xyz": [100.0, -7.0, 0.1]}}
    twist = {"body": {"linear": [1.0, 0.0, 0.0], "angular": [0.0, 10.0, 0.0]}}
    more = {"gravity": [1.0, 0.0, -G], "initial": {"twist": twist}}
    roll = {**ON_GROUND, **LATE, "then": "roll"}
    samples = free(ball, {"between": ["body", GROUNDED]}, {"roll": roll}, **more).simulate(1.0)
    x = samples["samples"]
    assert x["body.position.x"][-1] - 100.0 == pytest.approx(1.0 + 0.5 * 5.0 / 7.0, abs=1e-9)
    assert np.abs(x["body.position.z"] - 0.1).max() < 1e-12
    assert x["sole.normal"] == pytest.approx(np.full(101, 2.0 * G), rel=1e-9)
    assert x["sole.friction_x"] == pytest.approx(np.full(101, -2.0 * 2.0 / 7.0), rel=1e-9)


def test_sole_with_four_points_comes_down_flat_and_stands():
    """Their impulses are what is lost, those of rows that depend on each other shared alike."""
    corners = [[x, y, -0.05] for x in (-0.1, 0.1) for y in (-0.05, 0.05)]
    foot = {"shape": {"box": [0.2, 0.1, 0.1]}, "mass": 2.0, "pose": {"xyz": [0.0, 0.0, 0.3]}}
    contact = {"between": [{"frame": "body", "points": corners}, GROUNDED]}
    fall = {"until": {"hit": {"touch_down": "sole"}}, "then": "stand"}
    phases = {"fall": fall, "stand": {**ON_GROUND, **LATE, "then": "fall"}}
    result = free(foot, contact, phases).simulate(0.5)
    drop = math.sqrt(2.0 * 0.25 / G)
    events, samples = result["events"], result["samples"]
    assert events["time"] == pytest.approx([drop], abs=1e-9)
    shares = [events[f"sole.point_{i}_normal.impulse"][0] for i in range(4)]
    assert shares == pytest.approx([2.0 * G * drop / 4.0] * 4, rel=1e-9)
    assert samples["body.position.z"][-1] == pytest.approx(0.05, abs=1e-12)
    force = sum(samples[f"sole.point_{i}_normal"][-1] for i in range(4))
    assert force == pytest.approx(2.0 * G, rel=1e-9)


@pytest.mark.parametrize("kind", ["rigid", "compliant"])
def test_contact_of_a_phase_that_is_not_held_acts_in_it_alone(kind):
    """A ball falls through its ground until the phase in which that is there."""
    ball = {"shape": {"sphere": 0.1}, "mass": 2.0, "pose": {"xyz": [0.0, 0.0, 0.6]}}
    contact = {"type": kind, "between": ["body", GROUNDED], "friction": 0.0}
    if kind == "compliant":
        contact["stiffness"] = 1.0e5
    low, high = (
        {
            "off": {"until": {"late": {"time": t}}, "then": "on"},
            "on": {**ON_GROUND, **LATE, "held": False, "then": "off"},
        }
        for t in (0.1, 0.4)
    )
    stops = free(ball, contact, low).simulate(0.5)["samples"]["body.position.z"]
    falls = free(ball, contact, high).simulate(0.39)["samples"]["body.position.z"]
    assert stops.min() > 0.08
    assert falls[-1] == pytest.approx(0.6 - 0.5 * G * 0.39**2, abs=1e-9)


def test_relabelled_joints_take_their_internal_states_along():
    """Two equal joints with motors swap places and signs; the whole is the same afterwards."""
    robot = double_pendulum()
    drives = [
        {"name": f"motor_{i}", "type": "series_elastic_drive", "joint": f"joint_{i}"}
        | {"stiffness": 50.0, "rotor_inertia": 1.0e-3, "ratio": 20.0}
        for i in (1, 2)
    ]
    names = ("angle", "speed")
    scene = mbd.scene_from(
        {
            "actuators": drives,
            "phases": {
                "one": {
                    "until": {"late": {"time": 0.1}},
                    "then": "one",
                    "reset": {
                        "exchange": {
                            "joint_1": {"joint": "joint_2", "factor": -1.0},
                            **{
                                f"motor_1.{name}": {"joint": f"motor_2.{name}", "factor": -1.0}
                                for name in names
                            },
                        }
                    },
                }
            },
            "initial": {"position": {"joint_1": 0.3, "joint_2": -0.1}},
            "integrator": METHOD,
            "dt": 0.01,
        },
        urdf=robot,
    )
    states = scene.internals.names
    assert set(states) == {f"motor_{i}.{name}" for i in (1, 2) for name in names}, states
    event = next(iter(_events(scene, 0.15)))
    of = {name: i for i, name in enumerate(states)}
    for name in names:
        one, two = of[f"motor_1.{name}"], of[f"motor_2.{name}"]
        assert event.after.z[[one, two]].tolist() == (-event.before.z[[two, one]]).tolist()
    assert event.after.q.tolist() == (-event.before.q[::-1]).tolist()
    assert event.after.v.tolist() == (-event.before.v[::-1]).tolist()


def _events(scene, duration):
    simulation = scene.simulation()
    for _ in simulation.run(scene.initial, duration):
        pass
    return simulation.events


def test_impulse_that_a_held_contact_cannot_exert_is_an_error_by_name():
    """The rimless wheel needs mu >= tan(22.5 deg) = 0.41421 where a spoke strikes."""
    scene = mbd.load_scene("rimless_wheel")
    numbers = ("spoke.friction", "next_spoke.friction")
    enough = scene.with_(dict.fromkeys(numbers, 0.4143))
    assert len(enough.simulate(1.0)["events"]["time"]) == 1
    with pytest.raises(MbdError, match="impact: contact next_spoke is held and would slip"):
        scene.with_({"spoke.friction": 0.6, "next_spoke.friction": 0.4141}).simulate(1.0)


@pytest.mark.parametrize("wide", [0.0, 0.05])
def test_sole_tips_where_the_centre_of_pressure_reaches_its_edge(wide):
    """A mass that a spring drives forward over a sole of 0.3 m: (m g + k h) x = weight * edge."""
    mass, height, stiffness = 2.0, 0.4, 40.0
    rail = joint("slide", "prismatic", "sole", "load", axis=(1, 0, 0))
    robot = urdf(link("sole", 1.0), link("load", mass, (0.0, 0.0, height)), rail)
    spring = {"type": "joint_spring", "joint": "slide", "stiffness": stiffness}
    stand = {**ON_GROUND, "until": {"heel_off": {"tip": "sole"}}, "then": "roll"}
    entries = {
        "robot": {"base": "floating"},
        "phases": {"stand": stand, "roll": {**LATE, "then": "stand"}},
        **{"forces": [spring], "integrator": METHOD, "dt": 0.01},
        "initial": {"position": {"slide": -0.15}},
    }

    def standing(heel, toe):
        corners = [[x, y, 0.0] for x in (heel, toe) for y in sorted({-wide, wide})]
        between = [{"frame": "sole", "points": corners}, GROUNDED]
        contact = {"name": "sole", "type": "rigid", "between": between, "friction": 5.0}
        return mbd.scene_from({**entries, "contacts": [contact]}, urdf=robot)

    x = 0.1 * (1.0 + mass) * G / (mass * G + stiffness * height)
    t = math.acos(-x / 0.15) / math.sqrt(stiffness / mass)
    (event,) = (one for one in _events(standing(-0.2, 0.1), t + 0.01) if one.ends_phase)
    assert event.t == pytest.approx(t, abs=1e-9)
    with pytest.raises(MbdError, match="contact sole is held and would tip about an edge"):
        _events(standing(-0.1, 0.2), 0.1)
