"""Scenes as expressions: what they say equals what the plain tier says."""

from pathlib import Path

import numpy as np
import pytest
from complex_steps import slopes
from traced_scenes import EXACT, SCENES, called, conditions, scene_of, states, tangent

from mbd_ros.compiled.symbols.trace import trace
from mbd_ros.compiled.symbols.untraceable import Untraceable

DEPENDENT = {"a04_bricard", "x09_cranks", "x09_cranks_offset"}  # rows without a split of their own
TRACED = (
    *("arm7", "empty", "four_bar_leg", "free_flyer", "muscle_arm", "muscle_leg"),
    *("prosthetic_arm", "prosthetic_leg"),
    "prosthetic_leg_stance",
    *(f"benchmark/{path.stem}" for path in sorted((SCENES / "benchmark").glob("*.yaml"))),
)
KEPT_PLAIN = {"benchmark/s01_parabola": "switching_force", "benchmark/a02_four_bars_40": ""}


@pytest.mark.parametrize("name", [name for name in TRACED if name not in KEPT_PLAIN])
def test_accelerations_and_multipliers_are_those_of_the_plain_tier(name):
    system = scene_of(name).system()
    traced = trace(system)
    for y, u in states(system):
        expected = system.evaluate(system.expand(y), u)
        a, lam = called(traced.function("multipliers"), y, u)
        own, zdot, health = called(traced.function("accelerate"), y, u)
        if Path(name).stem in DEPENDENT:
            assert not abs(health.item()) > traced.least_health or not np.isfinite(own).all()
            continue
        bound = EXACT * max(1.0, conditions(system, y) / 100.0)
        assert np.abs(a - expected.a).max() <= bound * np.abs(expected.a).max()
        np.testing.assert_allclose(own, system.integrated(a), rtol=1e-12)
        np.testing.assert_allclose(zdot, expected.zdot, rtol=1e-13, atol=1e-13)
        if len(expected.lam):
            assert health.item() > traced.least_health
            assert np.abs(lam - expected.lam).max() <= bound * np.abs(expected.lam).max()


def test_what_cannot_be_traced_is_named():
    with pytest.raises(Untraceable, match="switching_force"):
        trace(scene_of("benchmark/s01_parabola").system()).function("accelerate")


SLOPED = [name for name in TRACED if Path(name).stem not in {*DEPENDENT, "x06_chain"}]  # too long


@pytest.mark.parametrize("name", [name for name in SLOPED if name not in KEPT_PLAIN])
def test_derivatives_are_those_of_complex_steps(name):
    system = scene_of(name).system()
    traced, model = trace(system), system.chart.model
    accelerate, derivatives = (traced.function(key) for key in ("accelerate", "derivatives"))
    for y, u in states(system, 2):
        given = np.array([y.t]), y.q, y.v, y.z, u, np.zeros(0)
        found = [np.array(one) for one in derivatives(*given)]
        for by, got in enumerate(found, 1):
            expected = slopes(accelerate, by, *given)[: traced.nv + traced.nz]
            if by == 1 and model.nq > model.nv:
                expected = expected @ tangent(model, y.q)
            size = np.abs(expected).max(initial=0.0)
            assert np.abs(got - expected).max(initial=0.0) <= 1e-9 * size


def test_derivatives_that_take_too_many_operations_are_refused():
    with pytest.raises(Untraceable, match="derivatives take some"):
        trace(scene_of("benchmark/x06_chain").system()).function("derivatives")


@pytest.mark.parametrize("name", ["arm7", "free_flyer", "prosthetic_leg", "four_bar_leg"])
def test_energies_and_charts_are_those_of_the_plain_tier(name):
    system = scene_of(name).system()
    traced, rng = trace(system), np.random.default_rng(8)
    for y, _ in states(system):
        both = traced.function("energy")(y.t, y.q, y.v, y.z, np.zeros(0))
        assert float(sum(both)) == pytest.approx(system.energy(y), rel=1e-12)
        for size in (1e-9, 1e-3, 0.3, 1.0):
            d = size * rng.normal(size=system.nv)
            moved = np.array(traced.function("integrate")(y.q, d)).ravel()
            np.testing.assert_allclose(moved, system.chart.integrate(y.q, d), rtol=0, atol=3e-14)
            rate = np.array(traced.function("rate")(d, y.v)).ravel()
            np.testing.assert_allclose(rate, system.chart.rate(d, y.v), rtol=0, atol=1e-12)
