"""Feet on the ground that no plate measured: stance, double support, forces of contacts."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.contracts import Wrench, label
from mbd_ros.core.dynamics.output_values import in_link
from mbd_ros.core.geometry.contact_outputs import OPEN
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.rows.constraint_rows import labelled
from mbd_ros.core.state import NANOSECOND, Array, Motion, State
from mbd_ros.errors import DataError, SolveError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import Result
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.methods.inverse_dynamics.efforts import Mask as UnknownsMask
from mbd_ros.methods.inverse_dynamics.efforts import listed
from mbd_ros.methods.inverse_dynamics.force_split import Wish
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import Torques
from mbd_ros.methods.inverse_dynamics.standing import Nearness
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, Observations
from mbd_ros.motion.recordings import Source, name_of, read_columns, read_motion
from mbd_ros.motion.samples import Observed
from mbd_ros.scene.built_scene import MeasuredWrench, Scene

# ---- unmeasured contacts ----------------------------------------------------------------------
# Contacts whose forces nobody measured: unknowns of inverse dynamics.


Mask = NDArray[np.bool_]
METHODS = ("minimum-norm", "smooth")


class StanceTask(NamedTuple):
    """What is asked of feet on the ground.

    Attributes:
        method: One of `METHODS`: what decides where a motion does not.
        near: What counts as on the ground, where the motion has no states of contacts.
    """

    method: str = METHODS[0]
    near: Nearness = Nearness()


class Ground(NamedTuple):
    """Contacts of unknown force.

    Attributes:
        task: What is asked.
        contacts: Their names.
        given: Which features stand, as columns of the motion say, shape (n, features); None for
            what geometry says.
        by: What says so.
    """

    task: StanceTask
    contacts: tuple[str, ...]
    given: Mask | None = None
    by: str = "geometry"

    def told(self, scene: Scene, source: Source, observed: Observed) -> "Ground":
        """The same with what columns of a motion say of the features.

        `<contact>.state` says it of each, `phase` by the contacts of a phase where these are
        held.

        Raises:
            DataError: Some columns of states are there and others are not, or a phase that the
                scene does not have; names these.
        """
        rows = np.searchsorted(observed.motion.stamps, observed.samples.stamps)
        parts = [part for part in scene.constraints if part.name in self.contacts]
        states = _states(source, parts)
        if states is not None:
            return self._replace(given=states[rows] != OPEN, by="columns of states")
        held = _held(scene, source, parts) if scene.phases else None
        return self if held is None else self._replace(given=held[rows], by="phases")


def _states(source: Source, parts: Sequence[Any]) -> Array | None:
    """Columns of states of all features; None where there is none of them."""
    names = [
        f"{part.name}.state" + (f"_{feature}" if len(part.features) > 1 else "")
        for part in parts
        for feature in part.features
    ]
    states = read_columns(source, names)
    gaps = [] if states is None else np.isnan(states).any(axis=0)
    lacking = [name for name, bad in zip(names, gaps, strict=False) if bad]
    if lacking:
        raise DataError(
            f"{name_of(source)}: no column {listed(lacking)}, or it has gaps; accepted: the "
            f"states of all features, or none: {listed(names)}"
        )
    return states


def _held(scene: Scene, source: Source, parts: Sequence[Any]) -> Mask | None:
    """Features that the phase of each row holds; None without phases, or where some hold none."""
    plans, numbers = list(scene.phases.values()), read_columns(source, ["phase"])
    if numbers is None or not all(plan.held for plan in plans):
        return None
    unknown = ~np.isin(numbers[:, 0], np.arange(len(plans)))
    if unknown.any():
        raise DataError(
            f"{name_of(source)}: phase {numbers[unknown][0, 0]:g} is none of the scene; accepted: "
            f"0 to {len(plans) - 1}: {', '.join(plan.name for plan in plans)}"
        )
    of_phase = np.array(
        [[part.name in plan.contacts for part in parts for _ in part.features] for plan in plans]
    )
    held: Mask = of_phase[numbers[:, 0].astype(int)]
    return held


def stance_task(method: str | None, gap: float | None, speed: float | None) -> StanceTask | None:
    """The task of the options of a command; None where none is asked for.

    Raises:
        DataError: An unknown method, thresholds below 0, or thresholds alone.
    """
    given = {"gap": gap, "speed": speed}
    limits = {name: value for name, value in given.items() if value is not None}
    if method is None:
        if limits:
            raise DataError(f"--stance-{next(iter(limits))} goes with --stance")
        return None
    if method not in METHODS:
        raise DataError(f"--stance {method}: accepted: {', '.join(METHODS)}")
    for name, value in limits.items():
        if not 0.0 <= value < np.inf:
            raise DataError(f"--stance-{name} {value:g} must be >= 0 and finite")
    return StanceTask(method, Nearness()._replace(**limits))


def ground_of(scene: Scene, task: StanceTask, known: Sequence[str], say: Say) -> Ground:
    """The contacts of unknown force of a scene.

    Args:
        scene: The scene, with the loads that somebody measured.
        task: What is asked.
        known: Contacts whose forces the motion carries.
        say: Is told what is known.

    Raises:
        DataError: The scene has no rigid contacts.
    """
    every = scene.closed_contacts
    if not every:
        raise DataError(f"{scene.name}: --stance: no rigid contacts; accepted: a scene with some")
    unknown = tuple(name for name in scene.unmeasured_contacts if name not in known)
    measured = [name for name in every if name not in unknown]
    if measured:
        say(f"stance: forces of {listed(measured)} are measured")
    return Ground(task, unknown)


def standing_in(
    inverse: ClosedLoopInverseDynamics, ground: Ground, states: Sequence[tuple[State, Array]]
) -> Mask:
    """Which features stand in each sample, shape (n, features)."""
    assert inverse.standing is not None
    if ground.given is not None:
        return ground.given
    return np.array([inverse.standing.at(x) for x, _ in states])


def stance_lines(
    inverse: ClosedLoopInverseDynamics,
    ground: Ground,
    standing: Mask,
    solved: Sequence[Torques],
    passed: str,
) -> Iterator[str]:
    """What decided, who stood, and what the forces leave."""
    feet = inverse.standing
    assert feet is not None
    stands = np.array([feet.standing_feet(row) for row in standing])
    near = ground.task.near
    by = f"gap <= {near.gap:g} L and speed along the normal <= {near.speed:g} sqrt(g L)"
    if ground.given is not None:
        by = ground.by
    shares = ", ".join(
        f"{name} {share:.0%}" for name, share in zip(feet.feet_names, stands.mean(0), strict=True)
    )
    yield f"stance: by {by}; on the ground {shares} of the time, both or more {_several(stands)}"
    free = [any(name.endswith(".effort") for name in each.undetermined) for each in solved]
    if any(free):
        how = "smallest norm of efforts, then of forces"
        if passed:
            how = f"{passed}, else {how}"
        yield f"stance: efforts are not determined in {np.mean(free):.0%} of the samples: {how}"
    bases = np.array([np.concatenate((each.residual, each.carried)) for each in solved])
    if bases.shape[1]:
        weight = float(sum(y.mass for y in inverse.robot.model.inertias)) * float(
            np.linalg.norm(inverse.robot.model.gravity.linear)
        )
        largest = np.abs(bases).max()
        size = f"{largest:.3g} N or N·m, the weight is {weight:.4g} N"
        yield f"stance: residual of the base at most {size}"


def _several(stands: Mask) -> str:
    return f"{(stands.sum(axis=1) > 1).mean():.0%}"


# ---- contact forces ---------------------------------------------------------------------------
# Forces of contacts that a motion carries: loads of its inverse dynamics.
#
# A motion does not show them: a body at rest on four legs is as much at rest under any share of
# them. A simulation writes them beside the motion, in columns `<contact>.<row>`.


class KnownContact(NamedTuple):
    """A contact whose forces a motion carries.

    Attributes:
        name: Of the contact.
        forces: In its contact frames, one row a sample [N], shape (n, m).
        stamps: Of these samples [ns], shape (n,); None for those of the motion.
        exert: Kinematics at positions, state, and one row of forces -> wrenches on bodies.
    """

    name: str
    forces: Array
    stamps: NDArray[np.int64] | None
    exert: Callable[[Kinematics, State, Array], tuple[Wrench, ...]]


def known_contacts(
    scene: Scene, source: Source, topic: str, say: Say
) -> tuple[Scene, list[KnownContact]]:
    """The contacts of a scene whose forces a motion carries, in columns or beside it in a bag.

    Forces of compliant contacts follow from positions and velocities, unless they have bristles:
    these become known contacts, and leave the scene.

    Args:
        scene: The scene.
        source: Where the motion comes from.
        topic: Of its joint states in a bag; those of constraint forces are beside it.
        say: Is told which columns are missing.

    Raises:
        DataError: Some columns of a contact are there and others are not, or none of one with
            bristles; names these.
    """
    known, bristly = [], []
    for part, names in _rigid(scene):
        forces, stamps = _forces(source, names), None
        if forces is None:
            forces, stamps = _in_bag(source, topic, names)
        if forces is None:
            say(_unknown(scene, source, part, names))
        else:
            known.append(KnownContact(part.name, forces, stamps, part.wrenches))
    for load in scene.forces:
        shown = getattr(load, "contact", None)
        if shown is not None and load.internal:
            names = [label(load, name) for name in shown.names]
            forces = _forces(source, names)
            if forces is None:
                raise DataError(
                    f"{name_of(source)}: no column {listed(names)}: contact {load.name} has "
                    "bristles, which a motion does not show; simulate writes these columns"
                )
            bristly.append(load)
            known.append(KnownContact(load.name, forces, None, shown.exerted))
    if bristly:
        kept = [part for part in scene.parts["contacts"] if part not in bristly]
        scene = scene.holding(contacts=kept)
    return scene, known


def forces_at(known: KnownContact, motion: Motion, stamps: NDArray[np.int64]) -> Array:
    """Forces of a contact in its contact frames at some stamps [N], shape (n, m).

    Raises:
        DataError: A bag has no force of the contact at one of them.
    """
    of_forces = motion.stamps if known.stamps is None else known.stamps
    return known.forces[_rows(known.name, of_forces, stamps)]


def contact_loads(
    scene: Scene, known: Sequence[KnownContact], motion: Motion, samples: Observations
) -> tuple[dict[str, MeasuredWrench], list[Array]]:
    """Known contacts as external loads of links.

    Args:
        scene: The scene.
        known: The contacts.
        motion: As it was read, a row of forces each.
        samples: Those of it that are solved for.

    Returns:
        Loads by names of their own, and their values at the samples, shape (n, 6) each.

    Raises:
        DataError: A bag has no force of a contact at the stamp of a sample.
    """
    stamps = samples.stamps
    states = [_state(scene, sample) for sample in samples.each()]
    robot, k = scene.robot, Kinematics(scene.robot)
    values: dict[tuple[str, str], list[Array]] = {}
    for one in known:
        for x, lam in zip(states, forces_at(one, motion, stamps), strict=True):
            k.refresh(x.q, x.v, Reads.POSITION)
            for wrench in one.exert(k, x, lam):
                if robot.carrier(wrench.frame).moves:
                    rows = values.setdefault((one.name, wrench.frame), [])
                    rows.append(in_link(k, robot, wrench))
    loads = {}
    for name, frame in values:
        load = MeasuredWrench(robot, frame=frame)
        load.name = f"{name}_on_{frame}"
        loads[load.name] = load
    return loads, [np.array(rows) for rows in values.values()]


def _rigid(scene: Scene) -> Iterator[tuple[Constraint, list[str]]]:
    """Rigid contacts and the columns of their multipliers."""
    names, end = [row.name for row in labelled(scene.constraints)], 0
    for part in scene.constraints:
        begin, end = end, end + len(part.rows)
        if part.law.kind is Kind.CONE:
            yield part, names[begin:end]


def _forces(source: Source, names: list[str]) -> Array | None:
    """Columns of a contact, shape (n, m); None where there is none of them."""
    columns = read_columns(source, names)
    if columns is None:
        return None
    lacking = [name for name, bad in zip(names, np.isnan(columns).any(axis=0), strict=True) if bad]
    if lacking:
        raise DataError(
            f"{name_of(source)}: no column {listed(lacking)}, or it has gaps; accepted: all "
            f"forces of a contact, or none: {listed(names)}"
        )
    return columns


def _in_bag(
    source: Source, topic: str, names: list[str]
) -> tuple[Array | None, NDArray[np.int64] | None]:
    """Forces and stamps of a contact on a topic of constraint forces; None without any."""
    if isinstance(source, Result) or not is_bag(source):
        return None, None
    beside = topic.rpartition("/")[0]
    for place in ("", "/simulator"):
        with suppress(DataError):  # there is no such topic, or it has no such rows
            found = read_motion(
                source, names, topic=f"{beside}{place}/constraint_forces", required=()
            )
            effort = found.motion.effort
            if effort is not None and np.isfinite(effort).all():
                return effort, found.motion.stamps
    return None, None


def _rows(name: str, known: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows of known stamps at those of samples."""
    rows = np.minimum(np.searchsorted(known, stamps), len(known) - 1)
    lacking = np.flatnonzero(known[rows] != stamps)
    if len(lacking):
        t = int(stamps[lacking[0]]) * NANOSECOND
        raise DataError(f"no force of contact {name} at t = {t:.9g} s, where there is a motion")
    return rows


