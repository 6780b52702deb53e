"""Error against run time of every way to integrate a scene."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec
from mbd_ros.applications.report.precision.converged import known
from mbd_ros.applications.report.precision.ladders import climb, families, planned
from mbd_ros.applications.report.precision.rattle_check import approach
from mbd_ros.applications.report.precision.text import compose
from mbd_ros.applications.report.subjects import Subject, failures, is_own, subjects
from mbd_ros.errors import MbdError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

_REFERENCE = "reference"


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """One item a scene and family of integrators, and one for the motion itself."""
    found = []
    for subject in subjects(scenes, quick):
        scene = load_scene(subject.path)
        found.append(_item(scene, subject, _REFERENCE, quick))
        found += [_item(scene, subject, name, quick) for name in families(scene, quick)]
    return found


def run(spec: Spec) -> Outcome:
    """The runs of one family on one scene, or how well its motion is known."""
    scene, times = load_scene(spec["scene"]), tuple(spec["times"])
    try:
        motion = known(spec["scene"], times)
        if spec["family"] != _REFERENCE:
            return {"runs": climb(scene, spec["family"], motion, spec["quick"])}
        checked = approach(scene, motion)
    except MbdError as error:
        return {"failed": f"{type(error).__name__}: {error}"}
    return {
        "method": motion.method,
        "check": motion.check,
        "agreement": motion.agreement if motion.check else None,
        "published": motion.published,
        "rattle": checked.text,
        "wrong": _wrong(motion.is_wrong, motion.published, checked.is_wrong, checked.text),
    }


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """One plot, table and choice a scene."""
    scenes: dict[str, dict[str, Any]] = {}
    for item, outcome in outcomes:
        entry = scenes.setdefault(
            item.name.split(".")[0],
            {"times": item.spec["times"], "runs": [], "own": is_own(item.spec["scene"])},
        )
        if item.spec["family"] == _REFERENCE:
            entry["reference"] = outcome
        elif "failed" in outcome:
            entry["failed"] = outcome["failed"]
        else:
            entry["runs"] += outcome["runs"]
    section = compose(scenes)
    return section._replace(wrong=[*failures(outcomes), *section.wrong])


def _item(scene: Scene, subject: Subject, family: str, quick: bool) -> Item:
    spec: Mapping[str, Any] = {
        "scene": subject.path,
        "times": list(subject.times),
        "family": family,
        "quick": quick,
    }
    name = f"{subject.name.replace('.', '_')}.{family}"
    is_timed = family != _REFERENCE
    seconds = planned(scene, family, quick) if is_timed else 3.0
    return Item("precision", name, spec, seconds, is_timed)


def _wrong(is_off: bool, published: float | None, is_astray: bool, text: str) -> list[str]:
    lines = []
    if is_off:
        lines.append(f"converged motion is {published:.1e} off the published one")
    if is_astray:
        lines.append(f"accelerations lead to another motion than impulses: {text}")
    return lines
