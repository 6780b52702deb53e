"""Goals of a phase as blocks of a program."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.defects import PhaseForms
from mbd_ros.optimal_control.goals import Terms, terms_of
from mbd_ros.optimal_control.problem import Goal, PhaseProblem
from mbd_ros.optimal_control.program_block import Block, Form
from mbd_ros.optimal_control.quantities import Quantities
from mbd_ros.optimal_control.unknowns import Unknowns

# goal, names of quantities, times since the beginning of the phase [s] -> a row a quantity
Reference = Callable[[Goal, Sequence[str], Array], Array]


_LOOKED_AT = 101  # times at which a recording is asked what it says


class PhaseCosts:
    """What a phase adds to the cost.

    Args:
        problem: What is asked of the phase.
        quantities: By name.
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
