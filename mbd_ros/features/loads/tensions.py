"""Tensions of muscles and other commanded paths, as another job found them."""

from collections.abc import Mapping
from pathlib import Path as File

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.paths.paths import Path
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag, read_result
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.files.times import motion_stamps
from mbd_ros.jobs.lines import Say
from mbd_ros.motion.recordings import Source, name_of
from mbd_ros.scene.built_scene import Scene

_QUANTITIES = "tension", "force"  # as `simulate` and `muscles` call it


def commanded_paths(scene: Scene) -> dict[str, Path]:
    """Paths of muscles and of other parts whose tension a motion does not show."""
    known = {id(part) for part in scene.acting}
    every = (*scene.commanded, *scene.forces)
    return {p.name: p.path for p in every if hasattr(p, "path") and id(p) not in known}


def tensions_at(
    paths: Mapping[str, Path],
    motion: Source,
    given: Source | None,
    stamps: NDArray[np.int64],
    say: Say,
) -> Array:
    """Tensions at the samples of a motion [N], shape (n, paths).

    Args:
        paths: By name of the part that pulls.
        motion: May carry them, in columns `<part>.tension` or `<part>.force`.
        given: Table with such columns, linear between its rows; None for those of the motion.
        stamps: Of the samples [ns], shape (n,).
        say: Is told whose are taken as 0.

    Raises:
        DataError: A table that has none of them, or does not cover the motion.
    """
    found = np.zeros((len(stamps), len(paths)))
    source = motion if given is None else given
    table = _table(source)
    columns = {} if table is None else _columns(table, paths)
    if given is not None and not columns:
        wanted = listed([f"{name}.{quantity}" for name in paths for quantity in _QUANTITIES])
        raise DataError(f"--muscle-forces {name_of(given)}: no column {wanted or 'is asked for'}")
    if table is not None and columns:
        at = motion_stamps(table, name_of(source))
        if not (len(at) and at[0] <= stamps[0] and stamps[-1] <= at[-1]):
            covered = " to ".join(f"{t * NANOSECOND:.6g}" for t in at[[0, -1]])
            asked = " to ".join(f"{t * NANOSECOND:.6g}" for t in stamps[[0, -1]])
            raise DataError(f"{name_of(source)}: tensions at {covered} s do not cover {asked} s")
        since, times = (at - at[0]) * NANOSECOND, (stamps - at[0]) * NANOSECOND
        for i, name in enumerate(paths):
            if name in columns:
                found[:, i] = np.interp(times, since, columns[name])
    if lacking := [name for name in paths if name not in columns]:
        say(f"tensions of {listed(lacking)} are taken as 0; --muscle-forces gives them")
    return found


def _table(source: Source) -> Table | None:
    if isinstance(source, Result):
        return source[MAIN]
    return None if is_bag(source) else read_result(File(source))[MAIN]


def _columns(table: Table, paths: Mapping[str, Path]) -> dict[str, Array]:
    found = {}
    for name in paths:
        for quantity in _QUANTITIES:
            column = f"{name}.{quantity}"
            if name not in found and column in table:
                values = np.asarray(table[column], dtype=np.float64)
                if not np.isfinite(values).all():
                    raise DataError(f"column {column} has gaps")
                found[name] = values
    return found
