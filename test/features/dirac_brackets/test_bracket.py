"""Dirac brackets: a particle on a sphere by hand, identities at random states, and motion."""

import math
import re

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.features.dirac_brackets.job import phase_space

SCENES = ("particles/sphere", "particles/trimer", "particles/ring_of_one_branch", "heat_bath")


@pytest.mark.parametrize("scene", ["particles/sphere", "benchmark/p01_spherical_pendulum"])
def test_a_particle_on_a_sphere(scene):
    """{x_i, p_j} = delta_ij - x_i x_j / R^2, {p_i, p_j} = (x_j p_i - x_i p_j) / R^2."""
    space = phase_space(mbd.load_scene(scene))
    table, q, p = space.bracket.table(space.q, space.momentum), space.q, space.momentum
    assert table[:3, :3] == pytest.approx(np.zeros((3, 3)), abs=1e-15)
    assert table[:3, 3:] == pytest.approx(np.eye(3) - np.outer(q, q), abs=1e-12)
    assert table[3:, 3:] == pytest.approx(np.outer(p, q) - np.outer(q, p), abs=1e-12)
    assert np.abs(p).max() > 0.1


def test_expressions_of_a_sphere_hold_everywhere():
    """They are those of |x|^2 = R^2 on every sphere about the centre."""
    space = phase_space(mbd.load_scene("particles/sphere"))
    written = space.bracket.expressions(space.names)
    x, p = np.random.default_rng(1).normal(size=(2, 3))
    p -= x * (x @ p) / (x @ x)
    for (one, other), text in written.items():
        i, j = "xyz".index(one[-1]), "xyz".index(other[-1])
        if one.startswith("p_"):
            expected = (x[j] * p[i] - x[i] * p[j]) / (x @ x)
        else:
            expected = (i == j) - x[i] * x[j] / (x @ x)
        assert evaluated(text, x, p) == pytest.approx(expected, abs=1e-12), (one, other)
    assert len(written) == 12


def evaluated(text, x, p):
    """An expression of CasADi with common parts @1, @2, .. before it."""
    names = {"sq": lambda a: a * a, "sqrt": math.sqrt}
    for k, axis in enumerate("xyz"):
        names |= {f"bob_{axis}": x[k], f"p_bob_{axis}": p[k]}
    text = text.replace("bob.", "bob_").replace("@", "part_")
    *parts, last = re.split(r", (?=part_\d+=|\(|-|[a-z])", text)
    for part in parts:
        name, _, value = part.partition("=")
        names[name] = eval(value, {}, names)
    return eval(last, {}, names)


@pytest.mark.parametrize("scene", SCENES)
def test_identities_at_random_states(scene):
    """They hold wherever rows are independent, not on the rows alone."""
    space = phase_space(mbd.load_scene(scene))
    random = np.random.default_rng(0)
    for _ in range(3):
        q = space.q + 0.1 * random.normal(size=len(space.q))
        p = random.normal(size=len(q))
        table = space.bracket.table(q, p)
        assert (table == -table.T).all() or np.abs(table + table.T).max() < 1e-12
        assert space.bracket.jacobi(q, p) < 1e-10
        assert space.bracket.casimirs(q, p) < 1e-10


@pytest.mark.parametrize("scene", [*SCENES, "press", "arm7", "prosthetic_arm"])
def test_motion_by_the_bracket_is_motion_by_multipliers(scene):
    """Loops, friction, springs, dependent joints; motion along the rows."""
    checks = mbd.load_scene(scene).bracket()["checks"]
    assert checks["motion"][0] < 1e-9
    assert checks["casimirs"][0] < 1e-10


def test_the_command_writes_a_table(tmp_path, capsys):
    out = tmp_path / "o.csv"
    assert main(["bracket", "particles/sphere", "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "3 coordinates, 1 independent constraints" in said
    assert "{bob.x, p_bob.x} = " in said
    table = np.genfromtxt(out, delimiter=",", names=True, deletechars="")
    assert len(table) == 6


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        ("free_flyer", "free bodies"),
        ("stack", "contacts"),
        ("controlled_leg", "bilateral constraints"),
        ("particles/nothing", "no such file"),
    ],
)
def test_scenes_without_brackets_say_why(scene, expected, capsys):
    assert main(["bracket", scene]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert len(error.splitlines()) == 1
