"""Nothing depends on earlier calls: evaluations, continued runs, sample times, first states."""

import pickle
import sys
from functools import cache

import numpy as np
import pytest
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.core.state import is_same
from mbd_ros.core.thresholds import ON_MANIFOLD
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.simulation.samples import Checkpoint

sys.path.append(str(ROOT / "benchmarks"))

from scenes_of_comparison import EMBEDDED, PLANTED

ONE_STEP = [{"type": name} for name in ("semi_implicit_euler", "rk4", "dopri5", "dop853")]
ITERATED = [{"type": name} for name in ("gauss_legendre", "rattle")]
WITH_MEMORY = [{"type": name} for name in ("adams", "generalized_alpha", "shake")]
ADAPTIVE = [{"type": "dopri5", "tolerance": 1e-7}, {"type": "filippov", "tolerance": 1e-8}]
METHODS = [*ONE_STEP, *ITERATED, *WITH_MEMORY, *ADAPTIVE]
REPEATED = ("free ", "coupled ", "loop ")  # planted once more for every method
SCENES = [
    *EMBEDDED,
    *(name for name in PLANTED if not name.startswith(REPEATED) or name == "coupled kkt"),
]
SLIDING = "package://mbd_ros/config/scenes/benchmark/s01_parabola.yaml"
REFUSED = (
    "does not stop at events",
    "keeps bilateral rows only",
    "takes no free bodies",
    "beside bounded rows",
)
UNFIT = (  # diverges, or does not converge where a force jumps
    *(("a05_governor", name) for name in ("adams", "rattle", "shake")),
    *(("filippov", name) for name in ("gauss_legendre", "generalized_alpha", "rattle", "shake")),
    ("filippov", "dopri5"),
)
SAMPLES = 14


@cache
def loaded(name):
    """A scene of the comparison."""
    if name not in PLANTED:
        return load_scene(name)
    return load_scene_text(PLANTED[name].text)


def load_scene_text(text):
    """A scene that stands here as text."""
    path = loaded.folder / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return load_scene(str(path))


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    """Where planted scenes are written."""
    loaded.folder = tmp_path_factory.mktemp("scenes")


def simulation(name, method=None):
    """A new simulation; None where the method refuses the scene, or is not made for it."""
    if any(scene in name and method and method["type"] == bad for scene, bad in UNFIT):
        return None
    try:
        return loaded(name).simulation(integrator=method)
    except SceneError as error:
        assert any(words in str(error) for words in REFUSED), error
        return None


def span(made):
    return SAMPLES * made.dt


def off(states, others):
    """Largest distance in q and in v, relative to 1 + |v|."""
    assert len(states) == len(others)
    return max(
        max(
            float(np.abs(a.q - b.q).max(initial=0.0)),
            float(np.abs(a.v - b.v).max(initial=0.0) / (1.0 + np.abs(a.v).max(initial=0.0))),
        )
        for a, b in zip(states, others, strict=True)
    )


def methods(name):
    """Methods that simulate a scene, that of the scene itself first."""
    return [None, *(m for m in METHODS if simulation(name, m) is not None)]


@pytest.mark.parametrize("name", SCENES)
def test_a_checkpoint_continues_with_the_same_bits(name):
    random = np.random.default_rng(sum(map(ord, name)))
    for method in methods(name):
        made, at = simulation(name, method), int(random.integers(0, SAMPLES))
        states = []
        for x in made.run(loaded(name).initial, span(made)):
            if len(states) == at:
                kept = pickle.dumps(made.checkpoint())
            states.append(x)
        again = simulation(name, method)
        rest = list(again.run(pickle.loads(kept), span(made)))
        assert len(rest) == SAMPLES - at
        assert all(is_same(a, b) for a, b in zip(states[at + 1 :], rest, strict=True)), method
        assert (again.steps, again.worst) == (made.steps, made.worst)


@pytest.mark.parametrize("name", SCENES)
def test_a_state_alone_continues_to_rounding_with_one_step_methods(name):
    at = 1 + sum(map(ord, name)) % (SAMPLES - 2)
    for method in (*ONE_STEP, *ITERATED):
        if (made := simulation(name, method)) is None:
            continue
        states = list(made.run(loaded(name).initial, span(made)))
        rest = list(simulation(name, method).run(states[at], (SAMPLES - at) * made.dt))
        has_rows = bool(made.system.multiplier_rows)
        is_exact = method in ONE_STEP and not has_rows
        assert off(states[at:], rest) <= (0.0 if is_exact else 1e-12), method


