"""What the stability map found: rows that nothing moves, one coordinate, one row, long steps."""

import numpy as np
import pytest
from systems import acceleration

from mbd_ros import scene_from
from mbd_ros.applications.report.stability.oracle import Oracle
from mbd_ros.applications.report.stability.scenes import mechanism, rods
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.optimization.box_qp import complementarity_residual
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError
from mbd_ros.methods.integration.linear_motion import fastest_rate
from mbd_ros.methods.projection.assembly import assemble, project, violation

STOP = {"type": "joint_stop", "joint": "j0", "upper": 0.1, "smoothed": True}
FRICTION = {"type": "dry_friction", "joint": "j1", "limit": 0.1, "smoothed": True}
ONE = {"j1": {"parent": "j0", "factor": 0.5}}
BOTH = {**ONE, "j2": {"parent": "j0", "polynomial": [0.1, 0.3, 0.2]}}


@pytest.mark.parametrize("bounded", [[], [STOP], [STOP, FRICTION]])
@pytest.mark.parametrize("couplings", [ONE, BOTH], ids=["two coordinates", "one coordinate"])
def test_eliminated_and_kept_couplings_agree_beside_bounded_rows(couplings, bounded):
    start = {"position": {"j0": 0.09}, "velocity": {"j0": 2.0}}
    sections = {"couplings": couplings, "constraints": bounded, "initial": start}
    loaded = mechanism({k: v for k, v in sections.items() if v}, *rods((1.0, 1.0, 1.0)))()
    found = []
    for tier in ("plain", "qp"):
        system = loaded.scene.system(solver={"type": tier})
        y = system.reduce(loaded.scene.initial)
        assert acceleration(system, y.t, y.q, y.v).shape == (system.nv,)
        found.append(system.evaluate(loaded.scene.initial))
        assert Oracle(loaded).complaints(system, y) == []
    assert found[0].a == pytest.approx(found[1].a, rel=1e-9)
    assert found[0].lam == pytest.approx(found[1].lam, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("tier", ["kkt", "qp"])
def test_a_row_that_no_joint_moves_changes_nothing(tier):
    """Rods in the x-y plane do not leave it: z is kept already, and J is what rounding leaves."""
    closure = {"type": "loop_closure", "kind": "point", "directions": "z", "frame_a": "world"}
    closure |= {"frame_b": "b1", "point_b": [0.3, 0.2, 1e-17], "point_a": [0.1, 0.2, 0.0]}
    start = {"position": {"j0": 0.4, "j1": 1.1}, "velocity": {"j0": 2.0, "j1": -3.0}}
    free = mechanism({"initial": start}, *rods((1.0, 1.0)))().scene
    held = mechanism({"initial": start, "constraints": [closure]}, *rods((1.0, 1.0)))().scene
    system = held.system(solver={"type": tier})
    _, a, _, lam, _ = system.evaluate(assemble(system, held.initial))
    assert a == pytest.approx(free.system().evaluate(free.initial).a, rel=1e-12)
    assert lam == pytest.approx([0.0])


def test_rows_of_rounding_have_no_rank():
    J = np.array([[0.0, 3e-17], [0.2, 0.1]])
    factor = RowFactor(np.eye(2), J)
    assert factor.rank == 1
    assert factor.solve(np.array([1e-17, 1.0]))[0] == 0.0
    assert RowFactor(np.eye(2), J[:1]).rank == 0


def test_a_stop_that_rows_hold_still_is_left_alone_unless_it_must_act():
    def accelerate(upper):
        held = {"type": "prescribed_motion", "joint": "j0", "polynomial": [0.2]}
        stop = {"type": "joint_stop", "joint": "j0", "upper": upper, "smoothed": True}
        other = {"type": "joint_stop", "joint": "j1", "upper": 0.0, "smoothed": True}  # acts
        sections = {"constraints": [held, stop, other], "initial": {"position": {"j0": 0.2}}}
        scene = mechanism(sections, *rods((1.0, 1.0)))().scene
        system = scene.system()
        return acceleration(system, 0.0, scene.initial.q, np.array([0.0, 1.0]))

    assert accelerate(0.3)[0] == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(SolveError, match=r"nothing moves constraint row j0_joint_stop.torque"):
        accelerate(0.1)


def test_huge_multipliers_do_not_excuse_what_they_leave():
    A, b = np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([1.0, 0.9])
    free = np.full(2, np.inf)
    assert complementarity_residual(A, b, -free, free, np.array([1e17, -1e17])) > 1e-7


def four_bar():
    closure = {"type": "loop_closure", "kind": "point", "directions": "xy", "frame_a": "world"}
    closure |= {"point_a": [1.3, 0.0, 0.0], "frame_b": "b2", "point_b": [1.0, 0.0, 0.0]}
    start = {"position": {"j0": 1.5708, "j1": -1.6174, "j2": -1.218}}
    sections = {"constraints": [closure], "initial": start}
    return mechanism(sections, *rods((1.0, 1.0, 1.0)))().scene


def test_projection_closes_positions_and_velocities_after_a_long_step():
    scene = four_bar()
    system = scene.system()
    x = assemble(system, scene.initial)
    far = State(0.0, x.q + np.array([0.2, -0.1, 0.15]), np.array([5.0, -3.0, 2.0]))
    assert violation(system, project(system, far)) <= (1e-13, 1e-11)


def test_projection_from_beyond_reach_is_an_error_with_row_and_time():
    scene = four_bar()
    system = scene.system()
    away = State(0.5, scene.initial.q + np.array([2.0, -3.0, 5.0]), scene.initial.v)
    with np.errstate(all="ignore"):
        try:
            landed = project(system, away)
        except SolveError as error:
            assert "t = 0.5 s" in str(error)
            assert "b2_loop_closure" in str(error)
        else:
            assert violation(system, landed).position <= 1e-6


def test_bounded_rows_count_in_the_fastest_rate():
    stop = {"type": "joint_stop", "joint": "j0", "upper": 2.0, "time_constant": 0.001}
    scene = mechanism({"constraints": [stop]}, *rods((1.0,)))().scene
    assert fastest_rate(scene.system(), scene.initial) == pytest.approx(1000.0)


def test_coupling_rows_overflow_to_infinity():
    scene = mechanism({"couplings": BOTH}, *rods((1.0, 1.0, 1.0)))().scene
    assert isinstance(scene.couplings, Couplings)
    system = scene.system(solver={"type": "kkt"})
    part = system.constraints.parts[0]
    fast = State(0.0, scene.initial.q, np.full(3, 1e200))
    with np.errstate(over="ignore"):
        assert np.isinf(part.drift(Kinematics, fast)[1])


def test_friction_of_a_rocker_goes_on_where_the_rocker_turns():
    """There no force moves it: its friction changes sides, and takes limit times way in all."""
    scene = scene_from(
        {
            "robot": {"urdf": "package://mbd_ros/config/robots/four_bar_leg.urdf"},
            "constraints": [
                {"type": "dry_friction", "joint": "knee_tibial", "limit": 1.0},
                {
                    "type": "loop_closure",
                    "kind": "point",
                    "directions": "xz",
                    "frame_a": "posterior_bar",
                    "point_a": [-0.007, 0.0, -0.051],
                    "frame_b": "shank",
                    "point_b": [-0.059, 0.0, 0.002],
                },
            ],
            "initial": {
                "position": {
                    "hip_flexion": 0.3,
                    "knee_anterior": -0.8844343782453666,
                    "knee_tibial": 0.18630267744763485,
                    "knee_posterior": -1.1433094128214365,
                }
            },
        }
    )
    result = scene.simulate(0.6)
    samples, events = result.tables["samples"], result.tables["events"]
    position = samples["knee_tibial.position"]
    turns = [position[0], *events["knee_tibial.position.before"], position[-1]]
    assert len(turns) == 4
    way = float(np.abs(np.diff(turns)).sum())
    energy = samples["energy"]
    assert energy[0] - energy[-1] == pytest.approx(1.0 * way, rel=1e-8)
