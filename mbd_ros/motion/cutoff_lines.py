"""What is said of the low-pass of a motion."""

from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.signals.spectrum import FEWEST_TELLING
from mbd_ros.core.state import Array
from mbd_ros.motion.cutoff import LOWEST

_FEW = 256  # samples in which noise may hide


def cutoff_lines(cutoff: Array, names: Sequence[str], chosen: bool, samples: int) -> Iterator[str]:
    """Lines about the low-pass of each joint.

    Args:
        cutoff: That of the result of `zero_phase`.
        names: Of the joints.
        chosen: Whether the recording asked for it, not the user.
        samples: Number of them.
    """
    source = "from the noise of the recording" if chosen else "as asked for"
    smoothed = np.flatnonzero(np.isfinite(cutoff))
    if smoothed.size:
        low, high = (pick(smoothed, key=cutoff.__getitem__) for pick in (min, max))
        span = f"{cutoff[low]:.3g} Hz"
        if cutoff[high] > cutoff[low]:
            span += f" ({names[low]}) to {cutoff[high]:.3g} Hz ({names[high]})"
        yield f"zero-phase derivatives: low-pass of half power at {span}, {source}"
    lowest = [name for name, f in zip(names, cutoff, strict=True) if chosen and f <= LOWEST]
    if lowest:
        yield (
            f"warning: zero-phase derivatives: {LOWEST:g} Hz is the lowest cut-off that is chosen "
            f"({', '.join(lowest)}); where a recording is short or noisy, motion above it is "
            "lost: compare with --cutoff"
        )
    sharp = [name for name, f in zip(names, cutoff, strict=True) if np.isinf(f)]
    if sharp:
        why = "no noise is found" if chosen else "the sampling rate is too low for that cut-off"
        if chosen and samples < FEWEST_TELLING:
            why = f"{samples} samples are too few to tell noise from motion (--cutoff smooths)"
        elif chosen and samples < _FEW:
            why = f"no noise is found in {samples} samples, few to see it in (--cutoff smooths)"
        warning = "warning: " * (chosen and samples < _FEW)
        yield f"{warning}zero-phase derivatives: not smoothed, since {why}: {', '.join(sharp)}"
