"""Which scenes a report measures, and for how long they run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mbd_ros.report.precision.reference_problems import PROBLEMS, SCENES, reference

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


class Subject(NamedTuple):
    """A scene and the times at which its motion is compared [s]."""

    name: str
    path: str
    times: tuple[float, ...]


def subjects(scenes: Sequence[str], quick: bool) -> list[Subject]:
    """Those of a user, or all of ours."""
    if scenes:
        return [_subject(path, quick) for path in scenes]
    if quick:
        return [_subject(f"{SCENES}/{name}.yaml", True) for name in (*_QUICK, _MORE[2])]
    problems = [_subject(problem.scene, False) for problem in PROBLEMS]
    more = [f"{SCENES}/{name}.yaml" for name in _MORE]
    return [*problems, *(_subject(path, False) for path in (*more, *_LEGS))]


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
