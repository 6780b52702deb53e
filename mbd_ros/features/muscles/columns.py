"""Columns of muscles, reserves and loads of joints, and topics of a bag that hold them."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import Array
from mbd_ros.features.muscles.muscle_frames import Frames
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization
from mbd_ros.features.muscles.task import MusclesTask
from mbd_ros.features.muscles.trial import Shared
from mbd_ros.files.table import Column
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations
from mbd_ros.motion.columns import body_columns, joint_columns

OPTIMUM = "muscles"  # stands before the names of what is said of a whole frame
_AXES = [(kind, axis) for kind in ("force", "moment") for axis in "xyz"]
_UNITS = {"force": "N", "moment": "N·m"}


def share_columns(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> list[Column]:
    """Motion, needed efforts, muscles and reserves.

    Args:
        solver: What shared.
        samples: The motion.
        chunks: Its shares, some frames each.
    """
    muscles, reserves = solver.muscles, solver.reserves
    columns = _motion(solver, samples, chunks)
    frames = [shares.frames for shares in chunks]
    of_muscles = {
        ("activation", ""): together(chunks, "activation"),
        ("force", "N"): together(chunks, "force"),
        ("max_force", "N"): np.concatenate([each.active for each in frames]),
        ("length", "m"): np.concatenate([each.length for each in frames]),
        ("speed", "m/s"): np.concatenate([each.speed for each in frames]),
    }
    for (quantity, unit), values in of_muscles.items():
        pairs = zip(muscles, values.T, strict=True)
        columns += [Column(f"{part.name}.{quantity}", column, unit) for part, column in pairs]
    forces = zip(reserves, together(chunks, "reserve").T, strict=True)
    columns += [Column(f"{part.name}.force", column, part.unit) for part, column in forces]
    unique = [not movable for shares in chunks for movable in shares.movable]
    of_frames = {
        "objective": together(chunks, "objective"),
        "residual": together(chunks, "residual"),
        "null_space": together(chunks, "null_space").astype(np.float64),
        "is_unique": np.array(unique, dtype=np.float64),
        "is_feasible": together(chunks, "is_feasible").astype(np.float64),
    }
    return [*columns, *(Column(f"{OPTIMUM}.{name}", v) for name, v in of_frames.items())]


def _motion(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> list[Column]:
    robot, couplings = solver.robot, solver.known.couplings
    at = IndependentCoordinates(robot, couplings)
    free = [robot.joint(name) for name in couplings.independent]
    z, v, a = samples[1:4]
    columns = joint_columns(free, "position", z[:, at.joint_y])
    columns += joint_columns(free, "velocity", v[:, at.joint_w])
    columns += joint_columns(free, "effort", together(chunks, "needed")[:, at.joint_w])
    columns += joint_columns(free, "lacking", together(chunks, "lacking")[:, at.joint_w])
    bodies = [(z[:, y], v[:, w], a[:, w]) for y, w in zip(at.body_y, at.body_w, strict=True)]
    return [*columns, *body_columns(robot, bodies)]


def together(chunks: Sequence[Shares], field: str) -> Array:
    """A field of all frames."""
    return np.concatenate([getattr(shares, field) for shares in chunks])


def trial_columns(solver: StaticOptimization, shared: Shared) -> list[Column]:
    """Excitations, and lengths of fibres beside elastic tendons."""
    pairs = zip(solver.muscles, shared.excitation.T, strict=True)
    columns = [Column(f"{part.name}.excitation", values) for part, values in pairs]
    lengths = shared.fiber_length.items()
    return [*columns, *(Column(f"{name}.fiber_length", v, "m") for name, v in lengths)]


def load_columns(
    loads: JointLoads,
    asked: MusclesTask,
    muscles: Sequence[Muscle],
    found: Sequence[tuple[Array, Array]],
) -> list[Column]:
    """Loads of joints, a row a frame.

    Args:
        loads: What found them.
        asked: Whose parts are wanted.
        muscles: In the order of the parts.
        found: Of each frame the loads of all, and by muscle.
    """
    total = np.array([each for each, _ in found])
    columns: list[Column] = []
    for row, one in enumerate(loads.joined):
        frame = {"child": one.link, "parent": one.parent_link, "ground": "world"}[loads.side]
        columns += _load(f"{one.link}.load", total[:, row], frame)
        for i, muscle in enumerate(muscles if asked.by_muscle else ()):
            values = np.array([parts[i, row] for _, parts in found])
            columns += _load(f"{one.link}.{muscle.name}", values, frame)
    return columns


def _load(name: str, values: Array, frame: str) -> list[Column]:
    pairs = zip(_AXES, values.T, strict=True)
    return [Column(f"{name}.{kind}_{a}", v, _UNITS[kind], frame) for (kind, a), v in pairs]


def topics(solver: StaticOptimization) -> dict[str, Any]:
    """Topics of a bag, see `files.bags.bag_writer`: the same as those of the node."""
    names = [muscle.name for muscle in solver.muscles]
    fields = {"position": "length", "velocity": "speed", "effort": "force"}
    of_muscles = {f: {n: f"{n}.{quantity}" for n in names} for f, quantity in fields.items()}
    found: dict[str, Any] = {
        "/joint_states": {"position": "position", "velocity": "velocity", "effort": "effort"},
        "/muscle_forces": of_muscles,
        "/activations": {"data": [f"{name}.activation" for name in names]},
    }
    if solver.reserves:
        reserves = {part.name: f"{part.name}.force" for part in solver.reserves}
        found["/reserve_forces"] = {"effort": reserves}
    return found


def joined(chunks: Sequence[Shares]) -> Shares:
    """Shares of all frames."""
    frames = [shares.frames for shares in chunks]
    whole = Frames(*(np.concatenate(each) for each in zip(*frames, strict=True)))
    names = [field.name for field in fields(Shares) if field.name not in ("frames", "movable")]
    movable = tuple(one for shares in chunks for one in shares.movable)
    arrays = {name: together(chunks, name) for name in names}
    return Shares(frames=whole, movable=movable, **arrays)
