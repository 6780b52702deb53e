"""Compiled equations of motion beside those of the plain tier."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import Library
from mbd_ros.compiled.code.emit import SEARCH
from mbd_ros.compiled.symbols.trace import ARGUMENTS, Traced
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import NONE, Array, Mode, State
from mbd_ros.errors import MbdError

_STATES, _SEED = 3, 20
_SPREAD = 0.3  # of the states around the start [rad, m, rad/s, m/s]
_CLOSE = 1.0e-6  # of the largest; wrong code is wrong by more, rounding in any order by less
_SOUND = 1.0e-4  # health of rows below which two exact methods may differ by more


def verify(library: Library, traced: Traced, system: System, p: Array = NONE) -> None:
    """Compares accelerations and all other functions at random states around all joints at 0.

    Accelerations are held against the plain tier, every function against its expressions, there
    with other parameters too. States at which the plain tier has no solution say nothing.

    Args:
        library: Has the function `accelerate`.
        traced: What it was compiled from.
        p: Values of the parameters that the system was built with, shape (np,).

    Raises:
        BuildError: They differ; names the function.
    """
    rng = np.random.default_rng(_SEED)
    for _ in range(_STATES):
        mode = () if system.event_rows is None else _mode(system.event_rows, rng)
        y = some_state(system, rng)._replace(mode=mode)
        held, u = some_inputs(system, y.t, rng)
        values = y.t, y.q, y.v, y.z, u, np.append(p, mode)
        a, zdot, health = _native(library, "accelerate", values)[:3]
        if not (health > _SOUND).all():
            continue
        try:
            wanted = plain_rates(system, y, held)
        except MbdError:
            continue
        _refuse(np.hstack((a, zdot)), wanted, "accelerations", f"those of the tier {traced.tier}")
        given = dict(zip("tqvzu", values[:5], strict=True))
        given["p"] = np.append(p * rng.uniform(0.9, 1.1, len(p)), mode)
        for name in library.source.signatures:
            if name != SEARCH:
                _verify_code(library, traced.function(name), given, rng)


def _native(library: Library, name: str, values: Sequence[Any]) -> list[Array]:
    """Results of a function, shapes (lanes, size)."""
    native = library.function(name)
    for argument, value in zip(native.arguments, values, strict=True):
        argument.T[...] = value
    native()
    return [np.atleast_2d(result.T) for result in native.results]


def _verify_code(
    library: Library, function: Any, given: Mapping[str, Any], rng: np.random.Generator
) -> None:
    """Holds the code of one function against its expressions, as CasADi evaluates them.

    Arguments that are not given, steps and multipliers, are random.
    """
    name, values = function.name(), []
    for i, letter in enumerate(ARGUMENTS[name]):
        some = rng.normal(0.0, _SPREAD, function.size1_in(i))
        values.append(given.get(letter, some))
    native = _native(library, name, values)
    if function.n_in() > len(values):  # paths that code searches, perhaps more than it asks for
        paths = _native(library, SEARCH, [given[letter] for letter in ARGUMENTS["path_places"]])[0]
        values.append(paths[0, : function.size1_in(len(values))])
    for found, expected in zip(native, function.call(values), strict=True):
        _refuse(found, np.array(expected).ravel("F"), f"values of '{name}'", "its expressions")


def _refuse(found: Array, wanted: Array, what: str, beside: str) -> None:
    """Refuse numbers that differ from those wanted where these are finite.

    Raises:
        BuildError: They do.
    """
    known = np.isfinite(wanted)
    apart = np.abs(found - wanted)[:, known].max(initial=0.0)
    if not apart <= _CLOSE * (1.0 + np.abs(wanted[known]).max(initial=0.0)):
        raise BuildError(f"compiled {what} differ by {apart:.3g} from {beside}")


def some_state(system: System, rng: np.random.Generator) -> State:
    """A state of what is integrated."""
    robot, internals = system.robot, system.internals
    z = internals.inside(np.nan_to_num(internals.initial))
    y = system.reduce(State(0.0, robot.neutral(), np.zeros(system.model.nv), z))
    y = system.chart.plus(y, rng.normal(0.0, _SPREAD, 2 * system.nv + internals.nz))
    return y._replace(z=internals.inside(y.z))


def _mode(exact: Any, rng: np.random.Generator) -> Mode:
    """Any mode in which rows without an upper bound are not at it, contacts in all of theirs."""
    upper = exact.solver.constraints.upper.tolist()
    ways = zip(rng.integers(-1, 2, len(upper)).tolist(), upper, strict=True)
    mode = [abs(way) if np.isinf(bound) else way for way, bound in ways]
    for i in () if exact.contacts is None else exact.contacts.normals:
        names = ((mode[i],) * 2, (mode[i],) * 2, (3, -1), (-15, 5), (2**51 + 1, 2**52 + 1))
        mode[i + 1 : i + 3] = names[0 if mode[i] else rng.integers(len(names))]
    return tuple(mode)


def some_inputs(system: System, t: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Inputs as the plain tier takes them, and the same completed by sources."""
    sources = system.loads.sources
    held = sources.hold(t)
    if held is None:
        held = system.loads.idle + rng.uniform(0.0, 0.5, len(system.loads.idle))
    return held, sources.complete(held, t)


def plain_rates(system: System, y: State, u: Array) -> Array:
    """Accelerations, then rates of internal states, shape (nv + nz,)."""
    a, zdot = np.zeros(system.nv), np.zeros(len(y.z))
    accelerate = system.accelerator(y.mode)
    if len(y.z):
        accelerate(y.t, y.q, y.v, y.z, u, a, zdot)
    else:
        accelerate(y.t, y.q, y.v, u, a)
    return np.concatenate((a, zdot))
