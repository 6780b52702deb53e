"""A short run of `make fuzz`, and what it and others have found, kept."""

import io
import json
import random
import re

import numpy as np
import pytest
from fuzz import documents, tables, urdf
from fuzz.kinds import KINDS, RANDOM, SCENE, case_of, read_by, readers, seeds_of
from fuzz.run import FEWEST
from fuzz.seeds import cube
from fuzz.trial import Case, behaves, tried

ONE_LINK = "<robot name='r'><link name='l0'/></robot>"
PENDULUM = urdf.robot(random.Random(0), 1)
TWO = urdf.two_joints()


@pytest.fixture(autouse=True)
def _untimed(monkeypatch):
    """`check` times a call once: here its lines count, not the cost that it prints."""
    monkeypatch.setattr("mbd_ros.scene.describe.check.MEASURED", 0.0)


def scene_case(*, command="simulate", robot=None, words=(), files=(), **sections):
    robot_entry = {"urdf": "r.urdf", **sections.pop("robot_entry", {})}
    scene = json.dumps({"robot": robot_entry, **sections}).encode()
    given = {"s.yaml": scene, "r.urdf": (robot or PENDULUM.text).encode(), **dict(files)}
    if command == "check":
        return Case(("check", "@s.yaml"), given)
    return Case(("simulate", "@s.yaml", "-t", "0.003", "-o", "@o.csv", *words), given, "o.csv")


def motion_case(table, derivatives, robot=PENDULUM.text):
    words = "inverse", "@s.yaml", "@m.csv", "-o", "@o.csv", "--derivatives", derivatives
    return Case(words, {"s.yaml": SCENE, "r.urdf": robot.encode(), "m.csv": table}, "o.csv")


def cases_of(kind):
    """Cases of a short run; those of random scenes are cheap, and often refused."""
    return [f"{kind}:{i}" for i in range(40 if kind in RANDOM else 4)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_short_run_finds_nothing_and_reaches_what_is_behind_the_reader(kind):
    outcomes = {name: tried(case_of(name)) for name in cases_of(kind)}
    wrong = {name: outcome.faults for name, outcome in outcomes.items() if outcome.faults}
    assert wrong == {}, "python -m fuzz.run --only KIND:SEED repeats one"
    passed = sum(outcome.passed for outcome in outcomes.values())
    assert passed >= FEWEST * len(outcomes), "the mutations of this kind are all refused"


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in RANDOM])
def test_seeds_are_sound(kind):
    for seed in seeds_of(kind):
        outcome = tried(Case(seed.words, seed.files, seed.out, seed.behind))
        assert (outcome.passed, outcome.faults) == (True, []), seed.words


def test_each_reader_has_a_seed():
    """But for those that start nodes, or take minutes, behind a reader of another kind."""
    reached = {reader for kind in KINDS for seed in seeds_of(kind) for reader in read_by(seed)}
    assert readers() - reached == {"replay bag", "report readme"}


def test_a_mutated_tree_depends_on_its_seed_alone():
    def every(seeds):
        return {
            i: documents.tree(random.Random(i), b'{"count": [1, {"a": 2}]}', False) for i in seeds
        }

    assert every(range(400)) == every(reversed(range(400)))


def hostile(kind, index=0, **files):
    """The case of a seed with other files; `m_csv` stands for m.csv."""
    seed = seeds_of(kind)[index]
    other = {name.replace("_", "."): data for name, data in files.items()}
    assert other.keys() <= seed.files.keys()
    return Case(seed.words, {**seed.files, **other}, seed.out, seed.behind)


def with_cell(kind, index, name, row, column, number):
    """A table of a seed with one other number."""
    rows = [
        re.split("([,\t])", row) for row in seeds_of(kind)[index].files[name].decode().splitlines()
    ]
    rows[row][2 * column if column >= 0 else column] = number
    return ("\n".join(map("".join, rows)) + "\n").encode()


def with_number(kind, index, name, row, number):
    """The case of a seed whose table has one other number, in the last column."""
    return hostile(kind, index, **{name: with_cell(kind, index, name, row, -1, number)})


def far_cube():
    """A box whose ninth facet ends at infinity."""
    data, at = cube(".stl"), 84 + 8 * 50 + 44
    return data[:at] + np.float32(np.inf).tobytes() + data[at + 4 :]


def arrays_of(kind, index, name, **changes):
    """The case of a seed whose .npz has other arrays."""
    with np.load(io.BytesIO(seeds_of(kind)[index].files[name])) as file:
        arrays = {**file}
    target = io.BytesIO()
    np.savez(
        target,
        **{
            key: changes.get(key.replace("/", "_").replace(".", "_"), array)
            for key, array in arrays.items()
        },
    )
    return hostile(kind, index, **{name: target.getvalue()})