def _unknown(scene: Scene, source: Source, part: Constraint, names: Sequence[str]) -> str:
    given = f"; the loads {', '.join(scene.wrenches)} act" if scene.wrenches else ""
    return (
        f"warning: {name_of(source)}: no column {listed(names)}: the forces of contact "
        f"{part.name} are not known, 0 is taken{given}; simulate writes these columns, and "
        "external_wrenches of the scene take measured forces by --wrenches, and --stance "
        "makes unknowns of them"
    )


def _state(scene: Scene, sample: Observation) -> State:
    """State of all joints of a sample."""
    robot, couplings = scene.robot, scene.couplings
    q, v, a = robot.neutral().copy(), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
    q[couplings.q_index], v[couplings.v_index] = sample.position, sample.velocity
    couplings.expand(q, v, a)
    return State(sample.stamp * NANOSECOND, q, v)


# ---- double support ---------------------------------------------------------------------------
# How the load passes from one foot to the other while both are on the ground.
#
# Over a double support of length T the trailing foot keeps these shares of the force that it had:
#
#     along the way     k1 exp(-(2 (t - T / 3) / T)^2) - 2 k2 t / T
#     across and up     exp(-(2 t / T)^3),        k1 = e^(4/9), k2 = e^(-4/3) / 2
#
# Source: L. Ren, R. K. Jones, D. Howard, J. Biomechanics 41 (2008) 2750,
# doi:10.1016/j.jbiomech.2008.06.001, for the forces of walking persons.


