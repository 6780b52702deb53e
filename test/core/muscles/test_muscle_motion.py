"""Muscles in motion: against OpenSim's own integration, against energy, and against chance."""

import gzip
import re
from array import array
from types import SimpleNamespace

import numpy as np
import pytest
from places import RECORDINGS, ROOT
from scipy.integrate import simpson
from simulator_plant import plant

from mbd_ros.api import load_scene, scene_from
from mbd_ros.core.loads.inputs import HeldTable
from mbd_ros.core.muscles.curves import ArrayNumbers
from mbd_ros.errors import DataError
from mbd_ros.features.simulation.job import simulate
from mbd_ros.files.table import MAIN
from mbd_ros.scene.describe.start_check import fiber_warnings

SCENES = ROOT / "config/scenes"
SIZES = {"max_isometric_force": 600.0, "optimal_fiber_length": 0.1, "tendon_slack_length": 0.2}
KINDS = ("thelen", "millard", "degroote_fregly")
PULLEY = {"joints": {"hinge": [0.33, -0.05]}}
PRECISE = {"type": "dop853", "tolerance": 1e-10}


def held(levels, times=(0.0,)):
    """Sources of excitations by muscle, one column of levels each."""
    return {
        name: HeldTable(np.array(times), np.reshape(level, (-1, 1)))
        for name, level in levels.items()
    }


def one(kind, **more):
    """A rod that a muscle flexes over a pulley."""
    muscle = {"type": kind, "name": "m", "path": PULLEY, "pennation_angle": 0.3, **SIZES, **more}
    first = {"position": {"hinge": 0.2}}
    given = {"muscles": [muscle], "initial": first, "integrator": PRECISE, "dt": 5e-4}
    return scene_from(given, urdf="pendulum")


@pytest.mark.parametrize("tendon", ["elastic", "rigid"])
@pytest.mark.parametrize("kind", KINDS)
def test_energy_grows_by_the_work_of_fibres_less_the_heat_of_dampers(kind, tendon, tmp_path):
    """To 1e-6 of what is exchanged; the excitation comes from a file and steps once."""
    given = tmp_path / "excitation.csv"
    given.write_text("time,m.excitation\n0.0,0.3\n0.2,0.05\n", encoding="utf-8")
    samples = simulate(one(kind, tendon=tendon), 0.4, efforts=given)[MAIN]
    energy, t = samples["energy"], samples["time"]
    work = simpson(samples["m.fiber_power"], x=t)
    heat = simpson(samples["m.damping_loss"], x=t)
    assert (heat > 0.0) == (kind != "thelen")
    assert np.ptp(energy) > 0.5
    assert energy[-1] - energy[0] == pytest.approx(work - heat, abs=1e-6 * np.ptp(energy))
    assert samples["m.excitation"][[0, 399, 400, -1]].tolist() == [0.3, 0.3, 0.05, 0.05]
    assert samples["m.length"] == pytest.approx(0.33 - 0.05 * samples["hinge.position"], abs=1e-12)
    assert samples["hinge.effort"] == pytest.approx(0.05 * samples["m.tension"], abs=1e-12)