def to_csv(kind):
    """The case of a seed whose result is a .csv in place of an .npz."""
    seed = seeds_of(kind)[0]
    words = tuple(word.replace(".npz", ".csv") for word in seed.words)
    return Case(words, seed.files, "o.csv")


J = PENDULUM.joints[0]
CORPUS = {
    "a robot of one link": scene_case(robot=ONE_LINK),
    "a robot of one link, checked": scene_case(robot=ONE_LINK, command="check"),
    "one joint and a loop": scene_case(
        constraints=[
            {"type": "loop_closure", "frame_a": "l1", "frame_b": "l0", "directions": "x"},
        ]
    ),
    "one joint, a distance and a stop": scene_case(
        constraints=[
            {"type": "distance", "frame_a": "l1", "frame_b": "universe", "distance": 0.3},
            {"type": "joint_stop", "joint": J, "lower": -1.0, "upper": 1.0},
        ]
    ),
    "a gear of 1e300": scene_case(
        actuators=[{"type": "geared_motor", "joint": J, "ratio": 1e300, "rotor_inertia": 1.0}]
    ),
    "a lossy gear of efficiency 5e-324": scene_case(
        actuators=[{"type": "geared_motor", "joint": J, "ratio": 1.0, "efficiency": 5e-324}]
    ),
    "gravity of 1e300": scene_case(robot_entry={"gravity": [0.0, 0.0, 1e300]}),
    "gravity of 1e30": scene_case(robot_entry={"gravity": [0.0, 0.0, 1e30]}),
    "a spring of 1e300": scene_case(
        forces=[{"type": "joint_spring", "joint": J, "stiffness": 1e300, "rest": 1.0}]
    ),
    "a spring of 1e29": scene_case(
        forces=[{"type": "joint_spring", "joint": J, "stiffness": 1e29, "rest": 1.0}]
    ),
    "a stop of time constant 1e-300": scene_case(
        constraints=[{"type": "joint_stop", "joint": J, "lower": -1.0, "time_constant": 1e-300}]
    ),
    "quadprog and a singular factor": scene_case(
        robot=TWO,
        solver={"type": "qp", "backend": "quadprog"},
        constraints=[{"type": "joint_stop", "joint": "j1", "lower": 0.0, "upper": 1.0}] * 2,
        initial={"velocity": {"j1": -3.0}},
    ),
    "masses whose matrix has no eigenvalues": scene_case(
        robot=PENDULUM.text.replace("value='1.5'", "value='1e300'")
    ),
    "a cut-off of 1e300 Hz": Case(
        (
            *("inverse", "@s.yaml", "@m.csv", "-o", "@o.csv"),
            *("--derivatives", "causal", "--cutoff", "1e300"),
        ),
        {
            "s.yaml": SCENE,
            "r.urdf": PENDULUM.text.encode(),
            "m.csv": tables.table(random.Random(1), PENDULUM.joints),
        },
        "o.csv",
    ),
    "a position of 1e155 through causal filters": motion_case(
        b"time,j1.position\n0,0\n0.01,1e155\n0.02,0\n",
        "causal",
        PENDULUM.text.replace("continuous", "revolute"),
    ),
    "a velocity limit of 1.8e308": motion_case(
        b"time,j1.position,j1.velocity,j1.acceleration\n0,0,0,0\n0.01,0,0,0\n",
        "given",
        PENDULUM.text.replace("velocity='10'", "velocity='1.7976931348623157e308'"),
    ),
    "an effort of 1e200": motion_case(
        b"time,j1.position,j1.effort\n"
        + b"".join(b"%g,%g,%g\n" % (0.01 * k, 0.1 * k, 1e200) for k in range(20)),
        "zero-phase",
    ),
    "an attribute that is not ASCII": scene_case(
        robot=PENDULUM.text.replace("xyz='", "xy\u0661z='", 1)
    ),
    "a joint with control characters": scene_case(
        robot=TWO.replace("'j2'", "'\x7f\u202e'"), command="check"
    ),
    "a link named as a fixed joint, and a locked one": scene_case(
        robot=TWO.replace(
            "</robot>",
            "<link name='x'/><joint name='l1' type='fixed'><parent link='l2'/><child link='x'/>"
            "</joint></robot>",
        ),
        robot_entry={"locked": {"j2": 0.5}},
    ),
    "a key with control characters": scene_case(**{"\x1b[2J": 1}),
    "a value of 200 000 characters": scene_case(integrator="x" * 200_000),
    "a file of one sample": Case(
        ("simulate", "@s.yaml", "-t", "0.002", "-o", "@o.csv", "--efforts", "@m.csv"),
        {
            "s.yaml": SCENE,
            "r.urdf": PENDULUM.text.encode(),
            "m.csv": tables.table(random.Random(1), PENDULUM.joints, rows=1),
        },
        "o.csv",
    ),
}


