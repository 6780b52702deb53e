"""Forces of pairs of particles in native code."""

import ctypes
from pathlib import Path

import numpy as np

from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.source import Source
from mbd_ros.core.state import Array
from mbd_ros.methods.particles.pairs import NearPairs, PairModel

_FILE = Path(__file__).parents[1] / "native" / "pairs.c"


class _Model(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("edges", "charges", "powers", "types")),
        ("cutoff", ctypes.c_double),
        *((name, ctypes.c_int) for name in ("n", "kinds", "is_periodic")),
    )


class CompiledKernel:
    """Pair forces like those of `PlainKernel`, in native code.

    Args:
        model: What pairs exert on one another.

    Raises:
        BuildError: It cannot be compiled here.
    """

    def __init__(self, model: PairModel) -> None:
        text = _FILE.read_text(encoding="utf-8")
        self._library = load(Source(text, (), 1, {}, {}))  # keeps what was loaded
        self._add = self._library.c.add_pairs
        self._add.restype = ctypes.c_double
        box = np.zeros(3) if model.box is None else np.ascontiguousarray(model.box)
        types = np.ascontiguousarray(model.types, dtype=np.int32)
        self._arrays = box, model.charges, np.array(model.powers), types
        at = [array.ctypes.data for array in self._arrays]
        sizes = len(types), len(model.sigma), model.box is not None
        self._model = _Model(*at, model.cutoff, *sizes)
        self._address = ctypes.c_void_p(ctypes.addressof(self._model))

    def __call__(self, pairs: NearPairs, x: Array, force: Array) -> float:
        """Adds forces, C-contiguous of shape (n, 3); returns the energy."""
        x = np.ascontiguousarray(x)
        arrays = (pairs.first, pairs.j, x, force)
        at = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
        energy: float = self._add(self._address, *at)
        return energy
