"""Where chains stand, as a .npz: from there a run goes on with the same bits."""

from collections.abc import Sequence
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from mbd_ros.errors import DataError
from mbd_ros.features.sampling.chains import Checkpoint
from mbd_ros.files.replacing import replacing

_KEYS = ("q", "v", "sweeps", "dt")


def write_checkpoint(path: Path, blocks: Sequence[Checkpoint]) -> None:
    """Write where all blocks of a run stand.

    Raises:
        DataError: A place that cannot be written to.
    """
    arrays = {
        f"{key}{i}": np.asarray(value)
        for i, block in enumerate(blocks)
        for key, value in zip(_KEYS, block, strict=True)
    }
    with replacing(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_checkpoint(path: Path, sizes: Sequence[tuple[int, int]]) -> list[Checkpoint]:
    """Where all blocks of a run stand.

    Args:
        path: The file.
        sizes: Coordinates and chains of each block of the run that goes on.

    Raises:
        DataError: It cannot be read, or is that of another scene or another number of chains.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {key: file[key] for key in file.files}
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise DataError(f"{path}: is no checkpoint of sample ({error})") from error
    blocks = []
    for i, size in enumerate(sizes):
        if any(f"{key}{i}" not in found for key in _KEYS):
            raise DataError(f"{path}: has no block {i + 1} of {len(sizes)}: another run's")
        q, v, sweeps, dt = (found[f"{key}{i}"] for key in _KEYS)
        if q.shape != size or v.shape != size:
            raise DataError(
                f"{path}: {q.shape[0]} coordinates of {q.shape[-1]} chains, this run has "
                f"{size[0]} of {size[1]}"
            )
        if not (np.isfinite(q).all() and np.isfinite(v).all() and float(dt) > 0.0):
            raise DataError(f"{path}: holds numbers that are not finite")
        blocks.append(Checkpoint(q.astype(float), v.astype(float), int(sweeps), float(dt)))
    if len(found) != len(_KEYS) * len(sizes):
        raise DataError(f"{path}: is of a run with more chains")
    return blocks
