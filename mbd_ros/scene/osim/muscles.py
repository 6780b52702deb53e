"""Muscles -> the section `muscles`."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from mbd_ros.scene.osim.item import Item
from mbd_ros.scene.osim.reading import Unexpressed

_STEEPEST = math.acos(0.1)  # rad, pennation of the shortest fibre


def muscle_entry(item: Item) -> dict[str, Any]:
    """A muscle as a scene writes it, but for its path.

    Raises:
        SceneError: Names muscle and element.
        Unexpressed: Its type is not known.
    """
    kind = item.type.removesuffix("_Deprecated")
    if kind not in _TYPES:
        raise Unexpressed(f"muscle {item.type}")
    return _shared(item) | _TYPES[kind](item)


def is_muscle(item: Item) -> bool:
    """Whether an element of the force set is a muscle."""
    return "Muscle" in item.type


def _shared(item: Item) -> dict[str, Any]:
    pennation = item.number("pennation_angle_at_optimal", "pennation_angle", default=0.0)
    return {
        "max_isometric_force": item.number("max_isometric_force", default=1000.0),
        "optimal_fiber_length": item.number("optimal_fiber_length", default=0.1),
        "tendon_slack_length": item.number("tendon_slack_length", default=0.2),
        "pennation_angle": pennation,
        "max_contraction_velocity": item.number("max_contraction_velocity", "Vmax", default=10.0),
    }


def _times(item: Item, rise: float, fall: float) -> dict[str, float]:
    return {
        "activation_time": item.number("activation_time_constant", default=rise),
        "deactivation_time": item.number("deactivation_time_constant", default=fall),
    }


def _tendon(item: Item) -> str:
    return "rigid" if item.flag("ignore_tendon_compliance") else "elastic"


def _thelen(item: Item) -> dict[str, Any]:
    """OpenSim gives Thelen's muscle an elastic tendon, whatever the file says."""
    return {
        "type": "thelen",
        **_times(item, 0.015, 0.05),
        "minimum_activation": item.number("minimum_activation", default=0.01),
        "maximum_pennation_angle": item.number("maximum_pennation_angle", default=_STEEPEST),
        "tendon": "elastic",
        "tendon_strain": item.number("FmaxTendonStrain", default=0.04),
        "passive_strain": item.number("FmaxMuscleStrain", default=0.6),
        "active_shape": item.number("KshapeActive", default=0.45),
        "passive_shape": item.number("KshapePassive", default=5.0),
        "velocity_shape": item.number("Af", default=0.25),
        "lengthening_force": item.number("Flen", default=1.4),
        "fv_extrapolation": item.number("fv_linear_extrap_threshold", default=0.95),
    }


def _millard(item: Item) -> dict[str, Any]:
    return {
        "type": "millard",
        **_times(item, 0.01, 0.04),
        "minimum_activation": item.number("minimum_activation", default=0.01),
        "maximum_pennation_angle": item.number("maximum_pennation_angle", default=_STEEPEST),
        "tendon": _tendon(item),
        "damping": item.number("fiber_damping", default=0.1),
    }


def _degroote_fregly(item: Item) -> dict[str, Any]:
    return {
        "type": "degroote_fregly",
        **_times(item, 0.015, 0.06),
        "tendon": _tendon(item),
    }


_TYPES: Mapping[str, Callable[[Item], dict[str, Any]]] = {
    "Thelen2003Muscle": _thelen,
    "Millard2012EquilibriumMuscle": _millard,
    "DeGrooteFregly2016Muscle": _degroote_fregly,
}
