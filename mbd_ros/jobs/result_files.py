"""Results of one and of several motions in files."""

from collections.abc import Callable, Sequence
from pathlib import Path

from mbd_ros.errors import DataError, MbdError
from mbd_ros.files.formats import format_of, suffix_of
from mbd_ros.files.output_file import refuse_overwriting
from mbd_ros.files.table import MAIN, Result
from mbd_ros.jobs.progress import Say
from mbd_ros.jobs.workers.opening import do_all, open_workers, watched
from mbd_ros.jobs.workers.task import Task
from mbd_ros.scene.schema.code_permission import permitting

# ---- result files -----------------------------------------------------------------------------
# Tables of a result in one file, or side by side where a format holds one a file.


def beside(out: Path, table: str) -> Path:
    """Where a table goes whose format holds one a file: o.csv.gz -> o.gaits.csv.gz."""
    suffix = suffix_of(out)
    return out.with_name(f"{out.name.removesuffix(suffix)}.{table}{suffix}")


def write_tables(result: Result, out: Path, say: Say) -> None:
    """Write all tables, `samples` to the given place.

    Args:
        result: The tables.
        out: Its suffix chooses the format.
        say: Is told what went where, a line a file.
    """
    if not format_of(out).one_table:
        result.to(out)
        say(f"{', '.join(result)} -> {out}")
        return
    for name, table in result.tables.items():
        place = out if name == MAIN else beside(out, name)
        Result({MAIN: table}, result.metadata).to(place)
        say(f"{name}, {table.rows} rows -> {place}")


# ---- several motions --------------------------------------------------------------------------
# Several motions of one command: a process and a result each.


Outcome = tuple[list[str], str]


def places(motions: Sequence[Path], folder: Path) -> dict[Path, Path]:
    """Motion -> result of the same name, and so of the same format."""
    taken: dict[Path, Path] = {}
    sources = {motion.resolve() for motion in motions}
    for motion in motions:
        out = folder.resolve() / motion.resolve().name
        if out in taken:
            raise DataError(f"{taken[out]} and {motion} have the same name, results would meet")
        if out in sources:
            raise DataError(f"{motion}: its result would take its place; choose another folder")
        taken[out] = motion
    return {motion: out for out, motion in taken.items()}


def externals_of(files: Sequence[Path], count: int) -> list[Path | None]:
    """External loads of each motion.

    Args:
        files: None, one for all motions, or one for each.
        count: How many motions there are.

    Raises:
        DataError: Another number of files.
    """
    if len(files) not in (0, 1, count):
        raise DataError(
            f"--external names {len(files)} files for {count} motions; accepted: one for all, or "
            "one for each"
        )
    return [*files] if len(files) == count else [files[0] if files else None] * count


def orders_of(
    motions: Sequence[Path], folder: Path, wrenches: Path | None, external: Sequence[Path]
) -> list[tuple[Path, Path, Path | None]]:
    """Each motion with its result in a folder and its external loads.

    Args:
        motions: Of different names.
        folder: Of the results.
        wrenches: Loads of all motions; None without.
        external: As for `externals_of`.

    Raises:
        DataError: Names that would meet, or a result in the place of what is read.
    """
    results = places(motions, folder)
    externals = externals_of(external, len(motions))
    for out in results.values():
        refuse_overwriting(out, wrenches, *externals)
    pairs = zip(results.items(), externals, strict=True)
    return [(motion, out, loads) for (motion, out), loads in pairs]


def do_motions(
    tasks: Sequence[Task], folder: Path, scheduler: str | None, count: int | None, say: Say
) -> None:
    """Do tasks that return an `Outcome` each.

    Args:
        tasks: One a motion, with its name.
        folder: Of the results; made where it is not there.
        scheduler: Of a Dask cluster; None for processes of this machine.
        count: How many processes; None for one a core.
        say: Is told the summary of every motion, as they end.

    Raises:
        DataError: Motions that failed, by name, when the others are done; or a folder that cannot
            be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be made a folder ({error.strerror})") from error
    failed = []
    with open_workers(scheduler, count) as workers:
        for task, result in watched(do_all(workers, tasks), tasks, workers.count):
            lines, error = result.value or ([], result.failure)
            if error:
                failed.append(f"{task.name}: {error.removeprefix(f'{task.name}: ')}")
            else:
                say(f"{task.name}: {'; '.join(lines)}")
    if failed:
        told = "\n  ".join(sorted(failed))
        raise DataError(f"{len(failed)} of {len(tasks)} motions failed:\n  {told}")


def outcome_of(work: Callable[[Say], None], allow_code: bool) -> Outcome:
    """What a worker returns of a motion: its lines, and why it failed.

    Args:
        work: Does the motion and says its lines.
        allow_code: Whether its scene may name code of others.
    """
    lines: list[str] = []
    try:
        with permitting(allow_code):
            work(lines.append)
    except MbdError as error:
        return lines, str(error)
    return lines, ""
