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

MARKERS = "markers"  # all of a scene, with their weights
_RATES = {"q": "v", "v": "a", "z": "w"}
_LOOKED_AT = 101  # times at which a recording is asked what it says
# goal, names of quantities, times since the beginning of the phase [s] -> a row a quantity
Reference = Callable[[Goal, Sequence[str], Array], Array]


class PhaseCosts:
    """What a phase adds to the cost.

    Args:
        problem: What is asked of the phase.
        forms: Equations on meshes.
        references: What is tracked.

    Raises:
        ModelError: A goal names a quantity that is not there.
    """

    def __init__(
        self,
        problem: PhaseProblem,
        quantities: Quantities,
        forms: PhaseForms,
        references: Reference | None = None,
    ) -> None:
        self._problem, self._forms, self._references = problem, forms, references
        self._goals = {goal.name: goal for goal in problem.goals}
        self._terms = {goal.name: self._known(goal, quantities) for goal in problem.goals}
        self._integrals = {name: self._integral(one) for name, one in self._terms.items()}

    def _known(self, goal: Goal, quantities: Quantities) -> Terms:
        """The terms of a goal, without quantities of a pattern that its recording does not say."""
        terms = terms_of(goal, quantities)
        if not terms.tracked or self._references is None:
            return terms
        names = [one.name for one, _, _ in terms.tracked]
        times = np.linspace(0.0, 0.5 * sum(self._problem.duration), _LOOKED_AT)
        said = np.isfinite(self._references(goal, names, times)).any(axis=1)
        lacking = [
            name
            for name, (_, _, asked), there in zip(names, terms.tracked, said, strict=True)
            if not there and (asked or not said.any())
        ]
        if lacking:
            raise ModelError(f"goal {goal.name}: its recording says nothing of {lacking[0]}")
        kept = [one for one, there in zip(terms.tracked, said, strict=True) if there]
        return terms._replace(tracked=kept)

    def blocks(self, unknowns: Unknowns) -> list[Block]:
        """Costs on a mesh, and rows of inputs that they let not jump."""
        points, found = self._forms.point_places(unknowns), list(self._joined_inputs(unknowns))
        for name in self._terms:
            found += self._costs(name, unknowns, points)
        return found

    def _costs(self, name: str, unknowns: Unknowns, points: Any) -> Iterator[Block]:
        """Blocks of a goal; they have its name."""
        terms, mesh = self._terms[name], unknowns.mesh
        interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
        weights = np.concatenate([mesh.scheme_of(int(d)).b for d in mesh.degrees])
        integral = self._integrals[name]
        if integral is not None:
            places = np.vstack((points, unknowns.widths[interval]))
            data = np.vstack((mesh.shares, weights, self._tracked(name, unknowns)))
            yield Block(name, integral, places, data)
        if terms.final is not None:
            form = self._forms.last_form(mesh.scheme_of(int(mesh.degrees[-1])), terms.final)
            yield Block(name, form, self._forms.last_places(unknowns), np.ones((1, 1)))
        if terms.time:
            T = self._forms.duration
            form = Form(T, ca.SX(0, 1), ca.SX(0, 1), terms.time * T)
            yield Block(name, form, np.array([[unknowns.duration]]))
        yield from self._steep(name, unknowns)
        yield from self._speeds(name, unknowns)

    def _integral(self, terms: Terms) -> Form | None:
        width, weight = ca.SX.sym("width"), ca.SX.sym("weight")
        wanted, counts = (ca.SX.sym(name, len(terms.tracked)) for name in ("wanted", "counts"))
        total = ca.SX(0) if terms.integral is None else terms.integral
        for i, (one, share, _) in enumerate(terms.tracked):
            total = total + share * counts[i] * (one.value - wanted[i]) ** 2
        total = ca.SX(total)
        if total.is_zero():
            return None
        data = ca.vertcat(weight, wanted, counts)
        cost = self._forms.duration * width * weight * total
        return self._forms.point_form(ca.SX(0, 1), cost, data, width)

    def _tracked(self, name: str, unknowns: Unknowns) -> Array:
        """What a recording says at points, then what of it counts: 0 in its gaps, else 1."""
        tracked = self._terms[name].tracked
        if not tracked or self._references is None:
            return np.zeros((0, len(unknowns.mesh.shares)))
        times = unknowns.mesh.shares * 0.5 * sum(self._problem.duration)
        values = self._references(self._goals[name], [one.name for one, _, _ in tracked], times)
        return np.vstack((np.nan_to_num(values), np.isfinite(values)))

    def _steep(self, name: str, unknowns: Unknowns) -> Iterator[Block]:
        """Squared rates of inputs."""
        mesh = unknowns.mesh
        for degree in np.unique(mesh.degrees).tolist() if self._terms[name].steep else []:
            scheme, chosen = mesh.scheme_of(degree), np.flatnonzero(mesh.degrees == degree)
            slopes = scheme.powers()[1:] * np.arange(1, degree)[:, None]
            D = np.vander(scheme.c, degree - 1, increasing=True) @ slopes
            u, T, w, s = ca.SX.sym("u", degree), ca.SX.sym("T"), ca.SX.sym("w"), ca.SX.sym("s")
            cost = s * ca.dot(ca.DM(scheme.b), (ca.DM(D) @ u) ** 2) / (T * w)
            form = Form(ca.vertcat(u, T, w), s, ca.SX(0, 1), cost)
            at = mesh.first_points[chosen][:, None] + np.arange(degree)
            for one, share in self._terms[name].steep:
                own = unknowns.points["u"][at, one.index].T
                shared = np.full(len(chosen), unknowns.duration), unknowns.widths[chosen]
                data = np.full((1, len(chosen)), share)
                yield Block(name, form, np.vstack((own, *shared)), data)

    def _joined_inputs(self, unknowns: Unknowns) -> Iterator[Block]:
        """Inputs that do not jump at nodes: all where both ends are points, else smooth ones."""
        mesh, nu = unknowns.mesh, unknowns.sizes.nu
        steep = {one.index for terms in self._terms.values() for one, _ in terms.steep}
        if mesh.scheme_of(int(mesh.degrees[0])).joins_inputs:
            steep = set(range(nu))
        pairs = np.stack((mesh.degrees[:-1], mesh.degrees[1:]))
        for one, other in np.unique(pairs, axis=1).T.tolist() if steep else []:
            chosen = np.flatnonzero((pairs == [[one], [other]]).all(axis=0))
            before, after = ca.SX.sym("b", one), ca.SX.sym("a", other)
            ends = (
                mesh.scheme_of(one).values(np.ones(1)),
                mesh.scheme_of(other).values(np.zeros(1)),
            )
            row = ca.DM(ends[0]) @ before - ca.DM(ends[1]) @ after
            form = Form(ca.vertcat(before, after), ca.SX(0, 1), row)
            last = mesh.first_points[chosen][:, None] + np.arange(one)
            first = mesh.first_points[chosen + 1][:, None] + np.arange(other)
            for i in sorted(steep):
                places = np.hstack((unknowns.points["u"][last, i], unknowns.points["u"][first, i]))
                yield Block("inputs", form, places.T)

    def _speeds(self, name: str, unknowns: Unknowns) -> Iterator[Block]:
        """Squares of mean speeds less what they should be."""
        for one, target, share in self._terms[name].speeds:
            if one.letter != "q":
                raise ModelError(f"{one.name} is no position of an independent joint")
            x0, x1, T = (ca.SX.sym(letter) for letter in ("a", "b", "T"))
            cost = share * ((x1 - x0) / T - target) ** 2
            form = Form(ca.vertcat(x0, x1, T), ca.SX(0, 1), ca.SX(0, 1), cost)
            ends = unknowns.nodes["q"][[0, -1], one.index]
            yield Block(name, form, np.array([[*ends, unknowns.duration]]).T)


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


def _power(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    total, smoothing = ca.SX(0), options["smoothing"]
    for one, share in _chosen(options["of"], of, of.find("*.effort")):
        speed = of.find(f"{one.name.removesuffix('.effort')}.velocity")[0]
        total += share * (ca.sqrt((one.value * speed.value) ** 2 + smoothing**2) - smoothing)
    return Terms(weight * total)


def _activation(weight: float, options: Mapping[str, Any], of: Quantities) -> Terms:
    return Terms(weight * _sum_of_powers(options, of, of.find("*.activation")))


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
    every = of.find(options["of"])
    if len(every) > 1:
        names = ", ".join(one.name for one in every)
        raise ModelError(f"goal speed: '{options['of']}' is {names}; accepted: one position")
    return Terms(speeds=[(every[0], options["target"], weight)])


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
