"""Standard deviations of base parameters against the scatter of many noisy recordings."""

import numpy as np
import pytest
from identification_data import moved

from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import DelaySearch, regress
from mbd_ros.features.identification.samples import Filter, grid_step
from mbd_ros.features.identification.task import Task
from mbd_ros.scene.from_python import scene_from

NOISE = np.array([0.3, 0.6, 0.3, 0.3, 0.1, 0.1, 0.03])  # N·m


def hits(trials):
    """Share of the trials in which each base parameter is within 1.96 of its deviation."""
    scene, t = scene_from({}, urdf="arm7"), np.arange(0.0, 12.0, 0.01)
    data = moved(scene, scene, t, frequency=0.25, amplitude=0.4)
    problem = Problem(scene, Task([data], learned=1.0), lambda line: None)
    (block,) = problem.blocks(np.zeros(1))
    rate = 1.0 / problem.step
    step = grid_step(rate, problem.band)
    low, random = Filter.of(rate / step, problem.band), np.random.default_rng(8)
    r, found = len(problem.base.chosen), []
    true = problem.base.values(problem.nominal.ravel())
    for _ in range(trials):
        noise = low.apply(NOISE * random.normal(size=(len(t), 7))[::step])
        noisy = block._replace(Y=block.Y + noise[: len(block.X), :, None])
        about = (), DelaySearch(0.0, 0.0), problem.correlation
        one = regress(lambda delays, rows=noisy: [rows], problem.columns, r, *about)
        deviation = np.sqrt(np.diag(one.covariance))
        found.append(np.abs(one.fit.base - true) < 1.96 * deviation)
    return np.mean(found, axis=0)


def test_estimates_scatter_as_they_say():
    """12 x 43 estimates: 95 % within 1.96 deviations, to 3 sigma of that share."""
    assert hits(12).mean() == pytest.approx(0.95, abs=0.035)


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_every_estimate_scatters_as_it_says():
    """95 +- 3 % of 500 trials for every base parameter."""
    assert np.abs(hits(500) - 0.95).max() <= 0.03
