"""Goals of a motion: integrals over a phase, and values at its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.core.muscles.metabolic_rate import BASAL, Metabolism
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.defects import PhaseForms
from mbd_ros.optimal_control.phase_motion import Unknowns
from mbd_ros.optimal_control.problem import Goal, PhaseProblem
from mbd_ros.optimal_control.quantities import Quantities, Quantity
from mbd_ros.optimal_control.sparse_program import Block, Form

MARKERS = "markers"  # name of all markers of a scene, with their weights
_RATES = {"q": "v", "v": "a", "z": "w"}
_SAMPLES = 101  # times at which the content of a recording is tested
# goal, names of quantities, times since the beginning of the phase [s] -> one row per quantity
Reference = Callable[[Goal, Sequence[str], Array], Array]


class PhaseCosts:
    """Cost of a phase.

    Args:
        problem: Problem of the phase.
        quantities: Quantities by name.
        forms: Equations on meshes.
        references: References of tracking goals.

    Raises:
        ModelError: A goal names a quantity that does not exist.
    """

    def __init__(
        self,
        problem: PhaseProblem,
        quantities: Quantities,
        forms: PhaseForms,
        references: Reference | None = None,
    ) -> None:
        self._problem = problem
        self._forms = forms
        self._references = references
        self._goals = {goal.name: goal for goal in problem.goals}
        self._terms = {
            goal.name: self._available_terms(goal, quantities) for goal in problem.goals
        }
        self._integrals = {name: self._integral(terms) for name, terms in self._terms.items()}

    def _available_terms(self, goal: Goal, quantities: Quantities) -> Terms:
        """Return the terms of a goal, without quantities of patterns that have no reference."""
        terms = terms_of(goal, quantities)
        if not terms.tracked or self._references is None:
            return terms
        names = [quantity.name for quantity, _, _ in terms.tracked]
        times = np.linspace(0.0, 0.5 * sum(self._problem.duration), _SAMPLES)
        has_reference = np.isfinite(self._references(goal, names, times)).any(axis=1)
        missing = [
            name
            for name, (_, _, required), there in zip(
                names, terms.tracked, has_reference, strict=True
            )
            if not there and (required or not has_reference.any())
        ]
        if missing:
            raise ModelError(f"goal {goal.name}: its recording has no values of {missing[0]}")
        tracked = [t for t, there in zip(terms.tracked, has_reference, strict=True) if there]
        return terms._replace(tracked=tracked)

    def blocks(self, unknowns: Unknowns) -> list[Block]:
        """Return costs on a mesh, and rows for inputs that must be continuous."""
        points, blocks = self._forms.point_places(unknowns), list(self._input_continuity(unknowns))
        for name in self._terms:
            blocks += self._costs(name, unknowns, points)
        return blocks

    def _costs(self, name: str, unknowns: Unknowns, points: Any) -> Iterator[Block]:
        """Yield the blocks of a goal, which have its name."""
        terms, mesh = self._terms[name], unknowns.mesh
        interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
        weights = np.concatenate([mesh.scheme_of(int(d)).b for d in mesh.degrees])
        integral = self._integrals[name]
        if integral is not None:
            places = np.vstack((points, unknowns.widths[interval]))
            data = np.vstack((mesh.shares, weights, self._tracking_data(name, unknowns)))
            yield Block(name, integral, places, data)
        if terms.final is not None:
            form = self._forms.last_form(mesh.scheme_of(int(mesh.degrees[-1])), terms.final)
            yield Block(name, form, self._forms.last_places(unknowns), np.ones((1, 1)))
        if terms.time:
            T = self._forms.duration
            form = Form(T, ca.SX(0, 1), ca.SX(0, 1), terms.time * T)
            yield Block(name, form, np.array([[unknowns.duration]]))
        yield from self._squared_rates(name, unknowns)
        yield from self._speeds(name, unknowns)

    def _integral(self, terms: Terms) -> Form | None:
        width, weight = ca.SX.sym("width"), ca.SX.sym("weight")
        wanted, counts = (ca.SX.sym(name, len(terms.tracked)) for name in ("wanted", "counts"))
        total = ca.SX(0) if terms.integral is None else terms.integral
        for i, (quantity, share, _) in enumerate(terms.tracked):
            total = total + share * counts[i] * (quantity.value - wanted[i]) ** 2
        total = ca.SX(total)
        if total.is_zero():
            return None
        data = ca.vertcat(weight, wanted, counts)
        cost = self._forms.duration * width * weight * total
        return self._forms.point_form(ca.SX(0, 1), cost, data, width)

    def _tracking_data(self, name: str, unknowns: Unknowns) -> Array:
        """Return references at points, and their weights: 0 in gaps, else 1."""
        tracked = self._terms[name].tracked
        if not tracked or self._references is None:
            return np.zeros((0, len(unknowns.mesh.shares)))
        times = unknowns.mesh.shares * 0.5 * sum(self._problem.duration)
        names = [quantity.name for quantity, _, _ in tracked]
        values = self._references(self._goals[name], names, times)
        return np.vstack((np.nan_to_num(values), np.isfinite(values)))

    def _squared_rates(self, name: str, unknowns: Unknowns) -> Iterator[Block]:
        """Yield costs of squared rates of inputs."""
        mesh = unknowns.mesh
        for degree in np.unique(mesh.degrees).tolist() if self._terms[name].rates else []:
            scheme, chosen = mesh.scheme_of(degree), np.flatnonzero(mesh.degrees == degree)
            slopes = scheme.powers()[1:] * np.arange(1, degree)[:, None]
            D = np.vander(scheme.c, degree - 1, increasing=True) @ slopes
            u, T, w, s = ca.SX.sym("u", degree), ca.SX.sym("T"), ca.SX.sym("w"), ca.SX.sym("s")
            cost = s * ca.dot(ca.DM(scheme.b), (ca.DM(D) @ u) ** 2) / (T * w)
            form = Form(ca.vertcat(u, T, w), s, ca.SX(0, 1), cost)
            places = mesh.first_points[chosen][:, None] + np.arange(degree)
            for quantity, share in self._terms[name].rates:
                u_places = unknowns.points["u"][places, quantity.index].T
                shared = np.full(len(chosen), unknowns.duration), unknowns.widths[chosen]
                data = np.full((1, len(chosen)), share)
                yield Block(name, form, np.vstack((u_places, *shared)), data)

    def _input_continuity(self, unknowns: Unknowns) -> Iterator[Block]:
        """Yield rows of inputs that are continuous at nodes."""
        mesh, nu = unknowns.mesh, unknowns.sizes.nu
        rates = {q.index for terms in self._terms.values() for q, _ in terms.rates}
        if mesh.scheme_of(int(mesh.degrees[0])).joins_inputs:
            rates = set(range(nu))
        pairs = np.stack((mesh.degrees[:-1], mesh.degrees[1:]))
        for d0, d1 in np.unique(pairs, axis=1).T.tolist() if rates else []:
            chosen = np.flatnonzero((pairs == [[d0], [d1]]).all(axis=0))
            before, after = ca.SX.sym("b", d0), ca.SX.sym("a", d1)
            ends = (
                mesh.scheme_of(d0).values(np.ones(1)),
                mesh.scheme_of(d1).values(np.zeros(1)),
            )
            row = ca.DM(ends[0]) @ before - ca.DM(ends[1]) @ after
            form = Form(ca.vertcat(before, after), ca.SX(0, 1), row)
            last = mesh.first_points[chosen][:, None] + np.arange(d0)
            first = mesh.first_points[chosen + 1][:, None] + np.arange(d1)
            for i in sorted(rates):
                places = np.hstack((unknowns.points["u"][last, i], unknowns.points["u"][first, i]))
                yield Block("inputs", form, places.T)

    def _speeds(self, name: str, unknowns: Unknowns) -> Iterator[Block]:
        """Yield costs of squared differences of mean speeds from their targets."""
        for quantity, target, share in self._terms[name].speeds:
            if quantity.letter != "q":
                raise ModelError(
                    f"goal {name}: {quantity.name} is not the position of an independent joint; "
                    "name such a position"
                )
            x0, x1, T = (ca.SX.sym(letter) for letter in ("a", "b", "T"))
            cost = share * ((x1 - x0) / T - target) ** 2
            form = Form(ca.vertcat(x0, x1, T), ca.SX(0, 1), ca.SX(0, 1), cost)
            ends = unknowns.nodes["q"][[0, -1], quantity.index]
            yield Block(name, form, np.array([[*ends, unknowns.duration]]).T)


class Terms(NamedTuple):
    """Terms of a goal in the cost of a phase.

    Attributes:
        integral: Expression at points whose integral is added; None for none.
        final: Expression at the end that is added; None for none.
        time: Cost of a second.
        rates: Inputs, and weights of the integrals of their squared rates.
        speeds: Positions, targets of their mean speeds, and weights of the squared differences.
        tracked: Tracked quantities, weights of the integrals of the squared differences, and
            whether references are required.
    """

    integral: Any = None
    final: Any = None
    time: float = 0.0
    rates: Sequence[tuple[Quantity, float]] = ()
    speeds: Sequence[tuple[Quantity, float, float]] = ()
    tracked: Sequence[tuple[Quantity, float, bool]] = ()


def terms_of(goal: Goal, of: Quantities) -> Terms:
    """Return the terms of a goal.

    Raises:
        ModelError: The goal names a quantity that does not exist.
    """
    return _KINDS[goal.kind](goal.weight, goal.options, of)


def _effort(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, of.inputs()))


def _torque(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, of.find("*.effort")))


def _power(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    total, smoothing = ca.SX(0), options["smoothing"]
    for effort, share in _weighted_quantities(options["of"], of, of.find("*.effort")):
        speed = of.find(f"{effort.name.removesuffix('.effort')}.velocity")[0]
        total += share * (ca.sqrt((effort.value * speed.value) ** 2 + smoothing**2) - smoothing)
    return Terms(weight * total)


def _activation(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, of.find("*.activation")))


def _metabolic(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    numbers = Metabolism(*(options[key] for key in ("slow_twitch", "specific_tension")))
    rates = of.metabolic_rates(numbers._replace(smoothing=options["smoothing"]))
    if not rates:
        raise ModelError("goal metabolic: the scene has no muscles; use another goal")
    shares = _weights(options["of"] or "*")
    total = ca.SX(0)
    for pattern, share in shares.items():
        chosen = [rate.value for rate in rates if fnmatchcase(rate.name, pattern)]
        if not chosen:
            names = ", ".join(rate.name for rate in rates)
            raise ModelError(f"goal metabolic: no muscle '{pattern}'; accepted are {names}")
        total += share * sum(chosen)
    basal = BASAL * of.mass if options["basal"] else 0.0
    return Terms(weight * total, time=weight * basal)


def _time(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(time=weight)


def _speed(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    quantities = of.find(options["of"])
    if len(quantities) > 1:
        names = ", ".join(quantity.name for quantity in quantities)
        raise ModelError(f"goal speed: '{options['of']}' matches {names}; name one position")
    return Terms(speeds=[(quantities[0], options["target"], weight)])


def _smoothness(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    total, rates = ca.SX(0), list[tuple[Quantity, float]]()
    for quantity, share in _weighted_quantities(options["of"], of, of.inputs()):
        if quantity.letter == "u":
            rates.append((quantity, weight * share))
        else:
            total += share * _rate(quantity, of) ** 2
    return Terms(weight * total, rates=rates)


def _tracking(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    tracked = list[tuple[Quantity, float, bool]]()
    for name, share in _weights(options["of"]).items():
        if name == MARKERS:
            tracked += [(marker, weight * share * w, False) for marker, w in of.markers()]
            continue
        tracked += [(q, weight * float(share), q.name == name) for q in of.find(name)]
    return Terms(tracked=tracked)


def _integral(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, [], options["target"]))


def _final(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(final=weight * _sum_of_powers(options, of, [], options["target"]))


def _function(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    result = options["function"](_QuantitiesByName(of))
    try:
        value = ca.SX(result)
    except NotImplementedError as error:
        raise ModelError(
            f"goal function: it returns {result!r}, but must return a number"
        ) from error
    if value.numel() != 1:
        raise ModelError(f"goal function: it returns {value.numel()} numbers, but must return one")
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


class _QuantitiesByName(Mapping[str, Any]):
    """Argument of a user's function: expressions of quantities by name."""

    def __init__(self, of: Quantities) -> None:
        self._of = of

    def __getitem__(self, name: str) -> Any:
        return self._of.find(name)[0].value

    def __iter__(self) -> Iterator[str]:
        return iter(self._of.names)

    def __len__(self) -> int:
        return len(self._of.names)


