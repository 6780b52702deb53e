"""Section `phases`: what holds in each phase, what ends it, and what is reset then."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from mbd_ros.core.ranges import Positive, Unit
from mbd_ros.errors import SceneError
from mbd_ros.scene.phase_plans import GuardEntry, GuardPlan, PhasePlan, ResetEntry, WhenEntry
from mbd_ros.scene.reading.building import Site, checked_name
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.nearest import nearest

MAX_PHASES = 200  # each is a system of its own
_OF_CONTACTS = ("lift_off", "slip", "tip", "force")  # that are held
_KINDS = ("touch_down", *_OF_CONTACTS, "joint", "joints", "multiplier", "time")


@dataclass(frozen=True)
class _PhaseEntry:
    contacts: Sequence[str] = ()
    held: bool = True
    constraints: Sequence[str] | None = None
    couplings: Sequence[str] | None = None
    until: Mapping[str, Any] = field(default_factory=dict)
    then: str | None = None
    reset: Mapping[str, Any] | None = None
    limit: Annotated[Positive, Unit("s")] | None = None


def build_phases(site: Site, entries: Any) -> dict[str, PhasePlan]:
    """The `phases` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    phases = schema.value(entries, Mapping[str, Any], site.where)
    if len(phases) > MAX_PHASES:
        raise SceneError(f"{site.where}: {len(phases)} phases, accepted are {MAX_PHASES}")
    names = _Names(site, tuple(phases))
    return {name: _phase(names, name, entry) for name, entry in phases.items()}


class _Names:
    """Names of a scene that phases may use.

    Args:
        site: Where the section is built.
        phases: Names of all phases.
    """

    def __init__(self, site: Site, phases: Sequence[str]) -> None:
        self.site, self.phases = site, phases
        self.contacts = [part.name for part in site.parts.get("contacts", ())]
        self.rigid = [p.name for p in site.parts.get("contacts", ()) if p.is_constraint]
        self.stateful = [p.name for p in site.parts.get("contacts", ()) if p.internal]
        self.constraints = [part.name for part in site.parts.get("constraints", ())]
        self.dependent = list(site.parts["couplings"].dependent)
        assert site.robot is not None
        self.joints = [joint.name for joint in site.robot.joints]


def known(name: Any, names: Collection[str], what: str, where: str) -> str:
    """A name that exists.

    Args:
        name: What was given.
        names: Those that exist.
        what: What they name.
        where: File and key, for the messages.

    Raises:
        SceneError: It does not; names those that are near, or all.
    """
    word = str(schema.value(name, str, where))
    if word not in names:
        there = ", ".join(nearest(word, names) or names) or "none"
        raise SceneError(f"{where}: unknown {what} '{word}', there are: {there}")
    return word


def _listed(
    listed: Sequence[str] | None, names: Collection[str], what: str, where: str
) -> tuple[str, ...] | None:
    if listed is None:
        return None
    return tuple(known(name, names, what, f"{where}[{i}]") for i, name in enumerate(listed))


def _phase(names: _Names, name: str, value: Any) -> PhasePlan:
    where = f"{names.site.where}.{name}"
    checked_name(name, where)
    entry: _PhaseEntry = schema.call(_PhaseEntry, value, where)
    accepted = names.rigid if entry.held else names.contacts
    contacts = _listed(entry.contacts, names.contacts, "contact", f"{where}.contacts") or ()
    for contact in contacts:
        if contact in names.stateful:
            raise SceneError(
                f"{where}.contacts: {contact} has internal states and acts in every phase; "
                "accepted: friction with creep instead of bristles"
            )
        if contact not in accepted:
            raise SceneError(
                f"{where}.contacts: {contact} is compliant and cannot be held; "
                "accepted: held: false"
            )
    if not entry.until:
        raise SceneError(
            f"{where}: no guard ends it; accepted: until: {{NAME: {{touch_down: CONTACT}}}} and "
            f"then: PHASE, with one of {', '.join(_KINDS)}"
        )
    guards = tuple(_guard(names, entry, contacts, where, *pair) for pair in entry.until.items())
    return PhasePlan(
        name,
        contacts,
        entry.held,
        _listed(entry.constraints, names.constraints, "constraint", f"{where}.constraints"),
        _listed(entry.couplings, names.dependent, "dependent joint", f"{where}.couplings"),
        guards,
        entry.limit,
        where,
    )


def _guard(
    names: _Names, phase: _PhaseEntry, on: Collection[str], where: str, name: str, value: Any
) -> GuardPlan:
    key = f"{where}.until.{name}"
    checked_name(name, key)
    entry: GuardEntry = schema.call(GuardEntry, value, key)
    chosen = [kind for kind in _KINDS if getattr(entry, kind) is not None]
    if len(chosen) != 1:
        raise SceneError(
            f"{key}: expected one of {', '.join(_KINDS)}, got {', '.join(chosen) or 'none'}"
        )
    kind = chosen[0]
    if kind == "touch_down":
        known(entry.touch_down, names.contacts, "contact", f"{key}.touch_down")
    elif kind in _OF_CONTACTS:
        closed = on if phase.held else ()
        known(getattr(entry, kind), closed, "contact that is held", f"{key}.{kind}")
    _joints(names, entry, key)
    when: WhenEntry | None = None
    if entry.when is not None:
        when = schema.call(WhenEntry, entry.when, f"{key}.when")
        _joints(names, when, f"{key}.when")
        if (when.above is None) == (when.below is None):
            raise SceneError(f"{key}.when: expected one of above, below")
        if (when.joint is None) == (when.joints is None):
            raise SceneError(f"{key}.when: expected one of joint, joints")
    then = entry.then if entry.then is not None else phase.then
    if then is None:
        raise SceneError(f"{key}: key 'then' is missing, there and in {where}: the next phase")
    then = known(then, names.phases, "phase", f"{key}.then")
    reset = entry.reset if entry.reset is not None else phase.reset
    return GuardPlan(name, entry, when, then, _reset(names, reset, f"{key}.reset"), key)


def _joints(names: _Names, entry: Any, where: str) -> None:
    if entry.joint is not None:
        known(entry.joint, names.joints, "joint", f"{where}.joint")
    for name in entry.joints or ():
        known(name, names.joints, "joint", f"{where}.joints")
    if entry.joints is not None and not entry.joints:
        raise SceneError(f"{where}.joints: no joint; accepted: {{JOINT: factor, ..}}")


def _reset(names: _Names, value: Any, where: str) -> ResetEntry:
    entry: ResetEntry = schema.call(ResetEntry, {} if value is None else value, where)
    _listed(entry.impact, names.rigid, "rigid contact", f"{where}.impact")
    for name in entry.shift or ():
        known(name, names.joints, "joint", f"{where}.shift")
    return entry
