"""Task files: what is asked of a scene, read as a scene is."""

import numpy as np
import pytest

from mbd_ros.api import scene_from
from mbd_ros.cli import main
from mbd_ros.errors import SceneError
from mbd_ros.scene.task_reader import read_task

FULL = """\
simulate:
  duration: 0.05
  start: 1
  dt: 1e-3
  integrator: {type: rk4}
  stabilization: {type: none}
  solver: {type: aba}
  from: motions/start.csv
  efforts: motions/efforts.csv
  wrenches: package://mbd_ros/config/robots/pendulum.urdf
"""


@pytest.fixture
def read(tmp_path):
    path = tmp_path / "task.yaml"
    scene = scene_from(urdf="pendulum")

    def task(text):
        path.write_text(text, encoding="utf-8")
        return read_task(path, scene)

    return task


def test_every_key_of_a_simulation_is_read(read, tmp_path):
    task = read(FULL)
    asked = task.parts["simulate"]
    assert (asked.duration, asked.start) == (0.05, 1.0)
    assert asked.origin == tmp_path / "motions/start.csv"
    assert asked.efforts == tmp_path / "motions/efforts.csv"
    assert asked.wrenches.name == "pendulum.urdf"
    assert asked.options == {
        "dt": 1e-3,
        "integrator": {"type": "rk4"},
        "stabilization": {"type": "none"},
        "solver": {"type": "aba"},
    }
    assert task.path == tmp_path / "task.yaml"


def test_its_options_are_those_of_a_simulation(read):
    task = read(FULL)
    asked, scene = task.parts["simulate"], task.scene
    changed = scene.with_(**asked.options)
    runs = [
        [x.q for x in simulation.run(scene.initial, asked.duration)]
        for simulation in (scene.simulation(**asked.options), changed.simulation())
    ]
    assert np.array_equal(*runs) and len(runs[0]) == 51


def test_what_a_task_leaves_out_is_left_to_the_scene(read):
    asked = read("simulate: {duration: 2.0}\n").parts["simulate"]
    assert (asked.start, asked.origin, asked.efforts, asked.wrenches) == (0.0, None, None, None)
    assert asked.options == {}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration: 0.05", "", "simulate: key 'duration' is missing"),
        ("duration: 0.05", "duration: 0", "simulate.duration: 0 s must be finite and > 0"),
        ("dt: 1e-3", "dt: 1e-10", "simulate.dt: 1e-10 s, accepted: 1e-09 .. 9e+09 s"),
        ("type: rk4", "type: rk5", "simulate.integrator.type: unknown type 'rk5', accepted: adam"),
        ("type: rk4", "type: 'a.b:C'", "simulate.integrator.type: names code of others, of which"),
        ("type: none", "type: all", "simulate.stabilization.type: unknown type 'all', accepted"),
        ("{type: aba}", "aba", "simulate.solver: expected a mapping, got 'aba'"),
        ("type: aba", "type: abba", "simulate.solver: unknown solver type 'abba', accepted: auto"),
        ("from: motions/start.csv", "from: 3", "simulate.from: expected a word, got 3"),
        ("from:", "form:", "simulate: unknown key 'form', accepted: duration, start, dt, integra"),
        ("efforts: m", "efforts: package://no/m", "simulate.efforts: package://no/motions/effort"),
        ("simulate:", "dance:", "unknown key 'dance', accepted: simulate"),
        (FULL, "simulate:", "asks for nothing, accepted: simulate"),
        (FULL, "simulate: 3", "simulate: expected a mapping, got 3"),
        (FULL, "", "the file is empty"),
    ],
)
def test_a_mistake_names_file_and_key(read, tmp_path, old, new, message):
    assert old in FULL
    with pytest.raises(SceneError) as caught:
        read(FULL.replace(old, new, 1))
    assert str(caught.value).startswith(f"{tmp_path / 'task.yaml'}: {message}")


def test_a_file_that_is_not_there_is_a_task_file(tmp_path):
    with pytest.raises(SceneError, match="no.yaml: task file cannot be read: No such file"):
        read_task(tmp_path / "no.yaml", scene_from(urdf="pendulum"))


@pytest.mark.parametrize(
    ("more", "replaced"),
    [
        ([], []),
        (["-t", "0.02"], ["-t", "0.02"]),
        (["--dt", "2e-3", "--start", "0"], ["--dt", "2e-3", "--start", "0"]),
        (["--tolerance", "1e-6"], ["--tolerance", "1e-6"]),
        (["--integrator", "rk4"], ["--integrator", "rk4"]),
    ],
)
def test_a_simulation_of_a_task_is_that_of_its_options(tmp_path, more, replaced):
    """To the last byte; and options on the command line come before the task."""
    (tmp_path / "task.yaml").write_text(
        "simulate: {duration: 0.05, start: 1, dt: 1e-3, integrator: {type: dopri5}, "
        "solver: {type: kkt}}\n",
        encoding="utf-8",
    )
    task, words = tmp_path / "task.csv", tmp_path / "words.csv"
    simulate = ["simulate", "prosthetic_leg"]
    assert main([*simulate, "--task", str(tmp_path / "task.yaml"), *more, "-o", str(task)]) == 0
    said = {"-t": "0.05", "--start": "1", "--dt": "1e-3", "--integrator": "dopri5"}
    said |= {"--solver": "kkt", **dict(zip(replaced[::2], replaced[1::2], strict=True))}
    flat = [word for pair in said.items() for word in pair]
    assert main([*simulate, *flat, "-o", str(words)]) == 0
    assert task.read_bytes() == words.read_bytes()


def test_files_of_a_task_are_read_from_its_folder(tmp_path, monkeypatch):
    folder = tmp_path / "tasks"
    folder.mkdir()
    first, second = folder / "first.csv", tmp_path / "second.csv"
    assert main(["simulate", "arm7", "-t", "0.02", "-o", str(first)]) == 0
    task = "simulate: {duration: 0.01, start: 0.02, from: first.csv}\n"
    (folder / "task.yaml").write_text(task, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    words = ["simulate", "arm7", "--task", "tasks/task.yaml", "-o", str(second)]
    assert main(words) == 0
    rows = [np.loadtxt(path, delimiter=",", skiprows=1) for path in (first, second)]
    assert np.array_equal(rows[0][-1, :15], rows[1][0, :15])


def test_nothing_that_says_how_long_is_refused(tmp_path, capsys):
    assert main(["simulate", "arm7", "-o", str(tmp_path / "o.csv")]) == 2
    assert "-t: is missing: give the seconds to simulate, or a --task" in capsys.readouterr().err
    (tmp_path / "task.yaml").write_text("simulate: {}\n", encoding="utf-8")
    words = ["simulate", "arm7", "--task", str(tmp_path / "task.yaml"), "-t", "1", "-o"]
    assert main([*words, str(tmp_path / "o.csv")]) == 2
    assert "task.yaml: simulate: key 'duration' is missing" in capsys.readouterr().err
