"""Muscles against what OpenSim 4.6 says of public models, and against one another."""

import numpy as np
import pytest
from opensim_muscles import ANY_PATH, at_times, columns, muscles
from places import RECORDINGS

from mbd_ros.core.muscles.curves import ArrayNumbers
from mbd_ros.core.muscles.rigid_tendons import RigidTendons
from mbd_ros.errors import SceneError
from mbd_ros.scene.from_python import scene_from

SETS = ("arm26/muscles", "gait10dof/muscles")
LEVELS = {"0.05": 0.05, "0.5": 0.5, "1": 1.0}
DIGITS = 1e-9  # of what a table with ten digits says
SIZES = {"max_isometric_force": 600.0, "optimal_fiber_length": 0.1, "tendon_slack_length": 0.2}


def some(kind, **more):
    """A muscle of a type."""
    entry = {"type": kind, "name": "m", "path": ANY_PATH, **SIZES, **more}
    (part,) = scene_from({"muscles": [entry]}, urdf="prosthetic_leg").muscles
    return part


def moved(folder, table):
    """A table and the lengths and speeds of the paths at its times."""
    found = columns(folder / table)
    return found, at_times(columns(folder / "lengths.csv.gz"), found["time"])


@pytest.mark.parametrize("prefix", ["", "no_wrap_"])
def test_rigid_forces_of_thelen_are_those_of_opensim(prefix):
    folder = RECORDINGS / SETS[0]
    said = columns(folder / f"{prefix}rigid_tendon.csv.gz")
    paths = at_times(columns(folder / f"{prefix}lengths.csv.gz"), said["time"])
    for part in muscles(folder, tendon="rigid"):
        name, law = part.name, part.contraction
        length, speed = paths[f"{name}.length"], paths[f"{name}.speed"]
        fiber = law.beside_rigid_tendon(ArrayNumbers, length, speed)
        for level, a in LEVELS.items():
            force = law.active(ArrayNumbers, a, fiber) * fiber.cosine
            assert force == pytest.approx(said[f"{name}.active_force_a{level}"], rel=DIGITS)
        assert part.active_force(length, speed) == pytest.approx(force, rel=1e-15)
        passive = said[f"{name}.passive_force"]
        assert part.passive_force(length) == pytest.approx(passive, rel=1e-7, abs=1e-7)
        assert part.fiber_length(length) == pytest.approx(said[f"{name}.fiber_length"], rel=DIGITS)


def test_rigid_forces_of_millard_are_those_of_opensim():
    """OpenSim's own rigid mode; its `calcInextensibleTendonActiveFiberForce` is wrong."""
    folder = RECORDINGS / SETS[1]
    said, paths = moved(folder, "rigid_tendon_millard_mode.csv.gz")
    for part in muscles(folder, tendon="rigid"):
        name = part.name
        length, speed = paths[f"{name}.length"], paths[f"{name}.speed"]
        fiber = part.contraction.beside_rigid_tendon(ArrayNumbers, length, speed)
        for level, a in LEVELS.items():
            force = part.contraction.rigid_tension(ArrayNumbers, a, length, speed)
            wanted = said[f"{name}.tendon_force_a{level}"]
            assert force == pytest.approx(wanted, rel=DIGITS, abs=1e-12)
            active = said[f"{name}.active_fiber_force_a{level}"]
            found = part.contraction.active(ArrayNumbers, a, fiber)
            assert found == pytest.approx(active, rel=2e-9, abs=1e-12)
        by_level = part.active_force(length, speed) / fiber.cosine
        assert by_level == pytest.approx(active, rel=2e-9, abs=1e-12)


@pytest.mark.parametrize("name", SETS)
def test_static_fibres_beside_elastic_tendons_are_those_of_opensim(name):
    """Force within 1e-4 N; OpenSim stops within some 1e-8 m/s of rest."""
    folder = RECORDINGS / name
    said, paths = moved(folder, "elastic_static.csv.gz")
    for part in muscles(folder):
        length, law = paths[f"{part.name}.length"], part.contraction
        for level, a in LEVELS.items():
            fiber_length = said[f"{part.name}.fiber_length_a{level}"]
            force = law.tendon(ArrayNumbers, length, fiber_length)
            assert force == pytest.approx(said[f"{part.name}.tendon_force_a{level}"], abs=1e-4)
            fiber = law.beside_elastic_tendon(ArrayNumbers, a, length, fiber_length)
            assert fiber.velocity == pytest.approx(0.0, abs=2e-7)


@pytest.mark.parametrize("name", SETS)
def test_velocity_of_given_fibres_is_that_of_opensim(name):
    """Within 1e-8 of the largest speed; fibre lengths have ten digits, an entry is missing."""
    folder = RECORDINGS / name
    said, paths = moved(folder, "elastic_moving.csv.gz")
    compared = 0
    for part in muscles(folder):
        length, law = paths[f"{part.name}.length"], part.contraction
        for level, a in LEVELS.items():
            given = said[f"{part.name}.fiber_length_a{level}"]
            wanted = said[f"{part.name}.fiber_velocity_a{level}"]
            there = np.isfinite(given) & np.isfinite(wanted)
            fiber = law.beside_elastic_tendon(ArrayNumbers, a, length[there], given[there])
            lack = np.abs(fiber.velocity - wanted[there]) / law.fastest
            assert lack.max() < 5e-8
            compared += int(there.sum())
    assert compared > 2000


