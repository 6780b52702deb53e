"""Compiled steps as people ask for them, beside the plain tier in the same words."""

import re
import sys
from functools import partial

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

import mbd_ros.compiled
from mbd_ros.api import load_scene
from mbd_ros.cli import main
from mbd_ros.errors import BAD_INPUT, SceneError
from mbd_ros.features.simulation.job import simulate
from mbd_ros.files.tables.csv import read_table
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch

SCENES = sorted(path.stem for path in (ROOT / "config/scenes").glob("*.yaml"))
SLOW = ("block_on_incline", "muscle_leg")  # whose C takes the compiler long
SMOOTH = {  # neither stops, dry friction nor contacts
    *("arm7", "empty", "four_bar_leg", "free_flyer"),
    *("prosthetic_arm", "prosthetic_leg", "prosthetic_leg_stance"),
}
COMPILED, PLAIN = {"type": "compiled"}, {"type": "plain"}
PENDULUM = f"""robot: {{urdf: {ROOT / "config/robots/pendulum.urdf"}}}
actuators: [{{type: ideal, joints: [hinge]}}]
initial: {{position: {{hinge: 0.3}}}}
"""


def run(capsys, *words):
    """What the command line says, which must accept the words."""
    assert main([str(word) for word in words]) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def table(path):
    read = read_table(path, lambda column: True)
    return dict(zip(read.columns, read.values.T, strict=True))


@pytest.mark.parametrize(
    "scene", [pytest.param(s, marks=pytest.mark.soak) if s in SLOW else s for s in SCENES]
)
def test_embedded_scenes_give_the_samples_of_the_plain_tier(scene, tmp_path, capsys):
    """Or say why they are those of the plain tier."""
    out = {kind: tmp_path / f"{kind}.csv" for kind in ("auto", "plain")}
    said = [
        run(capsys, "simulate", scene, "-t", 0.05, "--solver", k, "-o", o) for k, o in out.items()
    ]
    assert re.search("^compiled: [0-9]+ operations by .* in [0-9.]+ s$", said[0], re.M) or (
        re.search(
            "^not compiled: (steps stop at|integrator moreau_jean|phases|.* is a contact with f)",
            said[0],
            re.M,
        )
        and scene not in SMOOTH
    )
    assert "compiled" not in said[1]
    found, wanted = (table(o) for o in out.values())
    assert found.keys() == wanted.keys()
    for name, values in wanted.items():
        size = 1.0 + np.abs(values).max()
        np.testing.assert_allclose(found[name], values, rtol=0.0, atol=1e-9 * size, err_msg=name)


def test_the_file_the_option_and_the_task_ask_for_it(tmp_path, capsys):
    scene, task, out = (tmp_path / name for name in ("scene.yaml", "task.yaml", "o.csv"))
    task.write_text("simulate: {duration: 0.05, solver: {type: compiled}}\n")
    scene.write_text(PENDULUM)
    words = ["simulate", scene, "-t", 0.05, "-o", out]
    assert "compiled" not in run(capsys, *words)
    wanted = table(out)
    said = [
        run(capsys, *words, "--compiled"),
        run(capsys, "simulate", scene, "--task", task, "-o", out),
    ]
    for kind in ("compiled", "auto"):
        scene.write_text(f"{PENDULUM}solver: {{type: {kind}}}\n")
        said.append(run(capsys, *words))
        np.testing.assert_allclose(
            table(out)["hinge.position"], wanted["hinge.position"], atol=1e-14
        )
    assert all("compiled Dopri5, tier aba: 50 steps, 30" in text for text in said)
    assert "compiled" not in run(capsys, *words, "--solver", "plain")


def test_two_solvers_are_refused(tmp_path, capsys):
    words = ["simulate", "arm7", "-t", "1", "-o", str(tmp_path / "o.csv"), "--compiled"]
    assert main([*words, "--solver", "qp"]) == BAD_INPUT
    assert "--compiled and --solver qp: accepted is one of the two" in capsys.readouterr().err


@pytest.fixture
def no_casadi(monkeypatch):
    """As if it were not installed; what is imported meanwhile is forgotten."""
    monkeypatch.setattr(mbd_ros, "compiled", mbd_ros.compiled)  # which imports replace
    hidden = ("casadi", "mbd_ros.compiled")
    before = [name for name in sys.modules if name.startswith(hidden)]
    for name in before:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "casadi", None)
    yield
    for name in [name for name in sys.modules if name.startswith(hidden)]:
        if name not in (*before, "casadi"):
            del sys.modules[name]


@pytest.mark.usefixtures("no_casadi")
def test_without_casadi(tmp_path, capsys):
    said = refusals(tmp_path, capsys)
    assert all("casadi is not installed: pip install 'mbd_ros[compiled]'" in each for each in said)


