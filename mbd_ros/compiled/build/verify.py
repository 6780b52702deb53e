"""Verification of compiled equations of motion against those of the plain tier."""

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
_SPREAD = 0.3  # of random states [rad, m, rad/s, m/s]
_CLOSE = 1.0e-6  # accepted relative difference: above rounding, far below the effect of wrong code
_SOUND = 1.0e-4  # health of rows below which two exact methods can differ by more


def verify(library: Library, traced: Traced, system: System, p: Array = NONE) -> None:
    """Compare compiled functions with their references at random states around the neutral one.

    Accelerations are compared with the plain tier, and every function with its expressions, also
    for other parameters. States at which the plain tier has no solution are skipped.

    Args:
        library: Compiled functions, `accelerate` among them.
        traced: Symbolic form from which they were compiled.
        system: The system.
        p: Values of the parameters of the system, shape (np,).

    Raises:
        BuildError: A function differs; the message names it.
    """
    rng = np.random.default_rng(_SEED)
    for _ in range(_STATES):
        mode = () if system.event_rows is None else _mode(system.event_rows, rng)
        y = random_state(system, rng)._replace(mode=mode)
        plain_u, u = random_inputs(system, y.t, rng)
        values = y.t, y.q, y.v, y.z, u, np.append(p, mode)
        a, zdot, health = _native(library, "accelerate", values)[:3]
        if not (health > _SOUND).all():
            continue
        try:
            expected = plain_rates(system, y, plain_u)
        except MbdError:
            continue
        _check_equal(
            np.hstack((a, zdot)), expected, "accelerations", f"those of the tier {traced.tier}"
        )
        arguments = dict(zip("tqvzu", values[:5], strict=True))
        arguments["p"] = np.append(p * rng.uniform(0.9, 1.1, len(p)), mode)
        for name in library.source.signatures:
            if name != SEARCH:
                _verify_code(library, traced.function(name), arguments, rng)


def _native(library: Library, name: str, values: Sequence[Any]) -> list[Array]:
    """Call a compiled function and return its results, shapes (lanes, size)."""
    native = library.function(name)
    for argument, value in zip(native.arguments, values, strict=True):
        argument.T[...] = value
    native()
    return [np.atleast_2d(result.T) for result in native.results]


def _verify_code(
    library: Library, function: Any, arguments: Mapping[str, Any], rng: np.random.Generator
) -> None:
    """Compare the code of a function with its expressions, evaluated by CasADi.

    Arguments without a value, such as steps and multipliers, are random.
    """
    name, values = function.name(), []
    for i, letter in enumerate(ARGUMENTS[name]):
        default = rng.normal(0.0, _SPREAD, function.size1_in(i))
        values.append(arguments.get(letter, default))
    native = _native(library, name, values)
    if function.n_in() > len(
        values
    ):  # results of the path search, of which the function may use a part
        places = [arguments[letter] for letter in ARGUMENTS["path_places"]]
        paths = _native(library, SEARCH, places)[0]
        values.append(paths[0, : function.size1_in(len(values))])
    for result, expected in zip(native, function.call(values), strict=True):
        _check_equal(
            result, np.array(expected).ravel("F"), f"values of '{name}'", "its expressions"
        )


def _check_equal(result: Array, expected: Array, name: str, reference: str) -> None:
    """Check that results equal the expected values where these are finite.

    Raises:
        BuildError: They differ.
    """
    known = np.isfinite(expected)
    difference = np.abs(result - expected)[:, known].max(initial=0.0)
    if not difference <= _CLOSE * (1.0 + np.abs(expected[known]).max(initial=0.0)):
        raise BuildError(f"compiled {name} differ by {difference:.3g} from {reference}")


def random_state(system: System, rng: np.random.Generator) -> State:
    """Return a random state of the integrated coordinates."""
    robot, internals = system.robot, system.internals
    z = internals.inside(np.nan_to_num(internals.initial))
    y = system.reduce(State(0.0, robot.neutral(), np.zeros(system.model.nv), z))
    y = system.chart.plus(y, rng.normal(0.0, _SPREAD, 2 * system.nv + internals.nz))
    return y._replace(z=internals.inside(y.z))


def _mode(exact: Any, rng: np.random.Generator) -> Mode:
    """Return a random mode: rows only at finite bounds, contacts in any of their modes."""
    upper = exact.solver.constraints.upper.tolist()
    entries = zip(rng.integers(-1, 2, len(upper)).tolist(), upper, strict=True)
    mode = [abs(entry) if np.isinf(bound) else entry for entry, bound in entries]
    for i in () if exact.contacts is None else exact.contacts.normals:
        names = ((mode[i],) * 2, (mode[i],) * 2, (3, -1), (-15, 5), (2**51 + 1, 2**52 + 1))
        mode[i + 1 : i + 3] = names[0 if mode[i] else rng.integers(len(names))]
    return tuple(mode)


def random_inputs(system: System, t: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random inputs for the plain tier, and these inputs completed by sources."""
    sources = system.loads.sources
    u = sources.hold(t)
    if u is None:
        u = system.loads.idle + rng.uniform(0.0, 0.5, len(system.loads.idle))
    return u, sources.complete(u, t)


def plain_rates(system: System, y: State, u: Array) -> Array:
    """Return accelerations, then rates of internal states, shape (nv + nz,)."""
    a, zdot = np.zeros(system.nv), np.zeros(len(y.z))
    accelerate = system.accelerator(y.mode)
    if len(y.z):
        accelerate(y.t, y.q, y.v, y.z, u, a, zdot)
    else:
        accelerate(y.t, y.q, y.v, u, a)
    return np.concatenate((a, zdot))
