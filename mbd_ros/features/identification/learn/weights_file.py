"""The file `weights.npz` with the weights of a learned model, from which training can resume.

Its arrays are checked before use: names, shapes that belong together, finite numbers.
"""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.identification.learn.linear_corrections import SampleStatistics
from mbd_ros.features.identification.learn.task import LearnedModel
from mbd_ros.features.identification.learn.training_samples import CURVES, Scales
from mbd_ros.methods.learned_model import STRUCTURED, About, about_in
from mbd_ros.npz_file import read_arrays

WEIGHTS = "weights.npz"
_WEIGHT, _SCALE, _KNOWN = "weight.", "scale.", "known."
_MOST_MEMBERS = 20


def weights_file(model: LearnedModel) -> bytes:
    """Return the content of the file of a model."""
    arrays = {f"{_WEIGHT}{key}": value for key, value in model.weights.items()}
    arrays |= {f"{_SCALE}{key}": value for key, value in model.scales._asdict().items()}
    arrays |= {f"{_KNOWN}{key}": value for key, value in model.known._asdict().items()}
    arrays |= {"trust": model.trust, "numbers": model.numbers}
    target = io.BytesIO()
    np.savez_compressed(target, about=np.array(model.about.text()), **arrays)
    return target.getvalue()


def read_folder(folder: Path) -> LearnedModel:
    """Read the model in a folder, without running any code from it.

    Raises:
        DataError: The file is no such model, of another version or damaged; the message names
            file and array.
    """
    path = folder / WEIGHTS
    arrays = read_arrays(path, "a file of weights of mbd-ros learn")
    text = arrays.pop("about", np.array(""))
    try:
        about = about_in(str(path), str(text) if text.dtype.kind == "U" else "")
        _check_shapes(arrays, about)
    except ModelError as error:
        raise DataError(str(error)) from error
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
    return LearnedModel(
        about,
        Scales(*(arrays[f"{_SCALE}{key}"] for key in Scales._fields)),
        {k.removeprefix(_WEIGHT): v for k, v in arrays.items() if k.startswith(_WEIGHT)},
        arrays["trust"],
        SampleStatistics(*(arrays[f"{_KNOWN}{key}"] for key in SampleStatistics._fields)),
        arrays["numbers"],
    )


def _check_shapes(arrays: Mapping[str, Array], about: About) -> None:
    """Refuse arrays that do not belong together.

    Raises:
        ValueError: The message names the array, its shape and the accepted one.
    """
    shapes = _shapes(arrays, about)
    if unknown := [key for key in arrays if key not in shapes]:
        raise ValueError(f"array '{unknown[0]}' is unknown; accepted are {', '.join(shapes)}")
    for key, shape in shapes.items():
        if key not in arrays:
            raise ValueError(f"array '{key}' is missing")
        array = arrays[key]
        if array.dtype != np.float64 or array.shape != shape:
            raise ValueError(
                f"array '{key}' has shape {array.shape} of {array.dtype}; accepted is {shape} of "
                "float64"
            )
        if not np.isfinite(array).all():
            raise ValueError(f"array '{key}' has numbers that are not finite")
    sizes = [f"{_SCALE}{key}" for key in Scales._fields if key != "centre"]
    for key in (*sizes, f"{_KNOWN}count", f"{_KNOWN}usual"):
        if not (arrays[key] > 0.0).all():
            raise ValueError(f"array '{key}' has numbers that are not above 0")
    if not ((arrays["trust"] >= 0.0) & (arrays["trust"] <= 1.0)).all():
        raise ValueError("array 'trust' has numbers outside of 0 .. 1")


def _shapes(arrays: Mapping[str, Array], about: About) -> dict[str, tuple[int, ...]]:
    """Return the expected shapes; the file decides the numbers of members and of neurons."""
    m, is_structured = len(about.joints), about.kind == STRUCTURED
    first, second = (np.shape(arrays.get(f"{_WEIGHT}b{i}", ())) for i in (1, 2))
    if len(first) != 2 or len(second) != 2 or not 2 <= first[0] <= _MOST_MEMBERS:
        raise ValueError(
            f"arrays '{_WEIGHT}b1' and '{_WEIGHT}b2' have shapes {first} and {second}; accepted "
            f"are 2 .. {_MOST_MEMBERS} members with their neurons"
        )
    members, p = first[0], int(np.size(arrays.get("numbers", ())))
    layers = (2 * m if is_structured else 3 * m, first[1], second[1])
    layers = (*layers, m * (m + 1) // 2 + 1 if is_structured else m)
    shapes = {}
    for i in (1, 2, 3):
        shapes[f"{_WEIGHT}W{i}"] = (members, layers[i], layers[i - 1])
        shapes[f"{_WEIGHT}b{i}"] = (members, layers[i])
    if is_structured:
        shapes[f"{_WEIGHT}friction"] = (members, m, len(CURVES) + 1)
        shapes[f"{_WEIGHT}offset"] = (members, m)
    shapes |= {f"{_SCALE}{key}": (m,) for key in Scales._fields}
    shapes |= {f"{_KNOWN}triangle": (m, p + 2, p + 2)}
    shapes |= {f"{_KNOWN}count": (m,), f"{_KNOWN}usual": (m,)}
    return shapes | {"trust": (m,), "numbers": (p,)}