_INSIDE = 0.9  # of the friction that a normal force bears: the corners of a foot differ
_AHEAD = math.exp(4.0 / 9.0), math.exp(-4.0 / 3.0) / 2.0


class DoubleSupport(NamedTuple):
    """Samples with more than one foot on the ground, after one with one.

    Attributes:
        before: Sample of the single support before.
        samples: Those of the double support.
        foot: The trailing foot, which stood alone.
        end: Time of the end [s]: of the first sample after it, or of the last one of all.
    """

    before: int
    samples: range
    foot: int
    end: float


def double_supports(times: Array, feet: NDArray[np.bool_]) -> Iterator[DoubleSupport]:
    """Double supports of a motion whose beginning is in it.

    Args:
        times: Of samples [s], shape (n,).
        feet: Which feet stand, shape (n, feet).
    """
    several = feet.sum(axis=1) > 1
    starts = np.flatnonzero(several[1:] & ~several[:-1]) + 1
    for start in starts.tolist():
        before = start - 1
        if not feet[before].any():
            continue  # a flight before it leaves open which foot was first
        foot, after = int(np.argmax(feet[before])), np.flatnonzero(~several[start:])
        end = start + int(after[0]) if len(after) else len(times)
        last = float(times[min(end, len(times) - 1)])
        yield DoubleSupport(before, range(start, end), foot, last)


