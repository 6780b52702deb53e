"""Weights from which learning goes on: they come back; what does not belong together is named."""

import json

import numpy as np
import pytest
from learned_torque import scales, weights

from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.linear_corrections import SampleStatistics
from mbd_ros.features.identification.learn.task import LearnedModel
from mbd_ros.features.identification.learn.weights_file import (
    WEIGHTS,
    read_folder,
    weights_file,
)
from mbd_ros.methods.learned_model import About

M, P = 2, 5


def learned(kind):
    wall = np.ones(2 * M)
    about = About(kind, "arm", ("a", "b"), -wall, wall, {"gravity": [0.0, 0.0, -9.8]})
    known = SampleStatistics(np.ones((M, P + 2, P + 2)), np.full(M, 30.0), np.ones(M))
    return LearnedModel(about, scales(M), weights(kind, M), np.ones(M), known, np.zeros(P))


@pytest.mark.parametrize("kind", ["free", "structured"])
def test_weights_come_back(kind, tmp_path):
    given = learned(kind)
    (tmp_path / WEIGHTS).write_bytes(weights_file(given))
    found = read_folder(tmp_path)
    assert found.about.text() == given.about.text()
    assert found.weights.keys() == given.weights.keys()
    for pair in zip(found.weights.values(), given.weights.values(), strict=True):
        assert np.array_equal(*pair)
    for key in ("scales", "known"):
        assert all(map(np.array_equal, getattr(found, key), getattr(given, key)))


def about(**changes):
    text = json.loads(learned("free").about.text())
    return np.array(json.dumps({**text, **changes}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trust": None}, "array 'trust' is missing"),
        ({"weight.W9": np.ones(3)}, "array 'weight.W9' is unknown; accepted are weight.W1"),
        ({"weight.W1": np.ones((3, 8, 5))}, r"'weight.W1' has shape \(3, 8, 5\) of float64"),
        ({"weight.b1": np.float64(1.0)}, r"'weight.b1' and 'weight.b2' have shapes \(\)"),
        ({"weight.b3": np.ones((3, 2), np.float32)}, "of float32; accepted is .* of float64"),
        ({"scale.q": np.array([1.0, np.nan])}, "array 'scale.q' has numbers that are not finite"),
        ({"scale.v": np.array([1.0, 0.0])}, "array 'scale.v' has numbers that are not above 0"),
        ({"trust": np.array([1.0, 2.0])}, "array 'trust' has numbers outside of 0 .. 1"),
        ({"numbers": np.zeros(3)}, "array 'known.triangle' has shape"),
        ({"about": np.array("[" * 100_000)}, "has no valid description of its model"),
        ({"about": np.array("7")}, "has no valid description of its model"),
        ({"about": np.zeros(3)}, "has no valid description of its model"),
        ({"about": about(kind="other")}, "has an unknown kind, accepted: free, struct"),
        ({"about": about(joints="ab")}, "joints must be a list of different names"),
        ({"about": about(joints=["a", "a"])}, "joints must be a list of different names"),
        ({"about": about(low=[10**400] * 4)}, "has no valid description of its model"),
        ({"about": about(version="x" * 5000)}, "has version x* of learned models"),
        ({"about": about(robot=[1])}, "has no valid description of its model"),
    ],
)
def test_what_does_not_belong_together_is_named(changes, message, tmp_path):
    path = tmp_path / WEIGHTS
    path.write_bytes(weights_file(learned("free")))
    with np.load(path) as file:
        arrays = {**file} | changes
    np.savez(path, **{key: array for key, array in arrays.items() if array is not None})
    with pytest.raises(DataError, match=message) as refused:
        read_folder(tmp_path)
    assert str(path) in str(refused.value)
