"""Results of `mbd-ros loads` in files: tables, and meshes with their loads."""

from pathlib import Path

from mbd_ros.errors import DataError
from mbd_ros.features.loads.fem.units import units_of
from mbd_ros.features.loads.job import LoadsTask, run_loads
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene

MESHED = ".inp", ".feb", ".vtu"


def loads_to(scene: Scene, task: LoadsTask, out: Path, say: Say) -> None:
    """Read a motion, write the loads on a body.

    Args:
        scene: The scene.
        task: What is asked for.
        out: Its suffix chooses the format.
        say: Is told what was done and left out, a line each.

    Raises:
        MbdError: As `loads`, or a place that cannot be written to.
    """
    motion = task.motion
    sources = motion.motion, motion.wrenches, motion.external, task.muscle_forces
    refuse_overwriting(out, *(source for source in sources if isinstance(source, Path)))
    if out.suffix in MESHED:
        _finite_elements(scene, task, out, say)
        return
    if task.mesh is not None:
        raise DataError(f"{out}: --mesh goes with {', '.join(MESHED)}")
    check_place(out)
    result, _, _ = run_loads(scene, task, say)
    result.to(out)
    say(f"{result[MAIN].rows} samples of loads on {task.body} -> {out}")


def _finite_elements(scene: Scene, task: LoadsTask, out: Path, say: Say) -> None:
    """Write a mesh with its loads."""
    from mbd_ros.features.loads.fem.finite_elements import body_of, write_body  # for meshes only

    if task.mesh is None:
        raise DataError(f"{out}: --mesh is needed, the solid that takes the loads")
    if not out.parent.is_dir():
        raise DataError(f"{out}: directory {out.parent} does not exist")
    _, history, instants = run_loads(scene, task, say)
    body, steps, text = body_of(history, instants, task.mesh, units_of(task.units))
    say(text)
    write_body(body, steps, out, say, task.mesh.amplitudes)
