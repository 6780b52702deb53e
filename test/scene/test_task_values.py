"""Any value at any key of a task is accepted, or refused by name: never a traceback."""

import copy
import random

import pytest
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.errors import MbdError, SceneError
from mbd_ros.features.estimation.estimation import build_estimation
from mbd_ros.features.prediction.problem import build_problem
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.reading.building import build
from mbd_ros.scene.schema.sections import TASKS, keys
from mbd_ros.scene.schema.strict_yaml import mapping_of

PREDICTED = """
predict:
  duration: [0.3, 0.5]
  start: {cart.position: 0.0, "*.velocity": 0.0}
  end: {cart.position: [0.4, 0.5]}
  periodic: [pole.position]
  travel: [cart]
  goals:
  - {type: effort, weight: 1.0, name: a, of: "*", power: 2}
  - {type: power, of: cart.effort, smoothing: 0.1}
  - {type: time}
  - {type: speed, of: cart.position, target: 1.0}
  - {type: smoothness}
  - {type: integral, of: {cart.position: 1.0}, power: 2, target: 0.0}
  - {type: final, of: [cart.position], power: 2, target: 0.0}
  bounds: {cart.position: [-1, 1]}
  mesh: {scheme: gauss, degree: 3, intervals: 5, refinements: 2}
  guess: {pole.position: [0.0, 1.0]}
"""
TASK_OF = {  # a task with as many keys as it may have -> its scene
    PREDICTED: "cart_pole",
    """
sample: {temperature: 300.0, method: metropolis, chains: 64, samples: 1000, warmup: 200, steps: 5,
  dt: 0.02, seed: 0, fixman: false, components: true, kinetics: true, starts: scene,
  observe: {bend: cosine A B C}, histograms: {bend: [-1.0, 1.0, 10]}}
""": "particles/trimer",
    """
estimate: {estimator: {type: moving_horizon, samples: 30, iterations: 2}, inputs: efforts,
  disturbance: [knee], model_noise: 0.1, disturbance_noise: 0.1, drifting: true, lag: 0.1,
  position_noise: 1e-3, velocity_noise: 1e-3, position_deviation: 1e-3, velocity_deviation: 1.0,
  parameters: {shank.mass: 1.0}, parameter_time: 100.0, limits: true}
""": "prosthetic_leg",
    """
gait: {event: strike, cycles: 2, guesses: [{}, {position: {left_hip: 0.1}}],
  search: {left_hip.velocity: [0.1, 0.2, 3]}, travel: [left_hip], step_between: [a, b],
  longest: 3.0, integrator: {type: dop853, tolerance: 1e-10},
  continuation: {parameter: slope, from: 0.009, to: 0.0091, doublings: 1, points: 10},
  basin: {grid: {left_hip.velocity: [0.19, 0.21, 5]}, cycles: 30, near: 1e-4}}
""": "simplest_walker_step",
    """
kinematics: {markers: {L.Heel: 2.0}, coordinates: {knee: 0.1, ankle: {weight: 0.5, value: 0.1},
  hip_flexion: {weight: 0.5, from_motion: true}}, motion: a.csv, begin: 0.5, end: 1.5,
  smoothness: 0.0, limits: true, unit: mm, axes: "x,z,-y"}
""": "marked_leg",
    """
scale: {name: subject, mass: 72.6, by_volume: false, begin: 0.5, end: 1.5, unit: mm,
  segments: {shank: {pairs: [[a, b], [a, c]]}, foot: [{pairs: [[a, b]], axes: z}, {factor: 1.02}]}}
""": "marked_leg",
    """
muscles: {objective: activation, exponent: 3, passive: true, reserves: {knee: 1.0}, rise: 10.0,
  fall: 5.0, emg: a.csv, emg_use: track, emg_weight: 1.0, reactions: child, links: [shank],
  by_muscle: true}
""": "muscle_leg",
    "muscles: {dynamics: activation, interval: 0.01, degree: 3, tolerance: 1e-3}": "muscle_leg",
    """
simulate: {duration: 2.0, start: 0.0, integrator: {type: rk4}, dt: 1e-3, from: a.csv,
  efforts: a.csv, wrenches: a.csv, solver: {type: plain}}
""": "prosthetic_leg",
    """
predict: {recording: {motion: a.csv, external: a.csv, times: [0.8, 1.6], cutoff: 6.0},
  driven_by: joints, muscles: {type: degroote_fregly, tendon: rigid}, tolerance: 1e-5,
  accuracy: 1e-6, grip: 0.8, iterations: 10, starts: 2, symmetric: {a: b},
  continuation: {a.b: [0.0, 1.0]}, parameters: {a.b: [1, 2]},
  goals: [{type: tracking, of: "*.position", file: a.csv}, {type: metabolic, basal: true}]}
""": "prosthetic_leg",
} | {
    (ROOT / f"config/tasks/{name}.yaml").read_text(encoding="utf-8"): scene
    for name, scene in (("biped_step", "five_link_biped"), ("hop", "hopper"))
}
VALUES = (
    *([], [1.0], ["a"], [[1]], [{}], {}, {"a": 1}, {"a": {}}, {"a": []}, {"type": []}),
    *({"type": {}}, {"type": "x"}, None, "word", "", -1, 0, 3, 1e300, True, "nan", 10**18),
)


