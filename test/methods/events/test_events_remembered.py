"""Checkpoints through events and internal states: the bits, and the events, are the same."""

import pickle

import numpy as np
import pytest
from row_systems import joint, link

import mbd_ros as mbd
from mbd_ros.core.state import is_same

ARM = "".join(
    (
        *(link("world"), link("upper", 1.0, "0 0 -0.5"), link("lower", 0.5, "0 0 -0.4")),
        joint("shoulder", "revolute", "world", "upper", "0 1 0"),
        joint("elbow", "revolute", "upper", "lower", "0 1 0"),
    )
)
DRIVE = {
    **{"type": "series_elastic_drive", "name": "drive", "joint": "elbow", "stiffness": 40.0},
    **{"rotor_inertia": 1e-3, "ratio": 10.0},
}
SECTIONS = {
    "constraints": [
        {"type": "joint_stop", "joint": "shoulder", "lower": -0.4, "restitution": 0.7},
        {"type": "joint_stop", "joint": "elbow", "lower": -0.6, "upper": 0.6},
        {"type": "dry_friction", "joint": "elbow", "limit": 0.4},
    ],
    "actuators": [DRIVE],
    "initial": {
        "position": {"shoulder": 0.5, "elbow": 0.2},
        "velocity": {"shoulder": -3.0, "elbow": 2.0},
    },
    "dt": 5e-3,
}
METHODS = [
    *({"type": kind} for kind in ("rk4", "dop853", "gauss_legendre", "adams")),
    {"type": "dopri5", "tolerance": 1e-8},
]
SPAN = 0.7


def scene(**more):
    return mbd.scene_from({**SECTIONS, **more}, urdf=f"<robot name='r'>{ARM}</robot>")


def same_events(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert a[:2] == b[:2]
        assert is_same(a.before, b.before) and is_same(a.after, b.after)
        assert a.impulse.tobytes() == b.impulse.tobytes()


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method["type"])
@pytest.mark.parametrize("drives", [[DRIVE], None], ids=["internal", "plain"])
def test_a_checkpoint_continues_through_events_with_the_same_bits(method, drives):
    """Checkpoints beside every event, and right before and after the first impact."""
    loaded = scene(integrator=method, actuators=drives)
    made, states, kept = loaded.simulation(), [], []
    for x in made.run(loaded.initial, SPAN):
        kept.append(pickle.dumps(made.checkpoint()))
        states.append(x)
    assert len(made.events) >= 3
    assert any(event.impulse.any() for event in made.events)
    at = {int((event.t - states[0].t) / made.dt) + k for event in made.events for k in (0, 1)}
    for k in sorted(at)[:4]:
        again = loaded.simulation()
        rest = list(again.run(pickle.loads(kept[k]), SPAN))
        assert all(is_same(a, b) for a, b in zip(states[k + 1 :], rest, strict=True))
        same_events(again.events, made.events)
        assert again.steps == made.steps


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method["type"])
def test_a_run_goes_back_to_a_checkpoint_of_its_own(method):
    """As a search or a controller that looks ahead does: nothing that was since is left."""
    loaded = scene(integrator=method)
    made = loaded.simulation()
    y = made.start(loaded.initial)
    y = made.advance(y, np.zeros(1), 0.1)
    kept = made.checkpoint()
    ahead = made.advance(y, np.array([0.3]), 0.6)
    count = len(made.events)
    y = made.resume(kept)
    again = made.advance(y, np.array([0.3]), 0.6)
    assert is_same(ahead, again)
    assert len(made.events) == count > 0
