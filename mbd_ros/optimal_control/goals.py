"""Goals of a motion as expressions: integrals over a phase, and values at its end."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.core.muscles.metabolic_rate import BASAL, Metabolism
from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.problem import Goal
from mbd_ros.optimal_control.quantities import Quantities, Quantity

MARKERS = "markers"  # all of a scene, with their weights
_RATES = {"q": "v", "v": "a", "z": "w"}


class Terms(NamedTuple):
    """What a goal adds to the cost of a phase.

    Attributes:
        integral: Expression at points whose integral is added; None for nothing.
        final: Expression at the end; None for nothing.
        time: What a second counts.
        steep: Inputs, and what the integral of their squared rates counts.
        speeds: Quantities of position, what mean speed they should have, and what the square of
            the difference counts.
        tracked: Quantities that a recording says, what the integral of the squared difference
            counts, and whether it has to say them.
    """

    integral: Any = None
    final: Any = None
    time: float = 0.0
    steep: Sequence[tuple[Quantity, float]] = ()
    speeds: Sequence[tuple[Quantity, float, float]] = ()
    tracked: Sequence[tuple[Quantity, float, bool]] = ()


def terms_of(goal: Goal, of: Quantities) -> Terms:
    """The terms of a goal.

    Raises:
        ModelError: It names a quantity that is not there.
    """
    return _KINDS[goal.kind](goal.weight, goal.options, of)


def _effort(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, of.inputs()))


def _torque(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, of.find("*.effort")))


def _activation(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, of.find("*.activation")))


def _power(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    total, smoothing = ca.SX(0), options["smoothing"]
    for one, share in _chosen(options["of"], of, of.find("*.effort")):
        speed = of.find(f"{one.name.removesuffix('.effort')}.velocity")[0]
        total += share * (ca.sqrt((one.value * speed.value) ** 2 + smoothing**2) - smoothing)
    return Terms(weight * total)


def _metabolic(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    numbers = Metabolism(*(options[key] for key in ("slow_twitch", "specific_tension")))
    rates = of.metabolic_rates(numbers._replace(smoothing=options["smoothing"]))
    if not rates:
        raise ModelError("goal metabolic: the scene has no muscles")
    shares = _by_name(options["of"] or "*")
    total = ca.SX(0)
    for pattern, share in shares.items():
        chosen = [one.value for one in rates if fnmatchcase(one.name, pattern)]
        if not chosen:
            names = ", ".join(one.name for one in rates)
            raise ModelError(f"goal metabolic: no muscle '{pattern}'; there are {names}")
        total += share * sum(chosen)
    basal = BASAL * of.mass if options["basal"] else 0.0
    return Terms(weight * total, time=weight * basal)


def _time(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(time=weight)


def _speed(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    (one,) = of.find(options["of"])
    return Terms(speeds=[(one, options["target"], weight)])


def _smoothness(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    total, steep = ca.SX(0), list[tuple[Quantity, float]]()
    for one, share in _chosen(options["of"], of, of.inputs()):
        if one.letter == "u":
            steep.append((one, weight * share))
        else:
            total += share * _rate(one, of) ** 2
    return Terms(weight * total, steep=steep)


def _tracking(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    given, found = options["of"], list[tuple[Quantity, float, bool]]()
    for name, share in _by_name(given).items():
        if name == MARKERS:
            found += [(one, weight * share * own, False) for one, own in of.markers()]
            continue
        every = of.find(name)
        found += [(one, weight * float(share), one.name == name) for one in every]
    return Terms(tracked=found)


def _integral(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, [], options["target"]))


def _final(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(final=weight * _sum_of_powers(options, of, [], options["target"]))


def _function(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    given = options["function"](_Named(of))
    try:
        value = ca.SX(given)
    except NotImplementedError as error:
        raise ModelError(f"function gives {given!r}, accepted: one number") from error
    if value.numel() != 1:
        raise ModelError(f"function gives {value.numel()} numbers, accepted: one")
    return Terms(**{options["at"]: weight * value})


_KINDS: Mapping[str, Callable[[float, Mapping[str, Any], Quantities], Terms]] = {
    "effort": _effort,
    "torque": _torque,
    "power": _power,
    "activation": _activation,
    "metabolic": _metabolic,
    "time": _time,
    "speed": _speed,
    "smoothness": _smoothness,
    "tracking": _tracking,
    "integral": _integral,
    "final": _final,
    "function": _function,
}


class _Named(Mapping[str, Any]):
    """What a function of somebody else sees: expressions by name."""

    def __init__(self, of: Quantities) -> None:
        self._of = of

    def __getitem__(self, name: str) -> Any:
        return self._of.find(name)[0].value

    def __iter__(self) -> Iterator[str]:
        return iter(self._of.names)

    def __len__(self) -> int:
        return len(self._of.names)


def _sum_of_powers(
    options: Mapping[str, Any], of: Quantities, usual: Sequence[Quantity], target: float = 0.0
) -> Any:
    power = options["power"]
    total = ca.SX(0)
    for one, share in _chosen(options["of"], of, usual):
        off = one.value - target
        total += share * (off**power if power % 2 == 0 or power == 1 else ca.fabs(off) ** power)
    return total


def _chosen(given: Any, of: Quantities, usual: Sequence[Quantity]) -> list[tuple[Quantity, float]]:
    """Quantities and what each counts; a name, a list of names, or names with weights."""
    if given is None:
        return [(one, 1.0) for one in usual]
    pairs = _by_name(given).items()
    return [(one, share) for name, share in pairs for one in of.find(name)]


def _by_name(given: Any) -> dict[str, float]:
    """What each name of a name, a list, or names with weights counts."""
    if isinstance(given, str):
        return {given: 1.0}
    if isinstance(given, Mapping):
        return {name: float(share) for name, share in given.items()}
    return dict.fromkeys(given, 1.0)


def _rate(one: Quantity, of: Quantities) -> Any:
    """Rate of an expression of q, v and z.

    Raises:
        ModelError: It is one of forces or accelerations, too.
    """
    symbols, total = of.symbols, ca.SX(0)
    if ca.depends_on(one.value, ca.vertcat(*(symbols[key] for key in "awul"))):
        raise ModelError(
            f"smoothness of {one.name}, which depends on forces or accelerations; accepted: "
            "inputs, and what depends on positions, velocities and internal states alone"
        )
    for letter, rate in _RATES.items():
        if symbols[letter].numel() == symbols[rate].numel():
            total += ca.jtimes(one.value, symbols[letter], symbols[rate])
    return total