@pytest.mark.parametrize("name", ["arm7", "prosthetic_leg", "four_bar_leg"])
@pytest.mark.parametrize("method", WITH_MEMORY, ids=lambda method: method["type"])
def test_a_state_alone_continues_to_the_error_of_the_starting_step(name, method):
    """Which one start leaves already: half the step shows it, to the order of the method."""
    name = f"package://mbd_ros/config/scenes/{name}.yaml"
    initial, dt = loaded(name).initial, loaded(name).dt
    gaps = []
    for h in (dt, 0.5 * dt):
        made = [loaded(name).simulation(integrator=method, dt=h) for _ in range(2)]
        count = round(SAMPLES * dt / h)
        states = list(made[0].run(initial, SAMPLES * dt))
        rest = made[1].run(states[count // 2], SAMPLES * dt - states[count // 2].t)
        gaps.append(off(states[-1:], list(rest)[-1:]))
    assert gaps[1] <= max(0.6 * gaps[0], 1e-12)
    assert gaps[0] <= 1e-4


@pytest.mark.parametrize("name", [name for name in SCENES if name != "filippov"])
def test_a_state_alone_continues_to_the_tolerance(name):
    """Where both tolerances take the same steps, from discontinuity to dt, they tell nothing."""
    seconds = EMBEDDED.get(name) or PLANTED[name].seconds
    runs = [simulation(name, {"type": "dopri5", "tolerance": 10.0**-n}) for n in (6, 7, 6)]
    initial = loaded(name).initial
    states, finer = (list(made.run(initial, seconds)) for made in runs[:2])
    middle = states[len(states) // 2]
    rest = list(runs[2].run(middle, seconds - (middle.t - initial.t)))
    gap = off(states, finer)
    assert gap == 0.0 or off(states[-len(rest) :], rest) <= 10.0 * gap + 1e-12


@pytest.mark.parametrize("name", [*SCENES, "sliding"])
def test_an_evaluation_depends_on_its_state_alone(name):
    """1000 evaluations in random order, with other work in between."""
    scene = loaded(SLIDING if name == "sliding" else name)
    made, random = scene.simulation(), np.random.default_rng(3)
    duration = 2.4 if name == "sliding" else span(made)
    states, found = [], []
    for x in made.run(scene.initial, duration):
        now = made.system.evaluate(x)
        states.append(x)
        found.append((now.a.tobytes(), now.lam.tobytes()))
    system = scene.simulation().system
    other = made.system if name == "sliding" else system
    for i in random.integers(0, len(states), 1000).tolist():
        now = other.evaluate(states[i])
        assert (now.a.tobytes(), now.lam.tobytes()) == found[i]
        if i % 7 == 0:
            y = system.reduce(states[i - 1])
            system.accelerator()(y.t, y.q, 2.0 * y.v, None, np.empty(system.nv))
    if name == "sliding":
        assert {x.mode for x in states} == {(1,), (0,), (-1,)}


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_samples_are_whole_steps_after_the_first(method):
    """Also 100 s from the origin, and with a shorter last interval."""
    scene = load_scene("package://mbd_ros/config/scenes/arm7.yaml")
    for begin in (0.0, 100.1):
        made = scene.simulation(integrator=method, dt=1e-3)
        times = [x.t for x in made.run(scene.initial._replace(t=begin), 0.0725)]
        assert times == [min(begin + n * 1e-3, begin + 0.0725) for n in range(74)]


@pytest.mark.parametrize("name", ["four_bar_leg", "benchmark/a04_bricard", "benchmark/x09_cranks"])
def test_a_consistent_state_is_left_alone(name):
    scene = load_scene(f"package://mbd_ros/config/scenes/{name}.yaml")
    made = scene.simulation()
    for x in list(made.run(scene.initial, span(made))):
        assert is_same(made.system.expand(made.start(x)), x)
    wrong = x._replace(v=x.v + 1e3 * ON_MANIFOLD * (1.0 + np.abs(x.v).max()))
    assert not is_same(made.system.expand(made.start(wrong)), wrong)


def test_ticks_continue_from_a_checkpoint():
    scene = load_scene("package://mbd_ros/config/scenes/four_bar_leg.yaml")
    made, again = (scene.simulation(integrator={"type": "adams"}) for _ in range(2))
    y = made.advance(made.start(scene.initial), None, 10 * made.dt)
    kept = pickle.loads(pickle.dumps(made.checkpoint()))
    for n in (11, 12, 20):
        y = made.advance(y, None, n * made.dt)
    assert is_same(again.advance(again.resume(kept), None, 11 * made.dt), y) is False
    z = again.resume(kept)
    for n in (11, 12, 20):
        z = again.advance(z, None, n * made.dt)
    assert is_same(y, z)


def test_checkpoints_of_others_are_refused():
    arm, leg = (
        load_scene(f"package://mbd_ros/config/scenes/{name}.yaml").simulation()
        for name in ("arm7", "prosthetic_leg")
    )
    with pytest.raises(ModelError, match="has not started has no checkpoint"):
        arm.checkpoint()
    leg.start(load_scene("package://mbd_ros/config/scenes/prosthetic_leg.yaml").initial)
    kept = leg.checkpoint()
    assert isinstance(kept, Checkpoint)
    with pytest.raises(ModelError, match=r"positions and .* velocities cannot be continued by"):
        arm.resume(kept)
