"""The search for the gaits of a scene."""

from collections.abc import Sequence
from typing import NamedTuple

from mbd_ros.core.sensitivities.flow import Segment
from mbd_ros.core.sensitivities.travel import Travel
from mbd_ros.core.state import State
from mbd_ros.errors import FallError, MbdError, SolveError
from mbd_ros.features.gait.flows import SceneFamily, travel_for
from mbd_ros.features.gait.periodic import PeriodicMotion, periodic_motion
from mbd_ros.features.gait.return_map import ReturnMap
from mbd_ros.features.gait.starts import distinct, guesses
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.progress import progress

_SAME = 1.0e-7  # of the state: two searches that ended in one gait


class Gait(NamedTuple):
    """A periodic motion of a scene.

    Attributes:
        motion: The motion.
        section: Segment that ends with the event of the section.
        travel: Along which it moves on.
    """

    motion: PeriodicMotion
    section: Segment
    travel: Travel


def found_gaits(family: SceneFamily, say: Say) -> list[Gait]:
    """The gaits to which the guesses of a task lead, each once.

    Raises:
        FallError: No guess comes to the end of a cycle.
        SolveError: No guess leads to a periodic motion.
    """
    scene, task, flow = family.scene, family.task, family.flow()
    starts = list(guesses(scene, task, flow))
    found: list[Gait] = []
    failures: list[MbdError] = []
    for x in progress(starts, len(starts), "gait"):
        try:
            found.append(_gait(family, x, found))
        except (FallError, SolveError) as error:
            failures.append(error)
    if failures and len(starts) > 1:
        say(f"{len(failures)} of {len(starts)} guesses lead to no gait")
    if not found:
        raise _none(family, failures)
    origin = found[0].motion.passage.begin
    states = [one.travel.back(flow, one.motion.passage.begin, origin) for one in found]
    return [found[i] for i in distinct(states, flow, _SAME)]


def _gait(family: SceneFamily, x: State, others: Sequence[Gait]) -> Gait:
    flow = family.flow()
    segments = flow.cycle(x)
    for _ in range(family.task.cycles - 1):
        segments = flow.cycle(segments[-1].after)
    travel = others[0].travel if others else travel_for(flow, segments, family.task)
    section = segments[-1]
    way = ReturnMap(flow, section, travel, family.task.cycles)
    return Gait(periodic_motion(way, section.end), section, travel)


def _none(family: SceneFamily, failures: Sequence[MbdError]) -> MbdError:
    """Why there is none, with what can be done."""
    first = failures[0] if failures else SolveError("no guess can be placed")
    where = family.task.source or family.scene.name
    if isinstance(first, FallError):
        return FallError(
            f"{where}: from the guess not one cycle can be followed: {first}; accepted: another "
            "guess in guesses, a grid of them in search, a longer longest"
        )
    return SolveError(
        f"{where}: {first}; accepted: another guess in guesses, or a grid of them in search"
    )