def _sum_of_powers(
    options: Mapping[str, Any], of: Quantities, default: Sequence[Quantity], target: float = 0.0
) -> Any:
    power = options["power"]
    total = ca.SX(0)
    for quantity, share in _weighted_quantities(options["of"], of, default):
        x = quantity.value - target
        total += share * (x**power if power % 2 == 0 or power == 1 else ca.fabs(x) ** power)
    return total


def _weighted_quantities(
    selection: Any, of: Quantities, default: Sequence[Quantity]
) -> list[tuple[Quantity, float]]:
    """Return quantities and weights of a name, a list of names, or names with weights."""
    if selection is None:
        return [(quantity, 1.0) for quantity in default]
    pairs = _weights(selection).items()
    return [(quantity, share) for name, share in pairs for quantity in of.find(name)]


def _weights(selection: Any) -> dict[str, float]:
    """Return the weight of each name of a name, a list of names, or names with weights."""
    if isinstance(selection, str):
        return {selection: 1.0}
    if isinstance(selection, Mapping):
        return {name: float(share) for name, share in selection.items()}
    return dict.fromkeys(selection, 1.0)


def _rate(quantity: Quantity, of: Quantities) -> Any:
    """Return the rate of an expression of q, v and z.

    Raises:
        ModelError: The expression depends on forces or accelerations.
    """
    symbols, total = of.symbols, ca.SX(0)
    if ca.depends_on(quantity.value, ca.vertcat(*(symbols[key] for key in "awul"))):
        raise ModelError(
            f"goal smoothness: {quantity.name} depends on forces or accelerations; accepted are "
            "inputs, and quantities of positions, velocities and internal states"
        )
    for letter, rate in _RATES.items():
        if symbols[letter].numel() == symbols[rate].numel():
            total += ca.jtimes(quantity.value, symbols[letter], symbols[rate])
    return total
