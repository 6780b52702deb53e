"""Corrections of inertias, friction and stiffness from few samples, without torch."""

import numpy as np
import pytest
from worn_leg import LEG, worn_leg

import mbd_ros as mbd
from mbd_ros.features.identification.learn.fitting import Recordings, relative_error
from mbd_ros.features.identification.learn.linear_corrections import Columns, solve_corrections
from mbd_ros.features.identification.learn.task import Task
from mbd_ros.features.identification.learn.training_samples import Scales, is_better, trusted_share

WALK = 1.2, (0.35, 0.5, 0.2), (0.05, -0.5, 0.0)  # s, rad, rad: stride, amplitudes, middles
RUN = 0.6, (0.5, 0.75, 0.3), (0.1, -0.7, 0.0)
NOISE = 0.6  # N·m


def true_leg():
    """The worn leg with sharp friction and a spring."""
    return worn_leg(0.02, {"type": "joint_spring", "joint": "ankle", "stiffness": 25.0})


def recorded(true, kind, strides, rate, random=None):
    """Positions and efforts; without noise velocities and accelerations, too."""
    period, amplitude, middle = kind
    t = np.arange(0.0, strides * period, 1.0 / rate)
    q, v, a = np.zeros((3, len(t), 3))
    for h, share in ((1, 1.0), (2, 0.35)):
        w = 2.0 * np.pi * h / period
        phase = w * t[:, None] + h * np.array([0.0, 0.9, 1.8]) + (0.0 if random is None else 0.3)
        A = share * np.array(amplitude)
        q, v, a = q + A * np.sin(phase), v + A * w * np.cos(phase), a - A * w**2 * np.sin(phase)
    tau = true.inverse_dynamics().batch(q + middle, v, a).tau
    values = {"position": q + middle, "effort": tau, "velocity": v, "acceleration": a}
    if random is not None:
        noise = NOISE * random.normal(size=tau.shape)
        values = {"position": q + middle, "effort": tau + noise}
    columns = [mbd.Column("time", t, "s")]
    for j, name in enumerate(true.couplings.independent):
        columns += [mbd.Column(f"{name}.{key}", x[:, j]) for key, x in values.items()]
    return mbd.Result({"samples": mbd.Table(columns)})


def samples_of(scene, result):
    recordings = Recordings(scene, Task([result]), lambda line: None)
    return recordings.samples(scene, recordings.every)


@pytest.mark.parametrize("rate", [100, 500])
def test_a_payload_friction_and_a_spring_from_a_trial(rate):
    """As fine as the noise lets, at 500 Hz as well: a low-pass of efforts rounds dry friction."""
    true, leg, random = true_leg(), mbd.load_scene(LEG), np.random.default_rng(4)
    walk, run = (
        samples_of(leg, recorded(true, kind, strides, rate, random))
        for kind, strides in ((WALK, 4), (RUN, 2))
    )
    columns = Columns(leg, leg.couplings.independent, Scales.of(walk, walk.effort - walk.physics))
    known = [columns.statistics(one, np.zeros_like(one.q)) for one in (walk, run)]
    numbers = columns.limit(solve_corrections(known[0].merge(known[1]), uses_network=False))
    test = samples_of(leg, recorded(true, RUN, 1, rate))
    found = relative_error(test.physics + columns.torque(test, numbers), test.measured)
    assert relative_error(test.physics, test.measured) > 0.2
    assert found < {100: 0.0012, 500: 0.0005}[rate]


def test_what_holds_in_one_block_alone_is_not_trusted():
    random = np.random.default_rng(0)
    wanted = random.normal(size=(100, 2))
    said = wanted + 0.3 * random.normal(size=(100, 2))
    share = trusted_share(said, wanted, 5, together=False)
    assert ((share > 0.8) & (share <= 1.0)).all()
    said[20:] = random.normal(size=(80, 2))
    assert not trusted_share(said, wanted, 5, together=False).any()
    best = np.full(5, 1.0)
    assert is_better(0.5 * best, best) and not is_better(0.95 * best, best)
    assert not is_better(np.array([0.1, 1.1, 1.1, 1.1, 1.1]), best)
