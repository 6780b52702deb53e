"""Why a motion was not found: what is violated, which bounds block."""

from collections.abc import Iterator

import numpy as np

from mbd_ros.jobs.predict.solving import STOPPED, Found
from mbd_ros.scene.predict_task import PredictTask

_SHOWN = 5
_VIOLATED = 1.0e-6  # in usual sizes
_WORDS = {
    "Infeasible_Problem_Detected": "the conditions cannot hold together",
    "Maximum_Iterations_Exceeded": "the largest number of iterations was reached",
    STOPPED: "it was interrupted",
    "Restoration_Failed": "no point nearer to the conditions was found",
    "Invalid_Number_Detected": "the equations gave a value that is not finite",
    "Diverging_Iterates": "the unknowns grow without bound: a goal or a bound is missing",
    "Not_Enough_Degrees_Of_Freedom": "there are more conditions than unknowns",
}


def reasons(found: Found, task: PredictTask) -> Iterator[str]:
    """Why there is no solution, a line each; the first one is the summary."""
    solved = found.solution.solved
    where = f"{task.source}: " if task.source else ""
    if solved.is_good:
        yield (
            f"{where}error between nodes {found.worst:.2g} is above the tolerance "
            f"{task.tolerance:g} after {task.mesh.refinements} refinements; accepted: more "
            "refinements or intervals in mesh, or a larger tolerance"
        )
        return
    yield f"{where}no motion found: {_WORDS.get(solved.status, solved.status)}"
    yield from violated(found)


def violated(found: Found) -> Iterator[str]:
    """Rows that do not hold, the worst ones by name."""
    program, solved = found.solution.program, found.solution.solved
    worst = list[tuple[float, str]]()
    for block, rows in zip(program.blocks, program.slices, strict=True):
        if not block.form.rows:
            continue
        values = solved.rows[rows].reshape(block.count, block.form.rows).T
        off = np.maximum(np.maximum(block.lower - values, values - block.upper), 0.0) / block.size
        i, j = np.unravel_index(int(off.argmax()), off.shape)
        if off[i, j] > _VIOLATED:
            worst.append((float(off[i, j]), f"  violated: {block.name}, by {off[i, j]:.2g}"))
    for _, line in sorted(worst, reverse=True)[:_SHOWN]:
        yield line
