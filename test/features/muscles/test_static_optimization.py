"""Muscle forces and loads of joints: OpenSim's exact optima, and what no optimum may do."""

import csv
import gzip

import numpy as np
import pytest
from places import RECORDINGS

from mbd_ros.api import scene_from
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError
from mbd_ros.features.muscles.static_optimization import (
    Criterion,
    SharingOptions,
    StaticOptimization,
    shortening_rate,
)
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads, JointReactions
from mbd_ros.methods.inverse_dynamics.reserves import BodyReserve, joint_reserve

PLATES = {
    name: {"frame": f"calcn_{name[0]}", "expressed_in": "world"} for name in ("right", "left")
}


def table(path):
    with gzip.open(path, "rt") as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))


class Walk:
    """The walking trial of OpenSim's example with 10 coordinates and 18 muscles."""

    def __init__(self, folder):
        self.folder = folder
        model = folder / "raw" / "subject01.osim.gz"
        self.scene = scene_from({"robot": {"osim": str(model)}, "external_wrenches": PLATES})
        self.couplings = self.scene.couplings
        motion, plates = (
            table(folder / "motion.csv.gz"),
            table(folder / "external_wrenches.csv.gz"),
        )
        kinds = ("position", "velocity", "acceleration")
        self.motion = [self.columns(motion, self.couplings.independent, kind) for kind in kinds]
        axes = [f"{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]
        self.wrenches = [np.column_stack([plates[f"{p}.{axis}"] for axis in axes]) for p in PLATES]
        self.times = motion["time"]

    @staticmethod
    def columns(found, names, kind):
        return np.column_stack([found[f"{name}.{kind}"] for name in names])

    def reserves(self, weak):
        """As the files of the example have them: residuals at the pelvis, torques elsewhere."""
        robot, optimal = self.scene.robot, 1.0 if weak else 100.0
        on = {"frame": "pelvis", "point": [-0.034, 0.0, 0.0]}
        up = 2.0 if weak else 100.0
        joints = [name for name in self.couplings.independent if "pelvis" not in name]
        return [
            BodyReserve(robot, name="FX", force=[1, 0, 0], optimal_force=optimal, **on),
            BodyReserve(robot, name="FY", force=[0, 1, 0], optimal_force=up, **on),
            BodyReserve(robot, name="MZ", torque=[0, 0, 1], optimal_force=optimal, frame="pelvis"),
            *(joint_reserve(robot, self.couplings, name, optimal) for name in joints),
        ]

    def solver(self, reserves, **sharing):
        known = self.scene.without(["muscles"]).inverse_dynamics()
        robot, muscles = self.scene.robot, self.scene.muscles
        return StaticOptimization(robot, known, muscles, reserves, SharingOptions(**sharing))

    def solve(self, reserves, some=slice(None), measured=None, **sharing):
        motion = [values[some] for values in self.motion]
        loads = [wrench[some] for wrench in self.wrenches]
        solver = self.solver(reserves, **sharing)
        return solver.solve(self.times[some], *motion, loads, measured)


@pytest.fixture(scope="module")
def walk():
    return Walk(RECORDINGS / "gait10dof/muscles")


@pytest.mark.parametrize("kind", ["weak", "strong"])
def test_activations_of_walking_are_the_exact_optimum(walk, kind):
    expected = table(walk.folder / f"so_{kind}_reserves_exact_true_pennation.csv.gz")
    opensim = table(walk.folder / f"so_{kind}_reserves_opensim_tol0.0001.csv.gz")
    names = [muscle.name for muscle in walk.scene.muscles]
    found = walk.solve(walk.reserves(kind == "weak"))
    assert np.abs(found.activation - walk.columns(expected, names, "activation")).max() <= 1e-8
    assert np.abs(found.force - walk.columns(expected, names, "force")).max() <= 1e-5
    assert found.residual.max() <= 1e-8
    assert found.is_feasible.all()
    assert (found.rank == 10).all()
    assert (found.null_space == 18).all()
    assert not any(found.movable)
    of_opensim = sum(v**2 for name, v in opensim.items() if name.endswith(".activation"))
    assert (found.objective <= of_opensim + 0.05 * of_opensim.max()).all()  # its pennation differs


@pytest.mark.parametrize("reserves", [True, False])
def test_activations_of_an_arm_without_wraps_are_the_exact_optimum(reserves):
    """`arm26` with six Thelen muscles; OpenSim's moment arms are -dL/dq where nothing wraps."""
    folder = RECORDINGS / "arm26/muscles"
    scene = scene_from({"robot": {"osim": str(folder / "raw" / "arm26.osim.gz")}})
    plain = {
        name: {key: given for key, given in path.items() if key != "wraps"}
        for name, path in scene.entries["paths"].items()
    }
    scene = scene.with_(paths=plain)
    robot, couplings, muscles = scene.robot, scene.couplings, scene.muscles
    joints = couplings.independent if reserves else ()
    help_ = [joint_reserve(robot, couplings, joint, 1.0) for joint in joints]
    motion = table(folder / "motion.csv.gz")
    kinds = ("position", "velocity", "acceleration")
    rows = [Walk.columns(motion, couplings.independent, kind) for kind in kinds]
    found = StaticOptimization(robot, scene.inverse_dynamics(), muscles, help_).solve(
        motion["time"], *rows
    )
    name = "reserves" if reserves else "no_reserves"
    expected = table(folder / f"no_wrap_so_{name}_exact.csv.gz")
    names = [muscle.name for muscle in muscles]
    activation = Walk.columns(expected, names, "activation")
    assert np.abs(found.activation - activation).max() <= 1e-8
    assert found.residual.max() <= 1e-8


def test_frames_one_by_one_are_those_of_a_whole_motion(walk):
    reserves, whole = walk.reserves(weak=True), slice(30, 40)
    together = walk.solve(reserves, whole)
    for i in range(10):
        alone = walk.solve(reserves, slice(30 + i, 31 + i))
        assert alone.activation[0] == pytest.approx(together.activation[i], abs=1e-9)
        assert alone.frames.columns[0] == pytest.approx(together.frames.columns[i], abs=1e-12)


def test_muscles_and_reserves_exert_what_the_motion_needs(walk):
    found = walk.solve(walk.reserves(weak=True), slice(0, 20))
    forces = np.concatenate((found.force, found.reserve), axis=1)
    exerted = np.einsum("tji,ti->tj", found.frames.columns, forces)
    assert np.abs(exerted - found.needed).max() <= 1e-9 * np.abs(found.needed).max()


def test_passive_forces_take_part_where_they_are_asked_for(walk):
    found = walk.solve(walk.reserves(weak=True), slice(0, 20), passive=True)
    forces = np.concatenate((found.force, found.reserve), axis=1)
    exerted = np.einsum("tji,ti->tj", found.frames.columns, forces)
    assert np.abs(exerted - found.needed).max() <= 1e-9 * np.abs(found.needed).max()
    assert found.force == pytest.approx(
        found.activation * found.frames.active + found.frames.passive, abs=1e-9
    )
    assert found.frames.passive.max() > 100.0


@pytest.mark.parametrize(
    "criterion",
    [
        Criterion("activation", 3.0),
        Criterion("stress", 3.0),
        Criterion("volume", 2.0),
        Criterion("metabolic", 1.0),
        Criterion("metabolic", 2.0),
    ],
)
def test_no_neighbour_of_an_optimum_costs_less(walk, criterion):
    """Steps along random directions of the null space, as far as bounds let them."""
    rng, reserves = np.random.default_rng(2), walk.reserves(weak=False)
    solver = walk.solver(reserves, criterion=criterion)
    some = slice(0, 100, 20)
    motion = [values[some] for values in walk.motion]
    found = solver.solve(walk.times[some], *motion, [w[some] for w in walk.wrenches])
    frames, n = found.frames, len(walk.scene.muscles)
    optimal = [reserve.optimal for reserve in reserves]
    prices = criterion.prices(solver._sizes, frames.active, frames.fiber_speed)
    p = criterion.exponent
    for t in range(len(found.objective)):
        x = np.concatenate((found.activation[t], found.reserve[t] / optimal))
        A = frames.columns[t] * np.concatenate((frames.active[t], optimal))
        null = np.linalg.svd(A)[2][10:].T
        weight = np.concatenate((prices[t], np.ones(len(optimal))))
        for _ in range(50):
            step = null @ rng.normal(size=null.shape[1])
            beside = x + 1e-4 * step / np.abs(step).max()
            inside = (beside[:n] >= 0.01 - 1e-12).all() and (beside[:n] <= 1.0 + 1e-12).all()
            cost = weight @ np.abs(beside) ** p
            assert not inside or cost >= found.objective[t] * (1.0 - 1e-12)
        assert weight @ np.abs(x) ** p == pytest.approx(found.objective[t], rel=1e-12)


def test_without_reserves_frames_name_what_lacks(walk):
    """Nothing carries the pelvis: its residual is what inverse dynamics finds."""
    found = walk.solve([], slice(0, 5))
    assert not found.is_feasible.any()
    pelvis = [walk.couplings.independent.index(f"pelvis_{axis}") for axis in ("tx", "ty", "tilt")]
    others = np.setdiff1d(np.arange(10), [*pelvis, 9])
    assert found.lacking[:, pelvis] == pytest.approx(found.needed[:, pelvis], rel=1e-9)
    assert np.abs(found.lacking[:, others]).max() <= 1e-3


def test_limited_rates_are_kept(walk):
    found = walk.solve(walk.reserves(weak=False), rise=2.0, fall=1.0)
    rate = np.diff(found.activation, axis=0) / np.diff(walk.times)[:, None]
    free = walk.solve(walk.reserves(weak=False))
    assert rate.max() <= 2.0 + 1e-9
    assert rate.min() >= -1.0 - 1e-9
    assert (found.objective.sum()) > free.objective.sum()
    assert found.residual.max() <= 1e-8


def test_measured_activations_are_tracked_or_least(walk):
    rng, n = np.random.default_rng(0), len(walk.scene.muscles)
    measured = rng.uniform(0.05, 0.3, (10, n))
    measured[:, 3:] = np.nan
    reserves, some = walk.reserves(weak=False), slice(0, 10)
    free = walk.solve(reserves, some)
    tracked = walk.solve(reserves, some, measured, tracking=1000.0)
    least = walk.solve(reserves, some, measured, measured_is_least=True)
    off = np.abs(free.activation - measured)[:, :3]
    assert np.abs(tracked.activation - measured)[:, :3].max() <= 0.02 < off.max()
    assert (least.activation[:, :3] >= measured[:, :3]).all()
    assert (least.activation[:, 3:] >= 0.01).all()
    assert max(tracked.residual.max(), least.residual.max()) <= 1e-8


@pytest.mark.parametrize("side", ["child", "ground", "parent"])
def test_loads_of_joints_are_those_of_opensim(walk, side):
    """With the forces of `so_weak_reserves_exact`; the file has 10 digits, 5e-7 N of 3492."""
    given = table(walk.folder / "so_weak_reserves_exact.csv.gz")
    expected = table(walk.folder / "joint_reactions.csv.gz")
    scene, couplings, reserves = walk.scene, walk.couplings, walk.reserves(weak=True)
    body = [reserve.name for reserve in reserves]
    tension = walk.columns(given, [m.name for m in scene.muscles], "force")
    reserve = walk.columns(given, body, "force")
    bare = JointReactions(
        scene.robot, ConstraintRows((), scene.robot.model.nv), tuple(scene.wrenches.values())
    )
    joints = {"femur": "hip", "tibia": "knee", "talus": "ankle"}
    links = [f"{link}_{foot}" for foot in "rl" for link in joints]
    loads = JointLoads(scene.robot, bare, scene.muscles, reserves, links, side)
    for t in range(0, len(walk.times), 10):
        q, v, a = (np.zeros(scene.robot.model.nv) for _ in range(3))
        for all_, some in zip((q, v, a), walk.motion, strict=True):
            all_[couplings.v_index] = some[t]
        couplings.expand(q, v, a)
        wrenches = [wrench[t] for wrench in walk.wrenches]
        total, parts = loads.solve(State(0.0, q, v), a, tension[t], reserve[t], wrenches)
        for row, one in enumerate(loads.joint_links):
            name = f"{joints[one.link[:-2]]}{one.link[-2:]}"
            where = one.parent_link if side == "parent" else one.link
            axes = "ground" if side == "ground" else where
            columns = [f"{name}_on_{where}_in_{axes}_{k}{axis}" for k in "fm" for axis in "xyz"]
            assert np.abs(total[row] - [expected[c][t] for c in columns]).max() <= 1e-6
        assert parts.shape == (18, 6, 6)


def test_loads_are_the_sum_of_those_without_muscles_and_of_each(walk):
    scene, nv = walk.scene, walk.scene.robot.model.nv
    bare = JointReactions(scene.robot, ConstraintRows((), nv), tuple(scene.wrenches.values()))
    loads = JointLoads(scene.robot, bare, scene.muscles, (), ["tibia_r"])
    rng = np.random.default_rng(1)
    x, a = State(0.0, 0.1 * rng.normal(size=nv), rng.normal(size=nv)), rng.normal(size=nv)
    tension, none = rng.uniform(0.0, 900.0, 18), np.zeros(0)
    idle, _ = loads.solve(x, a, np.zeros(18), none)
    total, parts = loads.solve(x, a, tension, none)
    assert total == pytest.approx(idle + parts.sum(axis=0), rel=1e-12, abs=1e-9)


def test_metabolic_rate_at_rest_and_at_the_largest_speed():
    """Its numbers by hand: 0.054 at rest, 3.02 / 11.03 at the largest speed of shortening."""
    assert shortening_rate(np.array([0.0, 1.0])) == pytest.approx([0.054, 3.02 / 11.03])
    assert shortening_rate(np.linspace(-1.0, 1.0, 201)).min() > 0.0
    assert shortening_rate(np.array([-2.0, 3.0])) == pytest.approx(
        shortening_rate(np.array([-1.0, 1.0]))
    )


def test_what_cannot_be_asked_is_refused(walk):
    robot, couplings = walk.scene.robot, walk.couplings
    with pytest.raises(ModelError, match="knee_r_tx: the joint depends on knee_angle_r"):
        joint_reserve(robot, couplings, "knee_r_tx", 1.0)
    with pytest.raises(ModelError, match="force and torque are both zero"):
        BodyReserve(robot, name="F", frame="pelvis")
    with pytest.raises(ModelError, match="accepted: world, pelvis"):
        BodyReserve(robot, name="F", frame="pelvis", force=[1, 0, 0], expressed_in="tibia_r")
    with pytest.raises(ModelError, match="accepted: 1 .. 3"):
        walk.solver([], tracking=1.0, criterion=Criterion("activation", 4.0))
    with pytest.raises(ModelError, match="no joint carries link 'ground'"):
        JointLoads(robot, None, (), (), ["ground"])
