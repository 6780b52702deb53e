"""Many runs from the rows of a file into one table."""

import numpy as np
import pytest

from mbd_ros.api import load_scene
from mbd_ros.cli import main
from mbd_ros.files.table import read_result

ROWS = """ankle.position,ankle.velocity,ankle_joint_spring.stiffness
0.1,0.0,30.0
-0.1,0.5,60.0
0.0,0.3,90.0
"""
SCENE = """robot: {urdf: package://mbd_ros/config/robots/prosthetic_leg.urdf}
forces: [{type: joint_spring, joint: ankle, stiffness: 20.0, damping: 0.5}]
integrator: {type: rk4}
dt: 1.0e-3
"""


@pytest.fixture
def simulate(tmp_path, capsys):
    """`simulate --ensemble` with rows: exit code, table and what is written to stderr."""
    scene = tmp_path / "leg.yaml"
    scene.write_text(SCENE, encoding="utf-8")
    rows, out = tmp_path / "rows.csv", tmp_path / "out.csv"

    def run(text, *words):
        rows.write_text(text, encoding="utf-8")
        given = ["simulate", str(scene), "-t", "0.02", "--ensemble", str(rows), "-o", str(out)]
        code = main([*given, *words])
        return code, read_result(out)["samples"] if out.exists() else None, capsys.readouterr().err

    run.scene = scene
    return run


@pytest.mark.parametrize(
    "words",
    [
        ("--compiled",),
        ("--solver", "plain", "--workers", "1"),
        ("--solver", "plain", "--workers", "2"),
        ("--solver", "plain", "--scheduler", "local:2"),
        ("--compiled", "--scheduler", "local:1"),
    ],
)
def test_each_row_is_a_run(simulate, words):
    if "--scheduler" in words:
        pytest.importorskip("distributed")
    code, table, _ = simulate(ROWS, *words)
    assert code == 0
    assert list(table)[:2] == ["run", "time"] and table["run"].tolist() == sorted([0, 1, 2] * 21)
    scene = load_scene(simulate.scene)
    for i, line in enumerate(ROWS.splitlines()[1:]):
        q, v, k = map(float, line.split(","))
        one = scene.with_({"ankle_joint_spring.stiffness": k})
        x = one.initial._replace(q=one.initial.q.copy(), v=one.initial.v.copy())
        joint = one.robot.joint("ankle")
        x.q[joint.q], x.v[joint.v] = q, v
        rows = one.simulation(solver={"type": "plain"}).sampled(x, 0.02)
        own = table["run"] == i
        nq = one.robot.model.nq
        for name, column in (("position", 1 + joint.q), ("velocity", 1 + nq + joint.v)):
            assert np.abs(table[f"ankle.{name}"][own] - rows[:, column]).max() < 1e-11


def test_a_run_that_diverges_is_named_and_the_others_are_written(simulate):
    code, table, said = simulate("ankle.velocity\n0.1\n1e200\n0.2\n", "--compiled")
    assert code == 1
    assert "1 of 3 runs ended early: run 1 (line 3): " in said and "last finite" in said
    assert [int((table["run"] == i).sum()) for i in (0, 2)] == [21, 21]
    assert (table["run"] == 1).sum() < 21


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "is empty, expected a header line"),
        ("ankle.position\n", "has a header and no data"),
        ("ankel.position\n1.0\n", "column ankel.position: "),
        ("ankle_joint_spring.stiffness\n3.0\n-1.0\n", "run 1: "),
        ("ankle.position\n1.0\ntwo\n", "line 3, column ankle.position: 'two'"),
        ("integrator.tolerance\n1e-3\n", "column integrator.tolerance: is no number of a part"),
    ],
)
def test_a_file_that_is_no_ensemble_is_refused(simulate, rows, said):
    code, table, error = simulate(rows, "--solver", "plain", "--workers", "1")
    assert code == 2 and table is None
    assert "rows.csv" in error and said in error
