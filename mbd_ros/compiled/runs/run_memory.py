"""What native code remembers of a run, as Python reads and sets it."""

from typing import Any

import numpy as np

from mbd_ros.compiled.build.aligned import aligned
from mbd_ros.compiled.runs.native_source import Sizes
from mbd_ros.compiled.runs.native_types import Field
from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.core.state import NONE, Array, State


class RunMemory:
    """Where a run stands, and all that its later steps depend on.

    Args:
        c: The functions of the library, see `bound`.
        sizes: What it was compiled for.
        form: What turns states into the form that was compiled and back, in which velocities of
            free bodies stand in the axes of the world; None where there is no other.

    Attributes:
        sizes: As given.
        row: Numbers of a sample.
        left: 1 where rows are just being left and rounding does not count, one entry a mode.
    """

    def __init__(self, c: Any, sizes: Sizes, form: InWorldAxes | None = None) -> None:
        self.sizes, self._c, self._form = sizes, c, form
        self._at = place = [c.place_of(field) for field in Field]
        self.row = place[Field.ROW]
        self._numbers = aligned(place[Field.SIZE])
        self._r = self._numbers.ctypes.data
        self._q = self._numbers[place[Field.Q] :][: sizes.nq]
        self._v, self._z, _ = np.split(
            self._numbers[place[Field.W] :], (sizes.nv, sizes.nv + sizes.nz)
        )
        self.left = self._numbers[place[Field.LEFT] :][: sizes.modes]
        self.restart()

    @property
    def t(self) -> float:
        """Time of the state [s]."""
        return float(self._numbers[self._at[Field.T]])

    @property
    def pace(self) -> tuple[float, ...]:
        """As `Stepper.pace`."""
        return tuple(self._numbers[self._at[Field.LENGTH] :][:2].tolist())

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        self._numbers[self._at[Field.LENGTH] :][:2] = pace

    @property
    def inputs(self) -> Array:
        """Those that are held, fresh."""
        return self._numbers[self._at[Field.U] :][: self.sizes.nu].copy()

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return int(self._numbers[self._at[Field.STEPS]])

    @property
    def sample(self) -> int:
        """Number of the newest sample."""
        return int(self._numbers[self._at[Field.SAMPLE]])

    @property
    def is_within(self) -> bool:
        """Whether the last step has samples inside that are still to come."""
        return bool(self._numbers[self._at[Field.IS_WITHIN]])

    @property
    def interval(self) -> int:
        """Rows of held inputs that the last block has left behind."""
        return int(self._numbers[self._at[Field.INTERVAL]])

    @property
    def evaluations(self) -> int:
        """How often accelerations were computed so far."""
        return int(self._numbers[self._at[Field.EVALUATIONS]])

    def state(self) -> State:
        """Where the run stands, fresh."""
        return self._turned_back(self.t, self._q.copy(), self._v.copy(), self._z.copy())

    def restart(self) -> None:
        """Forget everything that was kept from earlier steps."""
        self._c.restart(self._r)

    def load(self, x: State, *, keeps_history: bool = False) -> None:
        """Go on from a state.

        Args:
            x: State of what is integrated.
            keeps_history: Whether it is the last one but for corrections.
        """
        if self._form is not None:
            x = self._form.turned(x)
        self._numbers[self._at[Field.T]] = x.t
        self._q[...], self._v[...] = x.q, x.v
        if self._z.size:
            self._z[...] = x.z
        (self._c.touch if keeps_history else self._c.leave)(self._r)

    def begin_samples(self, sample: int, *, is_within: bool) -> None:
        """Say which sample is the newest, and whether the last step has others inside."""
        self._numbers[self._at[Field.SAMPLE]] = sample
        self._numbers[self._at[Field.IS_WITHIN]] = is_within

    def began(self) -> State:
        """Where the last step began, fresh."""
        nq, nv, nz = self.sizes.nq, self.sizes.nv, self.sizes.nz
        q = self._numbers[self._at[Field.Q0] :][:nq].copy()
        v, z = np.split(self._numbers[self._at[Field.W0] :][: nv + nz].copy(), [nv])
        return self._turned_back(float(self._numbers[self._at[Field.T0]]), q, v, z)

    def memory(self) -> Array:
        """All that later steps and samples depend on, fresh."""
        return self._numbers[: self._at[Field.MEMORY]].copy()

    def recall(self, memory: Array) -> None:
        """Go on as after the step at which a memory was taken."""
        self._numbers[: len(memory)] = memory

    def _turned_back(self, t: float, q: Array, v: Array, z: Array) -> State:
        """A state of the system from numbers of the run, which it keeps."""
        x = State(t, q, v, z if z.size else NONE)
        return x if self._form is None else self._form.turned_back(x)
