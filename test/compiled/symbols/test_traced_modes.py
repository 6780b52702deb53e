"""Rows that give way: a mode of a traced scene says what the plain tier says in it."""

import numpy as np
import pytest
from traced_scenes import EXACT, called, conditions, scene_of

from mbd_ros.compiled.symbols.trace import trace
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.state import State
from mbd_ros.methods.events.mode_field import ModeField
from mbd_ros.methods.projection.assembly import assemble

ROPE = {"points": [{"frame": "world", "xyz": [0.1, 0.0, 1.0]}, {"frame": "foot"}]}
SWING = {"amplitude": 0.2, "angular_frequency": 3.0}
MODES = [(1, 1, 0, 1), (0, 1, 0, 1), (1, 0, 1, 0), (1, -1, -1, 1), (1, 0, 0, 1)]
DRIVEN = {"prosthetic_leg": "knee_slide_y", "four_bar_leg": "knee_tibial"}


def giving_way(name):
    scene = scene_of(name)
    drive = {"type": "prescribed_motion", "joint": DRIVEN[name], "harmonic": SWING, "limit": 20.0}
    rows = [
        {"type": "joint_stop", "joint": "ankle", "lower": -0.3, "upper": 0.35},
        {"type": "dry_friction", "joint": "hip_flexion", "limit": 0.8},
        drive,
        {"type": "rope", "path": ROPE, "length": 1.5},
    ]
    return scene.with_(constraints=[*(scene.entries.get("constraints") or ()), *rows])


@pytest.mark.parametrize("name", DRIVEN)
def test_a_mode_has_the_accelerations_multipliers_and_margins_of_the_plain_tier(name):
    system, rng = giving_way(name).system(), np.random.default_rng(0)
    field, u = ModeField(system, with_surfaces=False), system.loads.idle
    for mode in MODES:
        traced = trace(system, mode=mode)
        for _ in range(3):
            q, v = rng.uniform(-0.5, 0.5, system.nv), rng.normal(size=system.nv)
            y = assemble(system, State(0.3, q, v))._replace(mode=mode)
            expected = system.evaluate(system.expand(y)._replace(mode=mode), u)
            a, lam = called(traced.function("multipliers"), y, u)
            own, *_ = called(traced.function("accelerate"), y, u)
            bound = 100.0 * EXACT * conditions(system, y)
            assert np.abs(a - expected.a).max() <= bound * np.abs(expected.a).max()
            assert np.abs(lam - expected.lam).max() <= bound * np.abs(expected.lam).max()
            np.testing.assert_allclose(own, system.integrated(a), rtol=1e-12)
            margins, found = field.margins(y, u, mode), called(traced.function("guards"), y, u)[0]
            assert set(traced.margins) == set(margins)
            largest = max(map(abs, margins.values()))
            for key, value in zip(traced.margins, found, strict=True):
                assert value == pytest.approx(margins[key], abs=bound * largest)


@pytest.mark.parametrize(
    ("name", "message"),
    [("controlled_leg", "only in a given mode"), ("sphere_on_plane", "contacts that slip")],
)
def test_rows_without_a_form_are_named(name, message):
    system = scene_of(name).system()
    mode = () if name == "controlled_leg" else (0, 5, 15)
    with pytest.raises(Untraceable, match=message):
        trace(system, mode=mode)
