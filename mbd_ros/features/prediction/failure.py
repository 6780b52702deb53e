"""Why a motion was not found: what is violated and where, which bounds block."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from mbd_ros.features.prediction.solving import SAVED, STOPPED, Found, accepted_passing
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.optimal_control.defects import CLOSING
from mbd_ros.optimal_control.motion_phase import END, START

_SHOWN = 5
_CAUSES = (CLOSING, START, END)  # blocks of rows that a task or a mechanism asks for
_VIOLATED = 1.0e-6  # in usual sizes
_SPREAD = 1.0e8  # of usual sizes that look odd
_ACCEPTED = "more refinements or intervals in mesh, or a larger tolerance"
_LOCAL = "Infeasible_Problem_Detected"
_WORDS = {
    _LOCAL: "the conditions cannot hold together",
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
    if solved.is_good and found.is_interrupted:
        yield f"{where}no motion found: it was interrupted between two meshes"
        return
    if solved.is_good:
        after = f"after {task.mesh.refinements} refinements"
        yield f"{where}{'; '.join(_not_fine(found, task))} {after}; accepted: {_ACCEPTED}"
        return
    yield f"{where}no motion found: {_WORDS.get(solved.status, solved.status)}"
    yield from violated(found)
    yield from blocking(found)
    yield from odd_sizes(found)
    yield from kinks(found)
    if solved.status == _LOCAL and task.starts == 1:
        yield "  none is near this guess: another guess, or several starts, may lead further"


def _not_fine(found: Found, task: PredictTask) -> Iterator[str]:
    """What is wrong between the nodes of a mesh whose program is solved."""
    if found.worst > task.tolerance:
        yield f"error between nodes {found.worst:.2g} is above the tolerance {task.tolerance:g}"
    if found.passings and (found.worst <= task.tolerance or found.passings[0].severity > 1.0):
        one = found.passings[0]
        saved = sum(each.saved for each in found.passings)
        yield (
            f"{one.name} passes its {'upper' if one.side > 0 else 'lower'} bound {one.bound:g} "
            f"by {one.by:.2g} between nodes at t = {one.time:.3g} s: {one.relative:.2g} of its "
            f"size, where {accepted_passing(task):.2g} is accepted, and passed bounds save "
            f"{saved:.2g} of the cost, where {SAVED * task.tolerance:.2g} is accepted,"
        )


def violated(found: Found) -> Iterator[str]:
    """Rows that do not hold, the worst of each kind: what, by how much, when.

    Closures of loops and conditions at ends come first: equations of motion that do not hold
    between them are mostly a consequence.
    """
    program, solved, number = found.solution.program, found.solution.solved, -1
    worst = dict[str, tuple[bool, float, str]]()
    for block, rows in zip(program.blocks, program.slices, strict=True):
        number += block.name == "motion"
        if not block.form.rows:
            continue
        values = solved.rows[rows].reshape(block.count, block.form.rows).T
        off = np.maximum(block.lower - values, values - block.upper)
        relative = np.maximum(off, 0.0) / block.size
        for i in range(block.form.rows):
            j = int(relative[i].argmax())
            if relative[i, j] > _VIOLATED:
                text = _row(found, number, block, i, j)
                line = f"  violated: {text}, by {off[i, j]:.3g} ({relative[i, j]:.1e} of its size)"
                row = (block.name in _CAUSES, float(relative[i, j]), line)
                worst[text] = max(worst.get(text, row), row)
    for *_, line in sorted(worst.values(), reverse=True)[:_SHOWN]:
        yield line


def _row(found: Found, number: int, block: Any, row: int, place: int) -> str:
    """What a row is, and when."""
    phase = found.problem.program.phases[max(number, 0)]
    motion = found.solution.motions[max(number, 0)]
    if block.name == "collocation":
        at = int(block.places[0, place])
        return f"continuity of {_unknown(found, at)}"
    if block.name == "bodies":
        return "continuity of the pose of a free body"
    name = phase.row_name(block.name, row)
    if block.name in ("start", "end"):
        return f"{name} at the {block.name}"
    if block.data.size and block.data.shape[0] >= 1 and block.name in ("motion", "bounds"):
        t = motion.begin + motion.duration * float(block.data[0, place])
        return f"{name} at t = {t:.3g} s"
    return name or block.name


def _unknown(found: Found, at: int) -> str:
    pairs = zip(found.problem.program.phases, found.solution.unknowns, strict=True)
    for phase, unknowns in pairs:
        for letter, places in unknowns.nodes.items():
            hit = np.argwhere(places == at)
            if len(hit):
                motion_share = float(unknowns.mesh.knots[hit[0, 0]])
                name = phase.quantities.name_of(letter, int(hit[0, 1]))
                return f"{name} after {100 * motion_share:.0f} % of the phase"
    return "the state"


def blocking(found: Found) -> Iterator[str]:
    """Bounds that are active, most of the time first."""
    for name, side, share, value in active(found)[:_SHOWN]:
        word = "upper" if side > 0 else "lower"
        yield f"  blocks: {name} is at its {word} bound {value:g} at {100 * share:.0f} % of points"


def active(found: Found) -> list[Any]:
    """Bounds that are active, most of the time first."""
    from mbd_ros.optimal_control.active_bounds import active_bounds

    every = [
        one
        for i, phase in enumerate(found.problem.program.phases)
        for one in active_bounds(phase, i, found.solution)
    ]
    return sorted(every, key=lambda one: -one.share)


def odd_sizes(found: Found) -> Iterator[str]:
    """Unknowns whose usual sizes are so far apart that rounding may stop the solver."""
    sizes = found.solution.program.sizes[found.solution.program.open]
    if sizes.max(initial=1.0) / sizes.min(initial=1.0) > _SPREAD:
        yield (
            f"  sizes of unknowns lie between {sizes.min():.1e} and {sizes.max():.1e}: other "
            "units, or a guess nearer to the motion, may help"
        )


def kinks(found: Found) -> Iterator[str]:
    """Goals that are nearly kinks where powers change their signs."""
    for phase in found.problem.program.phases:
        for goal in phase.problem.goals:
            if goal.kind == "power":
                yield (
                    f"  goal {goal.name} bends within {goal.options['smoothing']:g} W: a larger "
                    "smoothing, or a goal effort beside it, is easier"
                )
