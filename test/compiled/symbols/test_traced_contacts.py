"""Contacts of smooth shapes: asked with symbols they give what they give with numbers."""

import numpy as np
import pytest
from contact_pairs import BODIES, OTHERS, SMOOTH, random_states
from mechanisms import scene_of
from symbolic_numbers import Symbols

from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.kinematics.kinematics import Kinematics

EXACT = 1e-13  # of the largest entry: fractions of lengths, 100 m from the origin 1e-11
SHAPES = SMOOTH | {
    "points over balls": (
        "{frame: pill, points: [[0.1, 0, 0], [0, 0.2, 0.1]]}",
        "{frame: ball, points: [[0.3, 0, 0], [0.1, 0.2, -0.1], [0, 0.1, 0.4]]}",
        6,
    ),
}


def part_of(a, b, more=""):
    entry = f"{{type: rigid, between: [{a}, {b}], friction: 0.5{more}}}"
    scene = scene_of(f"{BODIES}contacts: [{entry}]\n")
    return scene, scene.constraints[0]


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (100.0, -60.0, 30.0)], ids=["near", "far"])
@pytest.mark.parametrize(("a", "b", "count"), SHAPES.values(), ids=SHAPES)
def test_rows_of_symbols_have_the_numbers_of_the_rows(a, b, count, place):
    scene, part = part_of(a, b, ", margin: 0.01")
    symbols, k = Symbols(scene.robot), Kinematics(scene.robot)
    asked = part.residual, part.jacobian, part.drift
    traced = [method(symbols.k, symbols.x) for method in asked]
    traced += part.accelerations(symbols.k, symbols.x)
    assert len(traced[0]) == 3 * count
    for x in random_states(scene, 3, place):
        k.refresh(x.q, x.v)
        expected = [method(k, x) for method in asked]
        expected += expected[1:]
        for expression, numbers in zip(traced, expected, strict=True):
            found = symbols.number(expression, x).reshape(numbers.shape)
            bound = EXACT * max(1.0, np.abs(numbers).max(), np.abs(x.q).max())
            assert np.abs(found - numbers).max() <= bound


@pytest.mark.parametrize(("a", "b", "count"), OTHERS.values(), ids=OTHERS)
def test_shapes_with_kinks_have_no_symbols(a, b, count):
    scene, part = part_of(a, b)
    symbols = Symbols(scene.robot)
    with pytest.raises(Untraceable), tracing(part):
        part.residual(symbols.k, symbols.x)