def test_a_file_without_excitations_is_refused_by_name(tmp_path):
    (tmp_path / "other.csv").write_text("time,n.excitation\n0.0,0.3\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"no column m\.excitation"):
        simulate(one("thelen"), 0.1, efforts=tmp_path / "other.csv")


@pytest.mark.parametrize("kind", KINDS)
def test_fibres_of_a_stiff_tendon_are_those_of_a_rigid_one(kind):
    first = {"position": {"hinge": 0.2}, "internal": {"m": {"activation": 0.4}}}
    ends = []
    for scene in (one(kind, tendon_strain=1e-4), one(kind, tendon="rigid")):
        begun = scene.with_(initial=first)
        run = begun.simulation(sources=held({"m": 0.4})).run(begun.initial, 0.1)
        ends.append(list(run)[-1].q)
    assert ends[0] == pytest.approx(ends[1], abs=2e-4)


def test_undamped_fibres_of_degroote_fregly_follow_from_their_curve():
    """A m(v) = F in closed form, and as damping goes to 0."""
    law, damped = (one("degroote_fregly", damping=d).muscles[0].contraction for d in (0.0, 1e-9))
    a, length, force = (
        np.array([0.1, 0.5, 1.0]),
        np.array([0.8, 1.0, 1.1]),
        np.array([0.05, 0.4, 1.2]),
    )
    v = law.curves.speed(ArrayNumbers, a, length, force)
    carried = law.curves.fiber(ArrayNumbers, a, length, v) + law.curves.passive(
        ArrayNumbers, length
    )
    assert carried == pytest.approx(force, abs=1e-13)
    assert damped.curves.speed(ArrayNumbers, a, length, force) == pytest.approx(v, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_muscle_starts_at_rest(kind):
    scene = one(kind)
    simulation = scene.simulation(sources=held({"m": 0.7}))
    y = simulation.start(scene.initial, np.array([0.7]))
    assert y.z[0] == 0.7
    assert simulation.system.rates(y, np.array([0.7])) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_of_two_stable_lengths_the_shorter_one_is_taken_and_said():
    """A long tendon lets fibres rest on either side of their descending limb."""
    path = {"joints": {"hinge": [5.35, -0.05]}}
    scene = one("millard", tendon_slack_length=5.0, path=path)
    (part,), full = scene.muscles, np.array([1.0])
    short, long = part.stable_lengths(1.0, 5.34)
    assert (short, long) == (pytest.approx(0.1061, abs=1e-4), pytest.approx(0.1369, abs=1e-4))
    simulation = scene.simulation(sources=held({"m": 1.0}))
    y = simulation.start(scene.initial, full)
    assert y.z.tolist() == [1.0, short]
    for length in (short, long):  # pushed off they come back
        off = 1e-5 * np.array([[0.0, -1.0], [0.0, 1.0]])
        rates = [
            simulation.system.rates(y._replace(z=np.array([1.0, length]) + d), full)[1]
            for d in off
        ]
        assert rates[0] > 0.0 > rates[1]
    warnings = list(fiber_warnings(scene.robot, scene.muscles, scene.initial, full))
    assert len(warnings) == 1 and warnings[0].startswith("m: its fibres rest at 0.106")


ARM26 = {
    "TRIlong": 0.05,
    "TRIlat": 0.1,
    "TRImed": 0.15,
    "BIClong": 0.3,
    "BICshort": 0.4,
    "BRA": 0.3,
}
OPENSIM = {  # OpenSim 4.6, Manager at accuracy 1e-11, after 1 s from activation 0.05
    "q": [-0.2062526120697468, -3.5642924770645217],
    "v": [1.998811354636311, 3.0291611621318535],
}


@pytest.mark.parametrize("solver", ["plain", "compiled"])
def test_arm26_without_wraps_moves_as_in_opensim(tmp_path, solver):
    """A second of six muscles with elastic tendons; both are exact to some 1e-8."""
    packed = RECORDINGS / "arm26/muscles/raw/arm26.osim.gz"
    text = gzip.decompress(packed.read_bytes()).decode()
    bare = re.sub(r"<PathWrapSet.*?</PathWrapSet>", "<PathWrapSet/>", text, flags=re.DOTALL)
    (tmp_path / "arm26.osim").write_text(bare, encoding="utf-8")
    given = {
        "robot": {"osim": str(tmp_path / "arm26.osim")},
        "integrator": {"type": "dop853", "tolerance": 1e-10 if solver == "compiled" else 1e-7},
        "solver": {"type": solver},
        "dt": 0.1,
        "initial": {"internal": {name: {"activation": 0.05} for name in ARM26}},
    }
    scene = scene_from(given)
    end = list(scene.simulation(sources=held(ARM26)).run(scene.initial, 1.0))[-1]
    near = 5e-8 if solver == "compiled" else 5e-5
    assert end.q == pytest.approx(OPENSIM["q"], abs=near)
    assert end.v == pytest.approx(OPENSIM["v"], abs=near)


@pytest.mark.parametrize("name", ["muscle_arm", "muscle_leg"])
def test_energy_of_the_scenes_grows_by_the_work_of_their_muscles(name, tmp_path):
    """Steps of all excitations, away from lengths that jump; to 1e-6 of what is exchanged."""
    scene, rng = load_scene(SCENES / f"{name}.yaml"), np.random.default_rng(5)
    rows = [[0.0, *rng.uniform(0.02, 0.3, len(scene.muscles))]]
    rows.append([0.02, *rng.uniform(0.02, 0.3, len(scene.muscles))])
    header = ",".join(("time", *scene.inputs.names))
    np.savetxt(tmp_path / "u.csv", rows, delimiter=",", header=header, comments="")
    given = {"efforts": tmp_path / "u.csv", "dt": 5e-5, "integrator": PRECISE}
    samples = simulate(scene, 0.04, **given)[MAIN]
    power = [samples[f"{part.name}.fiber_power"] for part in scene.muscles]
    power += [-samples[f"{part.name}.damping_loss"] for part in scene.muscles]
    energy, work = samples["energy"], simpson(np.sum(power, axis=0), x=samples["time"])
    assert energy[-1] - energy[0] == pytest.approx(work, abs=1e-6 * np.ptp(energy))


def random_runs(name, count, duration):
    """Ends of runs with random excitations, with the scene."""
    scene = load_scene(SCENES / f"{name}.yaml").with_(solver={"type": "compiled"})
    rng = np.random.default_rng(12)
    times = np.arange(0.0, duration, 0.1)
    for _ in range(count):
        levels = {m.name: rng.uniform(0.0, 1.0, len(times)) for m in scene.muscles}
        simulation = scene.simulation(dt=0.02, sources=held(levels, times))
        yield scene, list(simulation.run(scene.initial, duration))


def test_random_excitations_keep_the_states_of_muscles():
    for scene, states in random_runs("muscle_arm", 20, 0.5):
        internals, z = scene.internals, np.array([x.z for x in states])
        assert np.isfinite(z).all() and np.isfinite([x.v for x in states]).all()
        assert (z >= internals.lower).all() and (z <= internals.upper).all()


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("name", "count"), [("muscle_arm", 700), ("muscle_leg", 300)])
def test_many_random_excitations_keep_the_states_of_muscles(name, count):
    for scene, states in random_runs(name, count, 1.0):
        internals, z = scene.internals, np.array([x.z for x in states])
        assert np.isfinite(z).all() and np.isfinite([x.v for x in states]).all()
        assert (z >= internals.lower).all() and (z <= internals.upper).all()


def test_the_simulator_takes_excitations_by_name_and_in_order():
    scene = SCENES / "muscle_arm.yaml"
    there = plant(scene, rate=200.0)
    names = there.scene.inputs.names
    assert names[:2] == ("deltoid_anterior.excitation", "deltoid_posterior.excitation")
    levels = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    u = there.reader.read_vector(SimpleNamespace(data=levels))
    assert u.tolist() == levels
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0), frame_id=""),
        name=list(reversed(names)),
        position=array("d"),
        velocity=array("d"),
        effort=array("d", reversed(levels)),
    )
    assert there.reader.read_named(message).tolist() == levels
    for _ in range(20):
        there.live.watch.take(u)
        there.live.tick()
    given = dict(zip((part.name for part in there.scene.muscles), levels, strict=True))
    resting = {"internal": {name: {"activation": 0.01} for name in given}}
    offline = load_scene(scene)
    offline = offline.with_(initial={**offline.entries["initial"], **resting})
    run = offline.simulation(dt=0.005, sources=held(given))
    end = list(run.run(offline.initial, 0.1))[-1]
    now = there.live.now
    assert now.position == pytest.approx(end.q, abs=1e-6)
    assert there.shown[0] == "deltoid_anterior.activation"
    assert now.shown[0] == pytest.approx(end.z[0], abs=1e-6)
