"""Choices for a scene: formulation, stabilization, integrator, step."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from mbd_ros.core.dynamics.tiers import TIERS
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene

BAUMGARTE = {"type": "baumgarte", "time_constant": 0.02}
STABILIZATIONS: tuple[Mapping[str, Any], ...] = (
    {"type": "projection"},
    BAUMGARTE,
    {"type": "none"},
)
WANTED = (1.0e-3, 1.0e-6, 1.0e-9)  # errors for which a choice is offered [rad or m]
COMPILED = "compiled"  # the plain tier in native code
KEEPERS = ("rattle", "shake", "generalized_alpha")  # keep rows themselves


class Choice(NamedTuple):
    """One way to integrate a scene.

    Attributes:
        solver: A tier of `mbd_ros.core.dynamics.tiers`, `plain` for the cheapest, `compiled` for
            the cheapest in native code.
        stabilization: Its entry; None where there is nothing to stabilize.
        integrator: Its entry.
        dt: Step, or with a tolerance longest first step [s].
    """

    solver: str
    stabilization: Mapping[str, Any] | None
    integrator: Mapping[str, Any]
    dt: float

    @property
    def method(self) -> str:
        """Name of the integrator with the option that separates it from its relatives."""
        more = [f"{k} {v}" for k, v in self.integrator.items() if k in ("order", "stages")]
        return " ".join([self.integrator["type"], *more])

    @property
    def fineness(self) -> str:
        """Tolerance or step."""
        tolerance = self.integrator.get("tolerance")
        return f"dt {self.dt:g} s" if tolerance is None else f"tolerance {tolerance:g}"

    def build(self, scene: Scene) -> Simulation:
        """The simulation of a scene that is chosen."""
        return scene.simulation(
            integrator=self.integrator,
            dt=self.dt,
            stabilization=self.stabilization,
            solver={"type": self.solver},
        )


def of_record(record: Mapping[str, Any]) -> Choice:
    """The choice that a result was made with."""
    return Choice(*(record[key] for key in Choice._fields))


def snippet(choice: Choice) -> str:
    """Lines to be pasted into a scene file."""
    lines = [f"integrator: {_entry(choice.integrator)}", f"dt: {_number(choice.dt)}"]
    if choice.stabilization is not None:
        lines.insert(0, f"stabilization: {_entry(choice.stabilization)}")
    if choice.solver != "plain":
        lines.insert(0, f"solver: {{type: {choice.solver}}}")
    return "\n".join(lines)


def formulations(scene: Scene) -> list[str]:
    """`plain` and the tiers that solve the scene differently."""
    seen, names = {_signature(scene, "plain")}, ["plain"]
    for name in TIERS[1:]:
        try:
            signature = _signature(scene, name)
        except SceneError:
            continue
        if signature not in seen:
            seen.add(signature)
            names.append(name)
    return names


def compiles(scene: Scene, integrator: Mapping[str, Any]) -> bool:
    """Whether `auto` takes compiled steps; not where extra or compiler are missing."""
    simulation = scene.simulation(integrator=integrator, solver={"type": "auto"})
    return simulation.how.startswith(COMPILED)


def stabilizations(scene: Scene, solver: str, kind: str) -> Sequence[Mapping[str, Any] | None]:
    """Those that make a difference with a tier and an integrator, the usual one first."""
    has_rows = bool(scene.system(solver={"type": solver}).rows)
    return STABILIZATIONS if has_rows and kind not in KEEPERS else (None,)


def _signature(scene: Scene, solver: str) -> tuple[type, int, bool]:
    system = scene.system(solver={"type": solver})
    return system.tier, len(system.rows), system.bounded is not None


def _entry(entry: Mapping[str, Any]) -> str:
    values = {k: _number(v) if isinstance(v, float) else str(v) for k, v in entry.items()}
    return f"{{{', '.join(f'{k}: {v}' for k, v in values.items())}}}"


def _number(value: float) -> str:
    return f"{value:g}"
