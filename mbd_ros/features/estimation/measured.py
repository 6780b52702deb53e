"""What a recording says: numbers of sensors, and inputs."""

import numpy as np

from mbd_ros.core.contracts.sensor import Sensor
from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.features.estimation.estimation import EFFORTS, Estimation
from mbd_ros.features.estimation.unknowns import inner
from mbd_ros.jobs.lines import Say
from mbd_ros.motion.recordings import Source, name_of, read_columns
from mbd_ros.motion.wrenches import read_loads, refuse_unused, wrench_at
from mbd_ros.parts.sensors.effort import Effort
from mbd_ros.parts.sensors.encoder import Encoder
from mbd_ros.parts.sensors.tachometer import Tachometer


def measured_values(estimation: Estimation, source: Source, motion: Motion) -> Array:
    """What was measured, NaN where nothing was, shape (samples, m).

    Args:
        estimation: Of the scene.
        source: The recording; columns `<sensor>` or `<sensor>.<component>`.
        motion: Its joints.

    Raises:
        DataError: Nothing of any sensor is in it.
    """
    sensors = estimation.process.sensors
    found = np.full((len(motion.stamps), sensors.m), np.nan)
    column = {name: i for i, name in enumerate(motion.names)}
    for sensor, mine in zip(sensors.sensors, sensors.slices, strict=True):
        own = _of_joints(inner(sensor), motion)
        if own is not None:
            found[:, mine.start] = own[:, column[inner(sensor).frame]]  # type: ignore[attr-defined]
            continue
        read = read_columns(source, sensors.names[mine])
        if read is not None and len(read) == len(found):
            found[:, mine] = read
    if not np.isfinite(found).any():
        raise DataError(f"{name_of(source)}: nothing of {', '.join(sensors.names)} is in it")
    return found


def _of_joints(sensor: Sensor, motion: Motion) -> Array | None:
    """The quantity of all joints that a sensor measures at one of them; None for other sensors."""
    if isinstance(sensor, Encoder):
        return motion.position
    if isinstance(sensor, Tachometer):
        return motion.velocity
    return motion.effort if isinstance(sensor, Effort) else None


def recorded_inputs(
    estimation: Estimation, motion: Motion, wrenches: Source | None, say: Say
) -> list[Array | None]:
    """Inputs before each sample: its efforts and commands act in the interval that ends there.

    The effort of a joint with a sensor of type `effort` is measured, and no input.

    Args:
        estimation: Of the scene.
        motion: The recording.
        wrenches: External loads; None where none are known.
        say: Is told what is lacking.

    Raises:
        DataError: Wrenches that do not fit scene and motion.
    """
    refuse_unused(estimation.scene, wrenches)
    u = _of_drives(estimation, motion, say)
    loads = estimation.scene.wrenches
    if not loads:
        return [None] * len(motion.stamps) if u is None else list(u)
    if wrenches is None:
        say(f"unloaded: {', '.join(loads)}; --wrenches FILE brings their values")
        return [None] * len(motion.stamps) if u is None else list(u)
    if u is None:
        u = np.tile(estimation.scene.inputs.safe, (len(motion.stamps), 1))
    samples, _ = read_loads(estimation.scene, wrenches, wrenches)
    for name, one in samples.items():
        u[:, estimation.scene.inputs.slots[name]] = wrench_at(name, one, motion.stamps)
    return list(u)


def _of_drives(estimation: Estimation, motion: Motion, say: Say) -> Array | None:
    """Inputs by what drives, shape (samples, nu); None where nothing does."""
    scene, task = estimation.scene, estimation.task
    told = motion.effort if task.inputs == "efforts" else motion.command
    if task.inputs == "none":
        return None
    if told is None or not np.isfinite(told).any():
        say(f"no {task.inputs} in the recording: none are assumed")
        return None
    values = np.where(np.isfinite(told), told, 0.0)
    u = np.tile(scene.inputs.safe, (len(values), 1))
    if task.inputs == "efforts":
        felt = {one.frame for one in scene.sensors if isinstance(one, Effort)}
        is_driven = np.array([name not in felt for name in motion.names])
        u[:, scene.inputs.slots[EFFORTS]] = values * is_driven
        return u
    column = {name: i for i, name in enumerate(motion.names)}
    for part in scene.actuators:
        u[:, part.u] = values[:, [column[name] for name in part.joints]]
    return u
