"""Dirac brackets of a scene: `mbd-ros bracket`."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.rows.constraint_rows import independent
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import is_of_particles

if TYPE_CHECKING:
    from mbd_ros.features.dirac_brackets.dirac_bracket import DiracBracket

CHECKS = "checks"
_MOST = 30  # coordinates of a scene
_PRINTED = 8  # coordinates up to which a table is printed
_CHECKED = 12  # coordinates up to which Jacobi's identity is checked
_WRITTEN = 4  # coordinates up to which expressions are printed by default
_LONG = 160  # characters of an expression that is printed by default


def bracket(scene: Any, *, symbolic: bool | None = None, say: Say | None = None) -> Result:
    """Compute the Dirac brackets of the coordinates and momenta of a scene at its start.

    Args:
        scene: Particles, or a mechanism without free bodies, whose constraints all restrict
            positions.
        symbolic: Also print expressions, however long. By default those of up to four
            coordinates are printed, unless they are long.
        say: Called with each line for people; without it the lines go to `metadata["remarks"]`.

    Returns:
        Table `samples`: {row, column}_D, whose rows and columns are the coordinates, then their
        momenta `p_<name>`. Table `checks`: the largest bracket with a constraint or its rate,
        which are Casimirs; the motion by the bracket less the motion by multipliers; with up to
        twelve coordinates the violation of Jacobi's identity.

    Raises:
        SceneError: The scene has no brackets; the message says why.
    """
    remarks: list[str] = []
    tell, space = say or remarks.append, phase_space(scene)
    dirac, p = space.bracket, space.momentum
    table, names = dirac.table(space.q, p), _all_names(space.names)
    by_bracket, by_multipliers = space.motion()
    difference = float(np.abs(by_bracket - by_multipliers).max())
    checks = {"casimirs": dirac.casimirs(space.q, p), "motion": difference}
    if dirac.n <= _CHECKED:
        checks["jacobi_identity"] = dirac.jacobi(space.q, p)
    tell(f"{scene.name}: {dirac.n} coordinates, {dirac.m} independent constraints")
    for line in _lines(table, names, checks):
        tell(line)
    if symbolic or (symbolic is None and dirac.n <= _WRITTEN):
        written = dirac.expressions(space.names)
        short = {k: text for k, text in written.items() if symbolic or len(text) <= _LONG}
        for (a, b), text in short.items():
            tell(f"  {{{a}, {b}}} = {text}")
        if len(short) < len(written):
            tell(f"  {len(written) - len(short)} longer expressions: --symbolic shows them")
    columns = [Column(name, table[:, j]) for j, name in enumerate(names)]
    tables = {
        MAIN: Table(columns),
        CHECKS: Table([Column(name, np.array([value])) for name, value in checks.items()]),
    }
    metadata = metadata_of("bracket", scene, {"variables": list(names)}, {})
    return Result(tables, metadata | ({} if say else {"remarks": remarks}))


def _all_names(names: Sequence[str]) -> tuple[str, ...]:
    return (*names, *(f"p_{name}" for name in names))


def _lines(table: Array, names: Sequence[str], checks: dict[str, float]) -> Iterator[str]:
    titles = {"casimirs": "Casimirs", "motion": "motion by multipliers less that by the bracket"}
    titles["jacobi_identity"] = "Jacobi's identity"
    yield "largest violations: " + ", ".join(f"{titles[k]} {v:.2g}" for k, v in checks.items())
    n = len(names) // 2
    if n > _PRINTED:
        return
    wide = max(max(map(len, names)), 10)
    for title, rows in (("{q, p}", range(n)), ("{p, p}", range(n, 2 * n))):
        yield f"{title:<{wide}}  " + "  ".join(f"{name:>{wide}}" for name in names[n:])
        for i in rows:
            cells = "  ".join(f"{value:>{wide}.6g}" for value in table[i, n:] + 0.0)
            yield f"{names[i]:<{wide}}  {cells}"


class PhaseSpace(NamedTuple):
    """Coordinates and momenta of a scene, and its brackets.

    Attributes:
        names: Names of the coordinates.
        bracket: The brackets as functions of the state.
        q: Configuration at the start, shape (n,).
        v: Velocities at the start, along the constraints, shape (n,).
        system: The system, whose `applied` gives the forces on the coordinates.
        a: Accelerations at the start by multipliers, shape (n,).
    """

    names: tuple[str, ...]
    bracket: "DiracBracket"
    q: Array
    v: Array
    system: Any
    a: Array

    @property
    def momentum(self) -> Array:
        """Momentum M v, shape (n,)."""
        return self.bracket.momentum(self.q, self.v)

    def motion(self) -> tuple[Array, Array]:
        """Return the rates of (q, p) by the bracket and by multipliers, shape (2 n,) each."""
        rate = self.bracket.mass_rate(self.q, self.v)
        force = self.system.applied(0.0, self.q, self.v) + rate
        table = self.bracket.table(self.q, self.momentum)
        by_bracket = table.dot(np.concatenate((-force, self.v)))
        mass = self.system.mass(self.q)
        return by_bracket, np.concatenate((self.v, mass.dot(self.a) + rate))


def phase_space(scene: Any) -> PhaseSpace:
    """Return coordinates, momenta and brackets of a scene.

    Raises:
        SceneError: The scene has no brackets; the message says why.
    """
    return _of_particles(scene) if is_of_particles(scene) else _of_mechanism(scene)


def _of_mechanism(scene: Scene) -> PhaseSpace:
    from mbd_ros.compiled.symbols.untraceable import Untraceable
    from mbd_ros.features.dirac_brackets.dirac_bracket import of_mechanism
    from mbd_ros.scene.runs.compiling import traced

    _refuse(scene)
    system = scene.system()
    names = scene.couplings.independent
    if not system.chart.is_flat or system.nq != system.nv:
        raise SceneError(f"{scene.name}: quaternions of free bodies have no canonical momenta")
    if len(system.bilateral.rows) != len(system.rows):
        raise SceneError(
            f"{scene.name}: nonholonomic constraints have no brackets; accepted are holonomic ones"
        )
    _refuse_many(scene.name, names)
    y = assemble(system, system.reduce(scene.initial))
    if np.abs(system.rate(0.0, y.q)).max(initial=0.0) > 0.0:
        raise SceneError(f"{scene.name}: constraints that depend on time have no brackets")
    rows = independent(system.jacobian(0.0, y.q)) if system.rows else []
    try:
        dirac = of_mechanism(traced(scene, system), rows)
    except Untraceable as error:
        raise SceneError(f"{scene.name}: {error}") from error
    projection = dirac.table(y.q, np.zeros(dirac.n))[: dirac.n, dirac.n :]
    y = y._replace(v=projection.dot(y.v))
    a = system.integrated(system.evaluate(system.expand(y)).a)
    return PhaseSpace(tuple(names), dirac, y.q, y.v, system, a)


def _of_particles(scene: Any) -> PhaseSpace:
    from mbd_ros.features.dirac_brackets.dirac_bracket import of_particles

    system, x = scene.system(), scene.initial
    names = tuple(f"{name}.{axis}" for name in system.names for axis in "xyz")
    _refuse_many(scene.name, names)
    dirac = of_particles(system, independent(system.jacobian(0.0, x.q)))
    return PhaseSpace(names, dirac, x.q, x.v, system, system.accelerations(x.q, x.v)[0])


def _refuse(scene: Scene) -> None:
    if scene.phases or scene.parts.get("contacts"):
        section = "phases" if scene.phases else "contacts"
        raise SceneError(f"{scene.name}: {section}: brackets exist for bilateral constraints only")
    for part in scene.constraints:
        if not part.law.is_rigid:
            raise SceneError(
                f"{scene.name}: {part.name}: brackets exist for bilateral constraints only"
            )
    for part in (*scene.actuators, *scene.forces, *scene.muscles):
        if part.internal:
            raise SceneError(f"{scene.name}: {part.name}: internal states have no brackets")


def _refuse_many(name: str, names: Sequence[str]) -> None:
    if not 0 < len(names) <= _MOST:
        raise SceneError(f"{name}: has {len(names)} coordinates, brackets accept 1 .. {_MOST}")
