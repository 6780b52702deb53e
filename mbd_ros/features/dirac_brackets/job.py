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
_SHOWN = 8  # coordinates up to which a table is shown to people
_CHECKED = 12  # coordinates up to which Jacobi's identity is checked
_WRITTEN = 4  # coordinates up to which expressions are told unasked
_LONG = 160  # characters of an expression that nobody asked for


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
    found, p = space.bracket, space.momentum
    table, names = found.table(space.q, p), _all_names(space.names)
    one, other = space.motion()
    checks = {"casimirs": found.casimirs(space.q, p), "motion": float(np.abs(one - other).max())}
    if found.n <= _CHECKED:
        checks["jacobi_identity"] = found.jacobi(space.q, p)
    tell(f"{scene.name}: {found.n} coordinates, {found.m} independent rows")
    for line in _lines(table, names, checks):
        tell(line)
    if symbolic or (symbolic is None and found.n <= _WRITTEN):
        written = found.expressions(space.names)
        kept = {k: text for k, text in written.items() if symbolic or len(text) <= _LONG}
        for (a, b), text in kept.items():
            tell(f"  {{{a}, {b}}} = {text}")
        if len(kept) < len(written):
            tell(f"  {len(written) - len(kept)} longer expressions: --symbolic shows them")
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
    words = {"casimirs": "Casimirs", "motion": "motion by multipliers less that by the bracket"}
    words["jacobi_identity"] = "Jacobi's identity"
    yield "largest violations: " + ", ".join(f"{words[k]} {v:.2g}" for k, v in checks.items())
    n = len(names) // 2
    if n > _SHOWN:
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
        names: Of the coordinates.
        q: The start, shape (n,).
        v: Its velocities along the rows.
        system: The system; `applied` gives forces on the coordinates.
        a: Accelerations there by multipliers.
    """

    names: tuple[str, ...]
    bracket: "DiracBracket"
    q: Array
    v: Array
    system: Any
    a: Array

    @property
    def momentum(self) -> Array:
        """M v, shape (n,)."""
        return self.bracket.momentum(self.q, self.v)

    def motion(self) -> tuple[Array, Array]:
        """Rates of (q, p), by the bracket with the energy and by multipliers, each (2 n,)."""
        rate = self.bracket.mass_rate(self.q, self.v)
        force = self.system.applied(0.0, self.q, self.v) + rate
        table = self.bracket.table(self.q, self.momentum)
        by_bracket = table.dot(np.concatenate((-force, self.v)))
        mass = self.system.mass(self.q)
        return by_bracket, np.concatenate((self.v, mass.dot(self.a) + rate))


def phase_space(scene: Any) -> PhaseSpace:
    """Coordinates, momenta and brackets of a scene.

    Raises:
        SceneError: The scene has no brackets; says why.
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
        raise SceneError(f"{scene.name}: rows of velocities have no brackets: holonomic rows have")
    _refuse_many(scene.name, names)
    y = assemble(system, system.reduce(scene.initial))
    if np.abs(system.rate(0.0, y.q)).max(initial=0.0) > 0.0:
        raise SceneError(f"{scene.name}: rows that move with time have no brackets")
    kept = independent(system.jacobian(0.0, y.q)) if system.rows else []
    try:
        found = of_mechanism(traced(scene, system), kept)
    except Untraceable as error:
        raise SceneError(f"{scene.name}: {error}") from error
    along = found.table(y.q, np.zeros(found.n))[: found.n, found.n :]
    y = y._replace(v=along.dot(y.v))
    a = system.integrated(system.evaluate(system.expand(y)).a)
    return PhaseSpace(tuple(names), found, y.q, y.v, system, a)


def _of_particles(scene: Any) -> PhaseSpace:
    from mbd_ros.features.dirac_brackets.dirac_bracket import of_particles

    system, x = scene.system(), scene.initial
    names = tuple(f"{name}.{axis}" for name in system.names for axis in "xyz")
    _refuse_many(scene.name, names)
    found = of_particles(system, independent(system.jacobian(0.0, x.q)))
    return PhaseSpace(names, found, x.q, x.v, system, system.accelerations(x.q, x.v)[0])


def _refuse(scene: Scene) -> None:
    if scene.phases or scene.parts.get("contacts"):
        what = "phases" if scene.phases else "contacts"
        raise SceneError(f"{scene.name}: {what}: brackets are those of bilateral rows")
    for part in scene.constraints:
        if not part.law.is_rigid:
            raise SceneError(f"{scene.name}: {part.name}: brackets are those of bilateral rows")
    for part in (*scene.actuators, *scene.forces, *scene.muscles):
        if part.internal:
            raise SceneError(f"{scene.name}: {part.name}: internal states have no brackets")


def _refuse_many(name: str, names: Sequence[str]) -> None:
    if not 0 < len(names) <= _MOST:
        raise SceneError(f"{name}: {len(names)} coordinates, brackets serve 1 .. {_MOST}")