def places(entries, above=()):
    """Every place in entries, as keys and numbers."""
    items = entries.items() if isinstance(entries, dict) else enumerate(entries)
    for key, value in items:
        yield (*above, key)
        if isinstance(value, dict | list):
            yield from places(value, (*above, key))


def changed(entries, place, value):
    """Entries with another value at a place."""
    entries = copy.deepcopy(entries)
    inner = entries
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return entries


def parts_of(entries, scene, folder):
    given = {key: value for key, value in entries.items() if value is not None}
    return build(Origin(folder / "task.yaml"), given, TASKS, scene=scene).parts


def assert_read_or_refused(folder, share):
    (folder / "a.csv").write_text("time\n0.0\n")
    rng = random.Random(49)
    for text, name in TASK_OF.items():
        scene, entries = load_scene(name), mapping_of(text, "task")
        parts_of(entries, scene, folder)  # what is changed is a task that is accepted
        for place in places(entries):
            for value in VALUES:
                if rng.random() > share:
                    continue
                try:
                    parts_of(changed(entries, place, value), scene, folder)
                except MbdError as error:
                    assert str(error)


def test_every_task_is_tried():
    assert {next(iter(mapping_of(text, "task"))) for text in TASK_OF} == set(keys(TASKS))


def test_some_values_at_any_key_of_any_task(tmp_path):
    assert_read_or_refused(tmp_path, 0.04)


@pytest.mark.soak
def test_any_value_at_any_key_of_any_task(tmp_path):
    assert_read_or_refused(tmp_path, 1.0)


BAD = {  # accepted by no reader: text that is replaced, its replacement, what is said
    "type of a goal": (
        "type: time",
        "type: [effort]",
        r"predict.goals\[2\].type: expected one of",
    ),
    "goal of a number": ("of: cart.effort", "of: 3", r"goals\[1\].of: expected a word"),
    "goal of numbers": (
        "of: [cart.position]",
        "of: [[1]]",
        r"goals\[6\].of\[0\]: expected a word",
    ),
    "weights of words": (
        "cart.position: 1.0}",
        "cart.position: x}",
        r"goals\[5\].of.cart.position",
    ),
    "function of a number": (
        "type: time",
        "type: function, function: 3",
        "function: expected a word",
    ),
    "muscles": (
        "periodic:",
        "muscles: 3\n  periodic:",
        "predict.muscles: expected a mapping, got 3",
    ),
    "no guess": ("[0.0, 1.0]", "[]", "guess.pole.position: expected a number or a list"),
    "intervals": ("intervals: 5", "intervals: 100001", "100001 is out of range, accepted: 1 .. 1"),
    "degree": ("degree: 3", "degree: 99", "99 is out of range, accepted: 1 .. 16"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_with_a_prediction_is_named(tmp_path, case):
    old, new, words = BAD[case]
    assert old in PREDICTED
    with pytest.raises(SceneError, match=words):
        parts_of(
            mapping_of(PREDICTED.replace(old, new, 1), "task"), load_scene("cart_pole"), tmp_path
        )


def test_the_speed_of_several_positions_is_refused(tmp_path):
    text = PREDICTED.replace("type: speed, of: cart.position", 'type: speed, of: "*.position"')
    scene = load_scene("cart_pole")
    with pytest.raises(MbdError, match="goal speed: '\\*.position' matches cart.position, pole"):
        build_problem(scene, parts_of(mapping_of(text, "task"), scene, tmp_path)["predict"])


@pytest.mark.parametrize("kind", ["[a]", "{a: b}", "3", "null", "{}"])
def test_a_type_of_an_estimator_is_a_word(tmp_path, kind):
    scene, text = load_scene("empty"), f"estimate: {{estimator: {{type: {kind}}}}}"
    task = parts_of(mapping_of(text, "task"), scene, tmp_path)["estimate"]
    names = [joint.name for joint in scene.robot.joints]
    with pytest.raises(SceneError, match="estimate.estimator: type is .*, accepted: a word such"):
        build_estimation(scene, task, names, [])
