"""A simulation into a file: `mbd-ros simulate`."""

from pathlib import Path

from mbd_ros.errors import INTERRUPTED, DataError
from mbd_ros.files.formats import FOLDER, suffix_of
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, Result
from mbd_ros.jobs.simulate.job import Interrupted, Say, run_simulation
from mbd_ros.jobs.simulate.run import Run, check_stamps
from mbd_ros.scene.built_scene import Scene


def simulate_to(scene: Scene, run: Run, out: Path, say: Say) -> None:
    """Simulate and write the result.

    Args:
        scene: The scene.
        run: The order.
        out: Its suffix chooses the format.
        say: Is called with each line of the summary.

    Raises:
        Interrupted: The simulation ended early, by Ctrl-C too; the states so far are in the file
            of `diverged_place`, named in the message.
        MbdError: Input that cannot be used, or a place that cannot be written to.
    """
    kept = diverged_place(out)
    sources = [source for source in (run.origin, run.efforts, run.wrenches) if source is not None]
    for place in (out, kept):
        refuse_overwriting(place, *(s for s in sources if isinstance(s, Path)))
    check_stamps(scene, run, out)
    check_place(out)
    try:
        result = run_simulation(scene, run, say)
    except Interrupted as early:
        assert early.result is not None
        raise Interrupted(f"{early}; {_kept(kept, early.result)}") from early
    if "ended" in result.metadata:
        stopped = Interrupted(f"{result.metadata['ended']}; {_kept(kept, result)}")
        stopped.exit_code = INTERRUPTED
        raise stopped
    result.to(out)
    say(f"{result[MAIN].rows} states -> {out}")


def diverged_place(out: Path) -> Path:
    """Where a run that ended early is kept: o.csv.gz -> o.diverged.csv.gz, bag -> bag_diverged.

    Raises:
        DataError: No format has the suffix of `out`.
    """
    suffix = suffix_of(out)
    if suffix == FOLDER:
        return out.parent / f"{out.name.replace('.', '_')}_diverged"
    return out.with_name(f"{out.name.removesuffix(suffix)}.diverged{suffix}")


def _kept(place: Path, result: Result) -> str:
    """Write the motion so far; a failure must not hide why the run ended."""
    try:
        result.to(place)
    except DataError as error:
        return f"the states so far are lost: {error}"
    return f"{result[MAIN].rows} states so far are in {place}"