def kept_force(force: Array, way: Array, share: float) -> Array:
    """The force of the trailing foot after a share of the double support.

    Args:
        force: What it was at the beginning [N], shape (3,).
        way: Direction of walking, of length 1, shape (3,).
        share: t / T, 0 .. 1.

    Returns:
        Shape (3,), in the axes of `force`.
    """
    k1, k2 = _AHEAD
    along = k1 * math.exp(-((2.0 * (share - 1.0 / 3.0)) ** 2)) - 2.0 * k2 * share
    across = math.exp(-((2.0 * share) ** 3))
    ahead = way.dot(force) * way
    kept: Array = along * ahead + across * (force - ahead)
    return kept


def possible_force(kept: Array, total: Array, normal: Array, mu: float) -> Array:
    """The kept force, so that the rest of the total is one that the ground can exert.

    Args:
        kept: On the trailing foot [N], shape (3,).
        total: On all feet, shape (3,).
        normal: Of the ground below the others, of length 1, shape (3,).
        mu: Coefficient of friction there.
    """
    rest = total - kept
    push = max(float(normal.dot(rest)), 0.0)
    along = rest - normal.dot(rest) * normal
    most, length = _INSIDE * mu * push, float(np.linalg.norm(along))
    if length > most:
        along *= most / length
    possible: Array = total - push * normal - along
    return possible


