"""Diagnostics of a control loop."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.control.control_loop import ControlLoop
from mbd_ros.features.control.loop_watch import LoopWatch


def loop_details(loop: ControlLoop, t: float) -> dict[str, str]:
    """Reference, control law and hand-over at a time [s]; efforts in N·m or N, one a joint."""
    control, limits, largest = loop.control, [], 0.0
    if control is not None:
        acts = zip(loop.controller.limit_names, control.active, strict=False)
        limits = [name for name, is_active in acts if is_active]
        largest = float(np.abs(control.s).max())
    return {
        "reference": loop.generator.state(t),
        "largest |s|": f"{largest:.6g}",
        "equivalent part": "none" if control is None else _listed(control.equivalent),
        "chatter": _listed(loop.chatter.rms),
        "share of the safe command": f"{loop.weight:.6g}",
        "limits that act": ", ".join(limits) or "none",
        "safe command": str(loop.safe),
        "times gone safe": str(loop.lapses),
        "updates without an answer of the law": str(loop.failures),
        **loop.controller.details(),
        **(_watched(loop.watch) if loop.watch is not None else {}),
    }


def _watched(watch: LoopWatch) -> dict[str, str]:
    delay, is_known = watch.delay, watch.tolerable < np.inf
    return {
        "loop delay": "not measured" if delay is None else f"{delay:.6g} s",
        "tolerable loop delay": f"{watch.tolerable:.6g} s" if is_known else "not known",
        "error bounds": _listed(watch.promised) if is_known else "not known",
        "times the loop was lost": str(watch.faults),
    }


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.3g}" if np.isfinite(value) else "none" for value in values)
