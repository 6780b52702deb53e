"""A system as symbolic expressions: functions of CasADi that evaluate it without any Python."""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.parts_of import Made
from mbd_ros.compiled.symbols.searched_paths import SearchedPaths
from mbd_ros.compiled.symbols.traced_functions import Answers
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Mode

ARGUMENTS = {  # of every function, in their order
    "accelerate": "tqvzup",
    "multipliers": "tqvzup",
    "expand": "tqv",
    "place": "tqp",
    "settle": "tqvp",
    "gap": "tqp",
    "lift": "tqp",
    "integrate": "qd",
    "rate": "dv",
    "energy": "tqvzp",
    "derivatives": "tqvzup",
    "residual": "tqvzupal",
    "balance": "tqvzupal",
    "balance_slopes": "tqvzupal",
    "guards": "tqvzup",
    "heights": "tqvp",
    "answers": "tqvzupal",
    "land": "tqp",
    "stay": "tqvp",
    "path_places": "tqp",
}
_OF_PATHS = ("derivatives", "balance_slopes")  # differentiate what paths do


class Traced:
    """The functions of a system, made when they are asked for.

    Arguments and results are dense columns, empty where there is nothing: time t [s], q and v of
    what the tier integrates, internal states z, inputs u, parameters p.

    accelerate(t, q, v, z, u, p) -> (a, zdot, health): health is the smallest pivot of the rows
    over its usual size, 1 without rows.
    multipliers(t, q, v, z, u, p) -> (a_all, lam): of all joints, and in the order of
    `System.multiplier_rows`.
    expand(t, q, v) -> (q_all, v_all).
    place(t, q, p) -> (dq, g, health): a step of Newton's method onto the rows of positions in the
    mass metric.
    settle(t, q, v, p) -> (dv, rate): onto all rows that velocities keep.
    gap(t, q, p) -> g, lift(t, q, p) -> (M^-1 J' (J M^-1 J')^-1, health) of the rows of positions.
    energy(t, q, v, z, p) -> (T, V).
    derivatives(t, q, v, z, u, p) -> of (a, zdot) by steps of q, by v, z, u and p.
    residual(t, q, v, z, u, p, a, lam): what the equations of motion leave, lam of rows that act.
    balance(t, q, v, z, u, p, a, lam) -> (tau - h - M a + J' lam, zdot), and
    balance_slopes(the same) -> of both, stacked, by steps of q, by v and by z.
    guards(t, q, v, z, u, p) -> margins of rows that give way in the mode, as `margins` lists them,
    then the values of the guards of parts.
    heights(t, q, v, p) -> (margins, rates, spans, names), answers(t, q, v, z, u, p, a, lam) ->
    (margins, rates, length) of rows that give way, in all modes: margins of heights and slips, and
    of multipliers, positive while a mode goes on. Names are 0 where a slip should have another
    one, 2 where one turns with its velocity: length [s] is how long a step may be then. `a` and
    `lam` are those of `accelerate`, which gives `lam` as its fourth result then.
    land(t, q, p) -> (dq, g), stay(t, q, v, p) -> (dv, rate) onto the rows that are on.
    path_places(t, q, p): where points and surfaces of paths that wrap are, as `searched` has them.
    Functions that depend on what such paths do have one more argument: `searched.symbols`.
    integrate(q, dq) -> q (+) dq, rate(dq, v) -> the rate of dq: for charts that are not flat.

    Args:
        equations: The expressions.

    Attributes:
        equations: As given.
        tier: Name of the way of solving.
        parameters: Names of p.
        nq: Size of the configuration of what is integrated.
        nv: Size of its velocity.
        nz: Number of internal states.
        nu: Number of inputs.
        np: Number of parameters.
        nq_all: Size of the configuration of all joints.
        nv_all: Size of their velocity.
        m: Number of multipliers.
        mg: Number of rows of positions that an integrator may have to keep.
        mh: Number of rows that velocities keep.
        switches: How many entries of a mode stand behind the parameters in p.
        least_health: Below it, rows are too near to dependent for a factor without pivoting.
    """

    least_health = 1.0e-8

    def __init__(self, equations: Equations) -> None:
        self.equations, self._answers = equations, Answers(equations)
        self.tier, self.parameters = equations.tier, equations.parameters
        self.nq, self.nv = equations.nq, equations.nv
        self.nz, self.nu, self.np = equations.nz, equations.nu, len(equations.parameters)
        self.nq_all, self.nv_all = equations.tree.nq, equations.tree.nv
        self.m, self.mg, self.mh = equations.m, equations.mg, equations.mh
        self.switches = equations.switches
        self._made: dict[str, Any] = {}

    @property
    def margins(self) -> tuple[tuple[int, int], ...]:
        """Row, and 1 or -1 where its multiplier meets a bound: what `guards` begins with."""
        return self.equations.margins

    @property
    def keys(self) -> dict[tuple[int, int], int]:
        """Margins in all modes: row and way -> place among those of `heights`, then `answers`."""
        return getattr(self.equations.yielding, "keys", {})

    @property
    def searched(self) -> SearchedPaths:
        """Paths that functions made so far have as numbers."""
        return self.equations.k.searches

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all functions."""
        return tuple(ARGUMENTS)

    def function(self, name: str) -> Any:
        """The `casadi.Function` of a name.

        Raises:
            Untraceable: The system has no such function; says why.
        """
        if name not in self._made:
            if name not in ARGUMENTS:
                raise Untraceable(f"no function '{name}'; there are {', '.join(ARGUMENTS)}")
            made: Callable[[], Sequence[Any]] = getattr(self._answers, name)
            results = ca.cse([_dense(result) for result in made()])
            arguments = [self.equations.symbols[key] for key in ARGUMENTS[name]]
            paths = self.searched.symbols
            if self.searched and ca.depends_on(ca.vertcat(*map(ca.vec, results)), paths):
                if name in _OF_PATHS:
                    raise Untraceable("derivatives through paths that wrap have no compiled form")
                arguments.append(paths)
            self._made[name] = ca.Function(name, arguments, results)
        return self._made[name]


def _dense(result: Any) -> Any:
    """A result whose columns are there even where they are empty."""
    found = ca.densify(ca.SX(result))
    return found if found.shape[1] else ca.SX(found.shape[0], 1)


def trace(
    system: System,
    parameters: Sequence[str] = (),
    mode: Mode | None = (),
    made: Made = dict,
    *,
    in_world: bool = False,
) -> Traced:
    """The functions of a system.

    Args:
        system: The system.
        parameters: Names of numbers that stay arguments.
        mode: Of rows that give way at events, as `State.mode`; needed where there are any. None
            for all modes at once: p ends with the mode then.
        made: Makes parts from symbols by parameter: name -> part; see `scene.runs.symbolic_parts`.
        in_world: Whether velocities of free bodies stand in the axes of the world, for functions
            that runs call; accelerations are their rates then.

    Raises:
        Untraceable: Names the part and why.
    """
    return Traced(Equations(system, tuple(parameters), mode, made, in_world=in_world))