@pytest.mark.parametrize("kind", ["thelen", "millard", "degroote_fregly"])
def test_forces_of_many_muscles_at_once_are_those_of_each(kind):
    """Tables leave 1e-12 of the peak force; beyond them there is no difference."""
    rng = np.random.default_rng(4)
    parts = [some(kind, pennation_angle=angle, tendon="rigid") for angle in (0.0, 0.3, 0.5)]
    several = RigidTendons([part.contraction for part in parts])
    inside = 0.2 + rng.uniform(0.03, 0.2, (200, 3)), rng.uniform(-1.5, 1.5, (200, 3))
    beyond = 0.2 + rng.uniform(0.03, 0.4, (9, 3)), rng.uniform(-4.0, 4.0, (9, 3))
    for length, speed in (inside, beyond):
        found = several.at(length, speed)
        for i, part in enumerate(parts):
            at = length[:, i], speed[:, i]
            assert found.active[:, i] == pytest.approx(
                part.active_force(*at), rel=1e-12, abs=6e-10
            )
            assert found.passive[:, i] == pytest.approx(
                part.passive_force(at[0]), rel=1e-12, abs=6e-10
            )
            assert found.fiber_length[:, i] == pytest.approx(part.fiber_length(at[0]), rel=1e-15)
            assert found.fiber_velocity[:, i] == pytest.approx(part.fiber_velocity(*at), rel=1e-14)
        one = several.at(length[3], speed[3])
        assert one.active == pytest.approx(found.active[3], rel=1e-14, abs=1e-12)


@pytest.mark.parametrize("kind", ["thelen", "millard", "degroote_fregly"])
@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"pennation_angle": 1.5}, "must be below maximum_pennation_angle 1.47063"),
        ({"tendon_slack_length": 0.0}, "must be positive for an elastic tendon"),
        ({"minimum_activation": 0.0}, "minimum_activation: 0 is out of range"),
        ({"tendon": "soft"}, "tendon: expected one of elastic, rigid, got 'soft'"),
        ({"max_isometric_force": -3.0}, "max_isometric_force: -3 is out of range"),
        ({"path": "none"}, "no path 'none', accepted: none: the scene has no `paths`"),
    ],
)
def test_bad_numbers_are_refused_by_name(kind, more, said):
    entry = {"type": kind, "name": "m", "path": ANY_PATH, **SIZES, **more}
    with pytest.raises(SceneError, match=said):
        scene_from({"muscles": [entry]}, urdf="prosthetic_leg")


def test_a_muscle_may_have_the_name_of_its_path():
    scene = scene_from(
        {
            "paths": {"soleus": ANY_PATH},
            "muscles": [{"type": "thelen", "name": "soleus", "path": "soleus", **SIZES}],
        },
        urdf="prosthetic_leg",
    )
    assert [part.name for part in scene.muscles] == ["soleus"]
    assert scene.inputs.names == ("soleus.excitation",)
    assert scene.internals.names == ("soleus.activation", "soleus.fiber_length")
    assert scene.forces == ()


def test_curves_of_degroote_fregly_are_those_of_opensim():
    """Values of `DeGrooteFregly2016Muscle` of OpenSim 4.6 with its defaults."""
    curves = some("degroote_fregly").contraction.curves
    length = np.array([0.4, 0.8, 1.1, 1.6])
    active = [0.025541217564830628, 0.8364395661146519, 0.9531594169846643, 0.12425503853974908]
    passive = [0.0002470574857921233, 0.004739942143981772, 0.03558871336134531, 1.0]
    stretch = 0.97 + 0.09 / 17.0 * np.array([2.0, 6.0, 9.0, 14.0])
    tendon = [-0.10165352641102035, 0.01333133471136927, 0.18130855083105402, 0.8037980959517959]
    speed = -1.2 + 2.4 / 17.0 * np.array([2.0, 6.0, 9.0, 14.0])
    factor = [0.02872915713187063, 0.3532973649740998, 1.153894619176268, 1.717801732451405]
    k = ArrayNumbers
    assert curves.active(k, length) == pytest.approx(active, abs=1e-14)
    assert curves.passive(k, length) == pytest.approx(passive, abs=1e-14)
    assert curves.tendon(k, stretch) == pytest.approx(tendon, abs=1e-13)
    at_speed = curves.fiber(k, 1.0, 1.0, speed) / curves.active(k, 1.0)
    assert at_speed == pytest.approx(factor, abs=1e-13)


@pytest.mark.parametrize("kind", ["thelen", "millard", "degroote_fregly"])
def test_energies_are_integrals_of_their_forces_and_speeds_invert_them(kind):
    curves, k, h = some(kind).contraction.curves, ArrayNumbers, 1e-5
    for area, force, low, high in (
        (curves.passive_area, curves.passive, 0.6, 1.6),
        (curves.tendon_area, curves.tendon, 1.0005, 1.06),
    ):
        x = np.linspace(low, high, 41)
        slope = (area(k, x + h) - area(k, x - h)) / (2.0 * h)
        assert slope == pytest.approx(force(k, x), abs=2e-7)
    rng = np.random.default_rng(2)
    a, length = rng.uniform(0.01, 1.0, 300), rng.uniform(0.5, 1.7, 300)
    speed = rng.uniform(-1.5, 1.5, 300)
    force = curves.fiber(k, a, length, speed) + curves.passive(k, length)
    force = force + curves.damping_force(speed)
    assert curves.speed(k, a, length, force) == pytest.approx(speed, abs=1e-9)


def test_a_controller_refuses_muscles():
    entry = {"type": "thelen", "name": "m", "path": ANY_PATH, **SIZES}
    scene = scene_from({"muscles": [entry]}, urdf="prosthetic_leg")
    with pytest.raises(SceneError, match="a controller drives actuators but no muscles"):
        scene.controlled_joints()
