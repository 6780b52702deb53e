"""Scenes whose paths wrap, in native code, beside the plain tier."""

import gzip

import numpy as np
import pytest
from places import RECORDINGS
from wrapping import POINTS, WRAPS, swing

import mbd_ros as mbd
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.build.verify import plain_rates, random_inputs, random_state
from mbd_ros.compiled.code.emit import SEARCH, emitted
from mbd_ros.compiled.runs.implicit_method import compiled_system
from mbd_ros.compiled.symbols.trace import trace
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import PathBatch
from mbd_ros.errors import SceneError
from mbd_ros.scene.runs.path_search import QuickestSearch

pytest.importorskip("casadi", reason="casadi traces scenes")


def compiled(system):
    """The library of accelerations, and the paths that it searches."""
    traced = trace(system)
    return load(emitted(traced, ("accelerate",))), [one.path for one in traced.searched]


def differences(system, states):
    """Largest difference of accelerations and rates, and of lengths, of the largest."""
    library, paths = compiled(system)
    accelerate, search = library.function("accelerate"), library.function(SEARCH)
    k, rng, found = Kinematics(system.robot), np.random.default_rng(3), []
    for y in states:
        held, u = random_inputs(system, 0.0, rng)
        for argument, value in zip(accelerate.arguments, (0.0, *y[1:4], u, ()), strict=True):
            argument[...] = value
        for argument, value in zip(search.arguments, (0.0, y.q, ()), strict=True):
            argument[...] = value
        accelerate()
        search()
        wanted = plain_rates(system, y, held)
        x = system.expand(y)
        k.refresh(x.q, x.v)
        sizes = [1 + 3 * len(path.points) + 6 * len(path.wraps) for path in paths]
        lengths = search.results[0][np.cumsum([0, *sizes[:-1]])]
        apart = np.abs(np.hstack(accelerate.results[:2]) - wanted).max() / np.abs(wanted).max()
        found.append([apart, np.abs(lengths - [path.length(k, x) for path in paths]).max()])
    return np.array(found)


@pytest.mark.parametrize("wraps", WRAPS)
def test_accelerations_are_those_of_the_plain_tier(wraps):
    paths = {"over": {"points": POINTS, "wraps": WRAPS[wraps]}}
    spring = {"type": "path_spring", "path": "over", "stiffness": 900.0}
    spring["resting_length"] = 0.4
    system = mbd.scene_from({"paths": paths, "forces": [spring]}, urdf="arm7").system()
    rng = np.random.default_rng(2)
    states = [random_state(system, rng) for _ in range(15)]
    states = [y._replace(q=rng.uniform(-0.8, 0.8, len(y.q))) for y in states]
    assert differences(system, states).max() < 1e-10


def test_a_run_is_that_of_the_plain_tier():
    plain, native = swing(), swing(solver={"type": "compiled"})
    ends = [scene.simulate(0.6)["samples"] for scene in (plain, native)]
    names = "hinge.position", "hinge.velocity", "over_cable.length"
    assert max(np.abs(ends[0][name] - ends[1][name]).max() for name in names) < 1e-9


def test_constraints_on_wraps_keep_a_scene_on_plain_steps():
    paths = {"over": {"points": POINTS, "wraps": WRAPS["ellipsoid"]}}
    rope = {"type": "rope", "path": "over", "length": 3.0}
    entries = {"paths": paths, "constraints": [rope], "solver": {"type": "compiled"}}
    with pytest.raises(SceneError, match="over_rope .Rope. cannot be traced"):
        mbd.scene_from(entries, urdf="arm7").simulation(integrator={"type": "rk4"}, dt=1e-3)


def test_derivatives_and_batches_are_refused_by_name():
    scene = swing()
    with pytest.raises(Untraceable, match="derivatives through paths that wrap"):
        compiled_system(scene.system())
    batch = scene.batch(2, integrator={"type": "rk4"}, dt=1e-3)
    assert "paths that wrap are searched one run at a time" in batch.how


def test_arm26_is_that_of_the_plain_tier(tmp_path):
    packed = RECORDINGS / "arm26/muscles/raw/arm26.osim.gz"
    model = tmp_path / "arm26.osim"
    model.write_bytes(gzip.decompress(packed.read_bytes()))
    system = mbd.load_scene(model).system()
    rng = np.random.default_rng(6)
    states = [random_state(system, rng) for _ in range(12)]
    states = [y._replace(q=rng.uniform((-1.5, 0.0), (3.0, 2.2))) for y in states]
    assert differences(system, states).max() < 1e-10


@pytest.mark.parametrize("wraps", WRAPS)
def test_moment_arms_are_those_of_numpy(wraps):
    scene = mbd.scene_from(
        {"paths": {"over": {"points": POINTS, "wraps": WRAPS[wraps]}}}, urdf="arm7"
    )
    y = np.random.default_rng(4).uniform(-0.6, 0.6, (40, 7))
    asked = scene.robot, scene.couplings, scene.parts["paths"]
    own, native = (PathBatch(*asked, search).evaluate(y) for search in (None, QuickestSearch()))
    assert np.abs(own.lengths - native.lengths).max() < 1e-12
    assert np.abs(own.arms - native.arms).max() < 1e-12


def test_moment_arms_need_no_compiler(monkeypatch):
    monkeypatch.setenv("CC", "no_such_compiler")
    scene = mbd.scene_from(
        {"paths": {"over": {"points": POINTS, "wraps": WRAPS["sphere"]}}}, urdf="arm7"
    )
    asked = scene.robot, scene.couplings, scene.parts["paths"]
    own, other = (
        PathBatch(*asked, s).evaluate(np.zeros((1, 7))) for s in (None, QuickestSearch())
    )
    assert own.lengths == other.lengths and (own.arms == other.arms).all()
