"""A simulation into files: `mbd-ros simulate`."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from mbd_ros.errors import INTERRUPTED, DataError
from mbd_ros.features.simulation.events import EVENTS
from mbd_ros.features.simulation.job import Interrupted, run_simulation
from mbd_ros.features.simulation.run import Run, check_stamps
from mbd_ros.files.formats import FOLDER, format_of, suffix_of
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, Result
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene


def simulate_to(scene: Scene, run: Run, out: Path, say: Say, events: Path | None = None) -> None:
    """Simulate and write the result.

    Args:
        scene: The scene.
        run: The order.
        out: Its suffix chooses the format.
        say: Is called with each line of the summary.
        events: Where the table of events goes by itself.

    Raises:
        Interrupted: The simulation ended early, by Ctrl-C too; the states so far are in the file
            of `diverged_place`, named in the message.
        MbdError: Input that cannot be used, or a place that cannot be written to.
    """
    places = [out] if events is None else [out, events]
    sources = [source for source in (run.origin, run.efforts, run.wrenches) if source is not None]
    for place in (*places, *map(diverged_place, places)):
        refuse_overwriting(place, *(s for s in sources if isinstance(s, Path)))
    check_stamps(scene, run, out)
    for place in places:
        check_place(place)
    if events is not None:
        _check_events(scene, run, events, out)
    try:
        result = run_simulation(scene, run, say)
    except Interrupted as early:
        assert early.result is not None
        raise Interrupted(f"{early}; {kept(places, early.result)}") from early
    if "ended" in result.metadata:
        stopped = Interrupted(f"{result.metadata['ended']}; {kept(places, result)}")
        stopped.exit_code = INTERRUPTED
        raise stopped
    for text in written(result, out, events):
        say(text)


def diverged_place(out: Path) -> Path:
    """Where a run that ended early is kept: o.csv.gz -> o.diverged.csv.gz, bag -> bag_diverged.

    Raises:
        DataError: No format has the suffix of `out`.
    """
    suffix = suffix_of(out)
    if suffix == FOLDER:
        return out.parent / f"{out.name.replace('.', '_')}_diverged"
    return out.with_name(f"{out.name.removesuffix(suffix)}.diverged{suffix}")


def _check_events(scene: Scene, run: Run, events: Path, out: Path) -> None:
    """Refuse a file of events that cannot be.

    Raises:
        DataError: It is that of the motion, or nothing in the scene has events.
    """
    if events.resolve() == out.resolve():
        raise DataError(f"--events {events}: is -o, choose another name")
    if not scene.simulation(**run.options).guards:
        raise DataError(f"--events: nothing in {scene.name} happens at one time, such as impacts")


def written(result: Result, out: Path, events: Path | None = None) -> Iterator[str]:
    """Write the files; a text for each."""
    result.to(out)
    yield f"{result[MAIN].rows} states -> {out}"
    if events is not None:
        options = {"table": EVENTS} if format_of(events).one_table else {}
        Result({EVENTS: result[EVENTS]}, result.metadata).to(events, **options)
        yield f"{result[EVENTS].rows} events -> {events}"


def kept(places: Sequence[Path], result: Result) -> str:
    """Write the motion so far; a failure must not hide why the run ended."""
    try:
        texts = list(written(result, *map(diverged_place, places)))
    except DataError as error:
        return f"the states so far are lost: {error}"
    return ", ".join(text.replace(" -> ", " so far are in ") for text in texts)