def direction_of_way(places: Sequence[Array], gravity: Array) -> Array:
    """Level direction from the first to the last place, shape (3,); 0 where nothing moves."""
    up = -gravity / (float(np.linalg.norm(gravity)) or 1.0)
    step = places[-1] - places[0]
    level = step - up.dot(step) * up
    length = float(np.linalg.norm(level))
    return level / length if length > 0.0 else np.zeros(3)


# ---- transition -------------------------------------------------------------------------------
# Double supports of a motion in which the load passes smoothly from foot to foot.


Solve = Callable[[int, Wish | None], Torques]


def smooth_transitions(
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    standing: UnknownsMask,
    solved: list[Torques],
    solve: Solve,
) -> str:
    """Solve double supports again, so that the load passes on smoothly.

    Args:
        inverse: The solver.
        states: Motion and accelerations.
        standing: Which features stand, shape (n, features).
        solved: Results, some of which are replaced.
        solve: Number of a sample and a wish -> its result.

    Returns:
        How many there are, in words.
    """
    transition = _Transition(inverse, states, standing, solved)
    refused = 0
    for support in transition.supports:
        for i, wish in transition.wishes(support):
            try:
                solved[i] = solve(i, wish)
            except SolveError:
                refused += 1
    passed = f"smooth transition in {len(transition.supports)} double supports"
    return passed + (f", without {refused} samples where cones forbid it" if refused else "")


class _Transition:
    """Double supports of a motion that was solved with the least efforts.

    Args:
        inverse: The solver.
        states: Motion and accelerations.
        standing: Which features stand, shape (n, features).
        solved: Their results.

    Attributes:
        supports: Those that begin in the motion.
    """

    def __init__(
        self,
        inverse: ClosedLoopInverseDynamics,
        states: Sequence[tuple[State, Array]],
        standing: UnknownsMask,
        solved: Sequence[Torques],
    ) -> None:
        assert inverse.standing is not None
        self._feet, self._model = inverse.standing, inverse.robot.model
        self._states, self._standing = states, standing
        cones = inverse.constraints.cones
        slots = np.concatenate([np.r_[cone.slots] for cone in cones])
        self._forces = [each.multipliers[slots] for each in solved]
        self._mu = min(cone.mu for cone in cones)
        self._times = np.array([x.t for x, _ in states])
        stands = np.array([self._feet.standing_feet(row) for row in standing])
        self.supports = list(double_supports(self._times, stands))

    def wishes(self, support: DoubleSupport) -> Iterator[tuple[int, Wish]]:
        """The force of the trailing foot in each sample of a double support."""
        (before, samples, foot, end), times = support, self._times
        at_first = self._feet.forces(self._states[before][0])[foot].dot(self._forces[before])
        data, ends = pin.Data(self._model), (before, samples[-1])
        centres = [pin.centerOfMass(self._model, data, self._states[i][0].q).copy() for i in ends]
        way = direction_of_way(centres, self._model.gravity.linear)
        for i in samples:
            share = float((times[i] - times[before]) / (end - times[before]))
            forces = self._feet.forces(self._states[i][0])
            total = forces.sum(axis=0).dot(self._forces[i])
            others = np.delete(forces, foot, axis=0).sum(axis=0)[:, ::3]
            normal = others.dot(self._standing[i])
            normal /= np.linalg.norm(normal)
            kept = kept_force(at_first, way, min(share, 1.0))
            yield i, Wish(forces[foot], possible_force(kept, total, normal, self._mu))


# ---- stance option ----------------------------------------------------------------------------
# What is asked of feet on the ground that no force plate measured.


def stance_of(method: str | None, gap: float | None, speed: float | None) -> "StanceTask | None":
    """What is asked of feet on the ground; None for nothing.

    Raises:
        DataError: Names the option and what is accepted.
    """
    if method is gap is speed is None:
        return None

    return stance_task(method, gap, speed)
