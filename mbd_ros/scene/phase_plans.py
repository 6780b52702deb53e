"""Phases of a motion by names: what holds in each, what ends it, and what is reset then."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import NotNegative, Unit


@dataclass(frozen=True)
class WhenEntry:
    """Where a guard acts: a sum of joint positions times factors beyond a level."""

    joint: str | None = None
    joints: Mapping[str, float] | None = None
    above: float | None = None
    below: float | None = None


@dataclass(frozen=True)
class ResetEntry:
    """The instantaneous change at the end of a phase: an impact, then a relabelling of joints."""

    impact: Sequence[str] | None = None
    exchange: Mapping[str, Any] | None = None
    relabel: Mapping[str, Mapping[str, float]] | None = None
    shift: Mapping[str, float] | None = None


@dataclass(frozen=True)
class GuardEntry:
    """The event that ends a phase."""

    touch_down: str | None = None
    lift_off: str | None = None
    slip: str | None = None
    tip: str | None = None
    joint: str | None = None
    joints: Mapping[str, float] | None = None
    force: str | None = None
    multiplier: str | None = None
    time: Annotated[NotNegative, Unit("s")] | None = None
    at: float = 0.0
    direction: Literal["up", "down", "both"] | None = None
    when: Mapping[str, Any] | None = None
    then: str | None = None
    reset: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class GuardPlan:
    """A guard by names.

    Attributes:
        name: Unique in the phase.
        entry: What it looks at.
        when: Where it acts; None for everywhere.
        then: Name of the next phase.
        reset: What happens at once.
        where: File and key, for the messages.
    """

    name: str
    entry: GuardEntry
    when: WhenEntry | None
    then: str
    reset: ResetEntry
    where: str


@dataclass(frozen=True)
class PhasePlan:
    """A phase by names, which `phased_systems` makes a system of.

    Attributes:
        name: Unique in the scene.
        contacts: Names of the contacts that are on.
        keeps_closed: Whether these stay closed (the key `held`).
        constraints: Names of the constraints that are on; None for all.
        couplings: Dependent joints that are; None for all.
        guards: What ends it, in the order of the file.
        limit: Longest time in it [s]; None without one.
        where: File and key, for the messages.
    """

    name: str
    contacts: tuple[str, ...]
    keeps_closed: bool
    constraints: tuple[str, ...] | None
    couplings: tuple[str, ...] | None
    guards: tuple[GuardPlan, ...]
    limit: float | None
    where: str

    @property
    def summary(self) -> str:
        """Guards and the phases that follow, as text."""
        return ", ".join(f"{guard.name} -> {guard.then}" for guard in self.guards)

    @property
    def on(self) -> str:
        """Active contacts as text."""
        how = "held" if self.keeps_closed else "open or closed"
        return f"{how}: {', '.join(self.contacts)}" if self.contacts else "no contact"
