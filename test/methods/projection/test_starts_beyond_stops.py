"""Starts beyond exact stops, of mechanisms whose loop has to be closed as well."""

import numpy as np
import pytest
import yaml
from places import ROOT

import mbd_ros as mbd
from mbd_ros.errors import SolveError
from mbd_ros.methods.projection.assembly import violation

PATH = ROOT / "config/scenes/four_bar_leg.yaml"
SECTIONS = yaml.safe_load(PATH.read_text(encoding="utf-8"))
PUSH = {"type": "joint_spring", "joint": "hip_flexion", "stiffness": 400.0, "rest": 0.6}


STOP = {"type": "joint_stop", "joint": "hip_flexion", "upper": 0.2}
HELD = {"type": "prescribed_motion", "joint": "hip_flexion"}


def stopped(solver, *forces, rows=()):
    return mbd.load_scene(PATH).with_(
        constraints=[*SECTIONS["constraints"], STOP, *rows],
        forces=[*SECTIONS["forces"], *forces],
        solver={"type": solver},
    )


@pytest.mark.parametrize("solver", ["plain", "qp"])
def test_a_start_beyond_a_stop_is_moved_to_it_with_the_loop_closed(solver):
    scene = stopped(solver)
    simulation = scene.simulation()
    y = simulation.start(scene.initial)
    assert scene.initial.q[0] == pytest.approx(0.3)
    assert y.q[0] == pytest.approx(0.2, abs=1e-12)
    off = violation(simulation.system, y)
    assert off.position < 1e-12 and off.velocity < 1e-12


@pytest.mark.parametrize("forces", [(), (PUSH,)], ids=["leaves", "stays"])
def test_solvers_with_and_without_a_qp_go_on_alike(forces):
    """Multipliers of the loop by elimination, and together with that of the stop by a QP."""
    ends = []
    for solver in ("plain", "qp"):
        scene = stopped(solver, *forces)
        simulation = scene.simulation()
        *_, x = simulation.run(scene.initial, 0.2)
        ends.append(x)
        assert violation(simulation.system, simulation.system.reduce(x)).position < 1e-10
        assert (abs(x.q[0] - 0.2) < 1e-10) == bool(forces)
    np.testing.assert_allclose(ends[0].q, ends[1].q, atol=1e-9)
    np.testing.assert_allclose(ends[0].v, ends[1].v, atol=1e-8)


@pytest.mark.parametrize("solver", ["plain", "qp"])
def test_a_stop_that_other_rows_keep_out_of_reach_is_an_error_with_its_name(solver):
    scene = stopped(solver, rows=[{**HELD, "polynomial": [0.3]}])
    with pytest.raises(SolveError, match="hip_flexion_joint_stop"):
        scene.simulation().start(scene.initial)
