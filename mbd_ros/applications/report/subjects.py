"""The scenes that a report measures, and their time spans."""

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mbd_ros.applications.report.items import Item
from mbd_ros.applications.report.precision.reference_problems import PROBLEMS, SCENES, reference

_MORE = ("arm7_swing", "arm7_release", "arm7_swing_coupled")
_LEGS = tuple(
    f"package://mbd_ros/config/scenes/{n}.yaml" for n in ("four_bar_leg", "prosthetic_leg")
)
_SPANS: Mapping[str, float] = {  # s; the other problems run to their last sample
    "a01_pendulum": 5.0,
    "a01_pendulum_maximal": 3.0,
    "a02_four_bars_2": 2.0,
    "a02_four_bars_40": 0.5,
    "a04_bricard": 2.0,
    "a05_governor": 0.5,
    "p01_spherical_pendulum": 5.0,
    "ts_car_axis": 1.0,
    "x01_light_outer": 2.0,
    "x01_light_inner": 0.9,
    "x06_chain": 0.2,
    "x07_light_tip": 1.5,
    "x08_elastic_1e6": 0.5,
    "x08_elastic_1e8": 0.2,
    "x11_fast_pendulum": 0.2,
}
_QUICK = ("a01_pendulum_maximal", "x08_elastic_1e4")
_OWN, _OWN_QUICK = 1.0, 0.2  # s, scenes without a published motion
_SAMPLES = 5
_LONGEST = 60  # characters of a name


class Subject(NamedTuple):
    """A scene and the times at which its motion is compared [s].

    Attributes:
        name: Letters, digits, `_` and `-` (those of this package: and `.`), unique.
        times: Increasing, > 0 [s].
    """

    name: str
    path: str
    times: tuple[float, ...]


def subjects(scenes: Sequence[str], quick: bool) -> list[Subject]:
    """Those of a user, or all of ours."""
    if scenes:
        chosen = [_subject(path, quick) for path in scenes]
        names = _unique([_safe(subject.name) for subject in chosen])
        return [s._replace(name=name) for s, name in zip(chosen, names, strict=True)]
    if quick:
        return [_subject(f"{SCENES}/{name}.yaml", True) for name in (*_QUICK, _MORE[2])]
    problems = [_subject(problem.scene, False) for problem in PROBLEMS]
    more = [f"{SCENES}/{name}.yaml" for name in _MORE]
    return [*problems, *(_subject(path, False) for path in (*more, *_LEGS))]


def is_own(path: str) -> bool:
    """Whether a scene is one of this package, with which everything must work."""
    return path.startswith("package://mbd_ros/")


def failures(outcomes: Iterable[tuple[Item, Mapping[str, Any]]]) -> list[str]:
    """Why a report fails: what stopped on a scene of this package."""
    return [
        f"{item.name}: {outcome['failed']}"
        for item, outcome in outcomes
        if "failed" in outcome and is_own(item.spec["scene"])
    ]


def _safe(name: str) -> str:
    """A name that can be part of any file name: Prufstand of Prüfstand, my_leg of `my leg`."""
    letters = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9_-]+", "_", letters)[:_LONGEST].strip("_") or "scene"


def _unique(names: Sequence[str]) -> list[str]:
    """The same names, with a running number where one comes again, in whatever case."""
    unique: list[str] = []
    for name in names:
        taken, number, tried = {one.lower() for one in unique}, 1, name
        while tried.lower() in taken:
            number += 1
            tried = f"{name}_{number}"
        unique.append(tried)
    return unique


def _subject(path: str, quick: bool) -> Subject:
    stem = Path(path).stem
    problem = next((p for p in PROBLEMS if p.name == stem and "/benchmark/" in path), None)
    if problem is None:
        span = _OWN_QUICK if quick else _OWN
        steps = range(1, _SAMPLES + 1)
        return Subject(stem, path, tuple(round(span * k / _SAMPLES, 9) for k in steps))
    times = reference(problem.reference).times
    span = _SPANS.get(stem, float(times[-1]))
    chosen = [float(t) for t in times if t <= span]
    return Subject(stem, path, tuple(chosen[:2] if quick else chosen))
