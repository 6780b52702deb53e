"""The `units` section of a scene of particles."""

from collections.abc import Mapping
from typing import Any

from mbd_ros.core.particles.units import MOLECULAR, REDUCED, SI, UNITS, Units
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.building import Site

_KEYS = ("length", "time", "mass")
_ACCEPTED = (
    "si (m, s, kg), molecular (angstrom, ps, amu) or reduced, or "
    "{length: angstrom, time: ps, mass: amu}"
)


def build_units(site: Site, given: Any) -> Units:
    """Units by name, or by length, time and mass that belong together.

    Raises:
        SceneError: Other words, or units of two systems.
    """
    if isinstance(given, str) and given in UNITS:
        return UNITS[given]
    if not isinstance(given, Mapping) or set(given) != set(_KEYS):
        raise SceneError(f"{site.where}: got {given!r}, accepted: {_ACCEPTED}")
    words = tuple(given[key] for key in _KEYS)
    for units in (SI, MOLECULAR, REDUCED):
        if words == units.words[:3]:
            return units
    owners = {w: u.name for u in (SI, MOLECULAR) for w in u.words[:3]}
    unknown = [word for word in words if not isinstance(word, str) or word not in owners]
    if unknown:
        raise SceneError(f"{site.where}: unknown unit {unknown[0]!r}, accepted: {_ACCEPTED}")
    mixed = ", ".join(f"{word} of {owners[word]}" for word in words)
    raise SceneError(f"{site.where}: units of two systems, {mixed}; accepted: {_ACCEPTED}")