FOUND = {  # made when they are asked for, from the seeds of a kind
    "parameters that are no text": lambda: hostile("params-file", p_yaml=b"a: \xa2"),
    "parameters nested deep": lambda: hostile("params-file", p_yaml=b"[" * 100_000),
    "parameters that name themselves": lambda: hostile(
        "params-file", p_yaml=b"&a {b: *a, [c]: 1}"
    ),
    "an array of one number": lambda: arrays_of(
        ".npz", 0, "m.npz", samples_j1_velocity=np.float64(1)
    ),
    "an array of complex numbers": lambda: arrays_of(
        ".npz", 0, "m.npz", samples_j1_velocity=np.ones(8, complex)
    ),
    "an array of half precision": lambda: arrays_of(
        ".npz", 0, "m.npz", samples_j1_velocity=np.ones(8, np.float16)
    ),
    "times of half precision": lambda: arrays_of(
        ".npz", 1, "m.npz", samples_time=np.arange(1, 9, dtype=np.float16) / 100
    ),
    "an array with fewer rows": lambda: arrays_of(
        ".npz", 1, "m.npz", samples_j1_velocity=np.ones(3)
    ),
    "a checkpoint of one number": lambda: arrays_of("sample", 1, "c.npz", q0=np.float64(1)),
    "a checkpoint of texts": lambda: arrays_of("sample", 1, "c.npz", dt0=np.array("x")),
    "an effort of 1e200 that is identified": lambda: with_number(
        "identify", 0, "m.csv", 5, "1e200"
    ),
    "an effort of 1e200 that weighs a payload": lambda: with_number(
        "payload", 0, "m.csv", 5, "1e200"
    ),
    "an effort of 1e300 that is followed": lambda: with_number("follow", 0, "m.csv", 3, "1e300"),
    "an acceleration of 1e200 of an arm with muscles": lambda: with_number(
        "muscles", 2, "m.csv", 2, "1e200"
    ),
    "a velocity of 1e20 that is identified": lambda: hostile(
        "identify", m_csv=with_cell("identify", 0, "m.csv", 11, 2, "1e+20")
    ),
    "a load of 1e16 beside a payload": lambda: with_number("payload", 1, "w.csv", 1, "1e16"),
    "a load of 9e8 beside a payload": lambda: with_number("payload", 1, "w.csv", 1, "9e8"),
    "a payload beside a joint that rests but once": lambda: hostile(
        "payload", 0, m_csv=with_cell("payload", 0, "m.csv", 21, 2, "1e6")
    ),
    "a load of 1e19 in an estimate": lambda: with_number("estimate", 2, "w.csv", 8, "1e19"),
    "a marker that no scene has": lambda: hostile(
        "scale", t_yaml=b"scale: {name: a, segments: {l1: {pairs: [[A, Z]]}}}"
    ),
    "words in a table beside a motion as .csv": lambda: to_csv("predict"),
    "a vertex at infinity": lambda: hostile("meshes", 1, c_stl=far_cube()),
    "a moment of 1.8e308 on a force plate": lambda: hostile(
        "inverse", 1, **{"plate.mot": with_cell("inverse", 1, "plate.mot", 10, 7, "1.79e308")}
    ),
    "a tension of 1e200": lambda: with_number("loads", 3, "f.csv", 2, "1e200"),
    "a load of 1e308": lambda: with_number("simulate", 1, "w.csv", 2, "1e308"),
    "loads that begin late": lambda: with_number("muscles", 4, "w.csv", 1, "0"),
    "a guess of 1e155 in a file": lambda: hostile(
        "predict", 1, g_csv=with_cell("predict", 1, "g.csv", 3, 1, "1e155")
    ),
    "a mesh with a node at 1e155 m": lambda: hostile(
        "loads",
        2,
        m_inp=re.sub(rb"(?m)^(28, .+, )\S+$", rb"\g<1>1e155", seeds_of("loads")[2].files["m.inp"]),
    ),
    "a mesh of flat elements": lambda: hostile(
        "loads",
        2,
        m_inp=re.sub(
            rb"(?m)^(\d+, \S+, )\S+, ", rb"\g<1>0.0, ", seeds_of("loads")[2].files["m.inp"]
        ),
    ),
    "a plot of a column that is not there": lambda: hostile("plot", m_csv=b"time\n0\n1\n"),
}


@pytest.mark.parametrize("name", CORPUS)
def test_what_was_found_stays_mended(name):
    behaves(CORPUS[name])


@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_in_a_seed_stays_mended(name):
    behaves(FOUND[name]())