def test_without_a_compiler(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("mbd_ros.compiled.build.compiler.find_spec", lambda name: None)
    said = refusals(tmp_path, capsys)
    assert all("no C compiler found: none of cc, gcc, clang on the PATH" in each for each in said)


def test_with_a_compiler_that_fails(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("CC", "false")
    said = refusals(tmp_path, capsys)
    assert all("false" in each and "ended with exit code 1" in each for each in said)


def refusals(folder, capsys):
    """What `compiled`, an error, and `auto`, which goes on, say."""
    path, out = folder / "scene.yaml", folder / "o.csv"
    path.write_text(PENDULUM)
    words = ["simulate", str(path), "-t", "0.05", "-o", str(out)]
    assert main([*words, "--compiled"]) == BAD_INPUT
    error = capsys.readouterr().err
    assert "solver compiled: " in error
    assert not out.exists()
    said = run(capsys, *words, "--solver", "auto")
    assert "\nDopri5, tier aba: 50 steps" in said
    assert "not compiled: " in said
    return error, said


@pytest.mark.parametrize(
    ("sections", "why"),
    [
        ({"integrator": {"type": "moreau_jean"}}, "integrator moreau_jean"),
        ({"stabilization": {"type": "none"}, "constraints": [
            {"type": "joint_stop", "joint": "hinge", "upper": 1.0, "smoothed": True}
        ]}, "hinge"),
    ],
)  # fmt: skip
def test_what_cannot_be_compiled_is_named(sections, why):
    scene = scene_of(PENDULUM).with_(**sections)
    with pytest.raises(SceneError, match=f"solver compiled: .*{why}.*accepted here: auto"):
        scene.simulation(solver=COMPILED)
    assert scene.simulation(solver={"type": "auto"}).how.startswith("not compiled: ")


def test_check_says_what_a_step_costs(tmp_path, capsys):
    said = run(capsys, "check", "four_bar_leg", "--compiled")
    (words,) = re.findall(r"^compiled +(.*)$", said, re.M)
    pattern = (
        r"\d+ operations by .* in [\d.]+ s; one step of Dopri5 ([\d.]+) us, plain ([\d.]+) us"
    )
    ours, plain = map(float, re.fullmatch(pattern, words).groups())
    assert 20.0 * ours < plain  # measured: 150 to 250
    assert "compiled" not in run(capsys, "check", "four_bar_leg")
    said = run(capsys, "check", "stack", "--compiled")
    assert "compiled    not: integrator moreau_jean takes no compiled steps\n" in said


@pytest.mark.parametrize("scene", ["prosthetic_arm", "four_bar_leg"])
def test_live_ticks_have_the_bits_of_an_offline_run(scene):
    scene = load_scene(scene)
    build = partial(scene.simulation, solver=COMPILED)
    live = LiveSimulation(build, scene.initial, 1e-3, CommandWatch(0.1, 0.1), scene.safe)
    states = list(build().run(scene.initial, 0.1))
    for _ in range(2):
        for x in states[1:]:
            live.tick()
            assert [each.tobytes() for each in live._x[1:3]] == [e.tobytes() for e in x[1:3]]
        live.reset()


def test_dependent_rows_are_handed_over(capsys):
    """The same loop twice: the plain tier solves by rank, compiled steps leave it to it."""
    scene = load_scene("four_bar_leg")
    loop = scene.entries["constraints"][0]
    scene = scene.with_(constraints=[loop, {**loop, "name": "again"}])
    found, wanted = (simulate(scene, 0.02, solver=kind) for kind in (COMPILED, PLAIN))
    assert "20 of the steps were not compiled: " in "\n".join(found.metadata["remarks"])
    how = scene.simulation(solver={"type": "auto"}).how
    assert how == "not compiled: 2 of 4 rows are independent, plain steps solve by rank"
    for name, values in wanted["samples"].items():
        np.testing.assert_array_equal(found["samples"][name], values, err_msg=name)


def test_rows_that_are_always_zero_are_named():
    """A planar loop that is closed in space, too: its third row holds nothing."""
    scene = load_scene("four_bar_leg")
    loop = scene.entries["constraints"][0]
    scene = scene.with_(constraints=[{**loop, "directions": "xyz"}])
    with pytest.raises(SceneError, match="solver compiled: 2 of 3 rows are independent"):
        scene.simulation(solver=COMPILED)
    assert scene.simulation(solver={"type": "auto"}).how.startswith("not compiled: 2 of 3 rows")


def test_ctrl_c_keeps_the_motion_so_far(monkeypatch):
    monkeypatch.setattr("mbd_ros.jobs.progress.PERIOD", 0.0)  # the run takes less

    def stop(label, share):
        if share > 0.3:
            raise KeyboardInterrupt

    result = simulate(load_scene("arm7"), 50.0, solver=COMPILED, progress=stop)
    assert result.metadata["ended"].startswith("interrupted after t = ")
    assert 0.0 < result["samples"]["time"][-1] < 50.0
