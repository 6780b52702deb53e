"""Muscles -> the section `muscles`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from mbd_ros.scene.models.imported_model import Unexpressed
from mbd_ros.scene.models.osim.item import Item

_STEEPEST = math.acos(0.1)  # rad, pennation of the shortest fibre
_LEAST = 1.0e-6  # activation that muscles of a scene may have
_LENGTHS = (
    "min_norm_active_fiber_length",
    "transition_norm_fiber_length",
    "max_norm_active_fiber_length",
)
_CURVES = {
    "ActiveForceLengthCurve": {"active_slope": "shallow_ascending_slope"},
    "FiberForceLengthCurve": {
        "passive_zero_strain": "strain_at_zero_force",
        "passive_strain": "strain_at_one_norm_force",
        "passive_low_stiffness": "stiffness_at_low_force",
        "passive_stiffness": "stiffness_at_one_norm_force",
        "passive_curviness": "curviness",
    },
    "TendonForceLengthCurve": {
        "tendon_strain": "strain_at_one_norm_force",
        "tendon_stiffness": "stiffness_at_one_norm_force",
        "tendon_toe_force": "norm_force_at_toe_end",
        "tendon_curviness": "curviness",
    },
    "ForceVelocityCurve": {
        "shortening_slope": "concentric_slope_near_vmax",
        "isometric_slope": "isometric_slope",
        "lengthening_slope": "eccentric_slope_near_vmax",
        "lengthening_force": "max_eccentric_velocity_force_multiplier",
        "shortening_curviness": "concentric_curviness",
        "lengthening_curviness": "eccentric_curviness",
    },
}


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


def _thelen(item: Item) -> dict[str, Any]:
    """OpenSim gives Thelen's muscle an elastic tendon, whatever the file says."""
    return {
        "type": "thelen",
        **_times(item, 0.015, 0.05),
        "minimum_activation": _least(item),
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
    """Without fibre damping OpenSim keeps the file's least force and end slopes: not expressed."""
    damps = item.flag("use_fiber_damping", default=True)
    return {
        "type": "millard",
        **_times(item, 0.01, 0.04),
        "minimum_activation": _least(item),
        "maximum_pennation_angle": item.number("maximum_pennation_angle", default=_STEEPEST),
        "tendon": _tendon(item),
        "damping": item.number("fiber_damping", default=0.1) if damps else 0.0,
        **_curves(item),
    }


def _degroote_fregly(item: Item) -> dict[str, Any]:
    if item.flag("ignore_passive_fiber_force"):
        raise Unexpressed("a fibre without passive force")
    return {
        "type": "degroote_fregly",
        **_times(item, 0.015, 0.06),
        "tendon": _tendon(item),
        "active_width": item.number("active_force_width_scale", default=1.0),
        "passive_strain": item.number("passive_fiber_strain_at_one_norm_force", default=0.6),
        "tendon_strain": item.number("tendon_strain_at_one_norm_force", default=0.049),
        "damping": item.number("fiber_damping", default=0.0),
        "activation_steepness": item.number("activation_dynamics_smoothing", default=0.1),
    }


def _times(item: Item, rise: float, fall: float) -> dict[str, float]:
    return {
        "activation_time": item.number("activation_time_constant", default=rise),
        "deactivation_time": item.number("deactivation_time_constant", default=fall),
    }


def _tendon(item: Item) -> str:
    return "rigid" if item.flag("ignore_tendon_compliance") else "elastic"


def _least(item: Item) -> float:
    """Least activation; files that say 0 mean next to none."""
    return max(item.number("minimum_activation", default=0.01), _LEAST)


def _curves(item: Item) -> dict[str, Any]:
    """Numbers of the curves that the file gives."""
    entry: dict[str, Any] = {}
    for tag, keys in _CURVES.items():
        curve = item.find(tag)
        found = {} if curve is None else {key: curve.numbers(one) for key, one in keys.items()}
        entry |= {key: numbers[0] for key, numbers in found.items() if len(numbers) == 1}
    curve = item.find("ActiveForceLengthCurve")
    if curve is not None:
        pairs = zip(_LENGTHS, (0.4441, 0.73, 1.8123), strict=True)
        entry["active_lengths"] = [curve.number(tag, default=value) for tag, value in pairs]
    return entry


_TYPES: Mapping[str, Callable[[Item], dict[str, Any]]] = {
    "Thelen2003Muscle": _thelen,
    "Millard2012EquilibriumMuscle": _millard,
    "DeGrooteFregly2016Muscle": _degroote_fregly,
}
