"""Error against run time: the runs that are worth their time, and a picture of all.

The picture is for a phone and for print. Its colours are those of Okabe and Ito, which
colour-blind people tell apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any, NamedTuple

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

# Colours of Okabe and Ito, which colour-blind people tell apart; greys are methods of order 1 and
# 2, vermilion is for peers, yellow for the front.
_LOOKS = {  # integrator -> colour, marker
    "semi_implicit_euler": ("#999999", "v"),
    "rk4": ("#E69F00", "^"),
    "adams": ("#009E73", "s"),
    "dopri5": ("#56B4E9", "D"),
    "dop853": ("#0072B2", "o"),
    "filippov": ("#CC79A7", "p"),
    "gauss_legendre": ("#CC79A7", "P"),
    "generalized_alpha": ("#000000", "X"),
    "rattle": ("#555555", "<"),
    "shake": ("#555555", ">"),
    "moreau_jean": ("#009E73", "d"),
}
_PEER, _PEER_MARKERS, _FRONT = "#D55E00", "*hdp", "#F0E442"
_SIZE = (6.2, 6.2)  # inches: below the width from which a page pans instead of scaling
_FONT = 12  # points: 9 pixels where the picture is 330 wide
_WORST = 10.0  # [rad or m]: what is worse needs no room
_LINE: Mapping[str, Any] = {"ms": 6.5, "lw": 1.4}
_PEER_LINE: Mapping[str, Any] = {"color": _PEER, "ms": 9, "lw": 1.4, "ls": "-."}
_DOTS: Mapping[str, Any] = {"marker": ".", "ms": 4, "lw": 0}
_RINGS: Mapping[str, Any] = {"marker": "o", "ms": 11.5}


class Point(NamedTuple):
    """Cost [any unit, > 0] and error [any unit, > 0] of a run."""

    cost: float
    error: float


def front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other one beats in both, from cheap to precise.

    Args:
        points: Any order; those that are not finite and positive are never on the front.
    """
    usable = [i for i, p in enumerate(points) if all(math.isfinite(x) and x > 0 for x in p)]
    best: list[int] = []
    for i in sorted(usable, key=lambda i: points[i]):
        if not best or points[i].error < points[best[-1]].error:
            best.append(i)
    return best


def cheapest(points: Sequence[Point], error: float) -> int | None:
    """Index of the cheapest run that is as precise as wanted; None where none is."""
    good = [i for i in front(points) if points[i].error <= error]
    return min(good, key=lambda i: points[i].cost, default=None)


def cost_at(points: Sequence[Point], error: float) -> float | None:
    """Cost of an error on the front, between two runs by a power law.

    Returns:
        None where no run is as precise; the cost of the cheapest run where that is more precise
        than wanted, since nothing is known of cheaper ones.
    """
    best = [points[i] for i in front(points)]
    for k, (cost, reached) in enumerate(best):
        if reached <= error:
            if k == 0:
                return cost
            before = best[k - 1]
            share = math.log(before.error / error) / math.log(before.error / reached)
            return before.cost * (cost / before.cost) ** share
    return None


def diagram(
    title: str,
    runs: Sequence[Mapping[str, Any]],
    points: Sequence[Point],
    peers: Mapping[str, Sequence[Point]] | None = None,
) -> Figure:
    """Position error over CPU time, log-log, with the Pareto front marked.

    A line is the front of one integrator, all its orders together, with the formulation and
    stabilization that the scene has by itself. All other runs are dots, or symbols without a line
    where they are on the front of all.

    Args:
        title: Above the picture.
        runs: Records of runs.
        points: Their cost [ms per simulated s] and error.
        peers: Name of another package -> its runs; their line is their front.
    """
    figure = Figure(figsize=_SIZE, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    best = [points[i] for i in front(points)]
    axes.plot(*_columns(best), color=_FRONT, lw=9, **_RINGS, mew=0, zorder=1)
    axes.plot(*_columns(best), color="black", lw=0, **_RINGS, mew=0.7, fillstyle="none")
    _integrators(axes, runs, points)
    for (name, theirs), marker in zip((peers or {}).items(), cycle(_PEER_MARKERS), strict=False):
        mine, rest = _split(theirs)
        axes.plot(*_columns(mine), marker=marker, **{**_PEER_LINE, "color": _peer(name)})
        axes.plot(*_columns(rest), color=_peer(name), **_DOTS, alpha=0.45, zorder=1.5)
    _scale(axes)
    axes.set_title(title, fontsize=_FONT, parse_math=False)
    look = {"fontsize": _FONT - 1, "handlelength": 1.6, "columnspacing": 1.4, "frameon": False}
    handles = _legend(runs, peers or {})
    figure.legend(handles=handles, loc="outside lower center", ncols=3, **look)
    return figure


def _columns(points: Sequence[Point]) -> tuple[list[float], list[float]]:
    return [p.cost for p in points], [p.error for p in points]


def _integrators(axes: Any, runs: Sequence[Mapping[str, Any]], points: Sequence[Point]) -> None:
    """Lines, symbols and dots of our runs."""
    best = [points[i] for i in front(points)]
    for (kind, is_adaptive), members in _series(runs).items():
        color, marker = _LOOKS[kind]
        mine, rest = _split([points[i] for i in members if _is_main(runs[i])])
        rest += [points[i] for i in members if not _is_main(runs[i])]
        look = {"color": color, "marker": marker, **({"mfc": "white"} if is_adaptive else {})}
        axes.plot(*_columns(mine), **look, **_LINE, ls="--" if is_adaptive else "-")
        alone = [p for p in rest if p in best]
        axes.plot(*_columns(alone), **look, ms=_LINE["ms"], lw=0)
        axes.plot(*_columns(rest), color=color, **_DOTS, alpha=0.45, zorder=1.5)


def _series(runs: Sequence[Mapping[str, Any]]) -> dict[tuple[str, bool], list[int]]:
    """Runs by integrator and whether it has a tolerance, as the legend lists them."""
    series: dict[tuple[str, bool], list[int]] = {}
    for i, run in enumerate(runs):
        integrator = run["integrator"]
        series.setdefault((integrator["type"], "tolerance" in integrator), []).append(i)
    order = list(_LOOKS)
    return dict(sorted(series.items(), key=lambda pair: (order.index(pair[0][0]), pair[0][1])))


def _split(points: Sequence[Point]) -> tuple[list[Point], list[Point]]:
    """Those on their front, and the others."""
    kept = front(points)
    return [points[i] for i in kept], [p for i, p in enumerate(points) if i not in kept]


def _is_main(run: Mapping[str, Any]) -> bool:
    """Whether formulation and stabilization are those that the scene has by itself."""
    stabilization = (run["stabilization"] or {}).get("type", "projection")
    return run["solver"] == "plain" and stabilization == "projection"


def _peer(name: str) -> str:
    """Colour of another package; black for this one in native code."""
    return "#000000" if name.startswith("mbd_ros") else _PEER


def _scale(axes: Any) -> None:
    """Axes with few numbers: errors by thousands, costs by 1, 2, 5."""
    axes.set(xscale="log", yscale="log")
    low, high = axes.get_ylim()
    high = min(high, max(_WORST, 10.0 * low))
    _ticks(axes.yaxis, low, high, (1.0,), 3 if high > 1e5 * low else 1)
    axes.set_ylim(low, high)
    left, right = axes.get_xlim()
    _ticks(axes.xaxis, left, right, (1.0, 2.0, 5.0) if right < 500 * left else (1.0,))
    axes.set_xlim(left, right)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.tick_params(labelsize=_FONT)
    axes.set_xlabel("CPU ms per simulated second", fontsize=_FONT)
    axes.set_ylabel("position error [rad or m]", fontsize=_FONT)
    axes.grid(alpha=0.4)


def _ticks(axis: Any, low: float, high: float, digits: Sequence[float], decades: int = 1) -> None:
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    places = [digit * 10.0**k for k in powers if k % decades == 0 for digit in digits]
    axis.set_major_locator(FixedLocator(places))
    axis.set_minor_formatter(NullFormatter())


def _legend(runs: Sequence[Mapping[str, Any]], peers: Mapping[str, Any]) -> list[Line2D]:
    """At most a dozen entries: integrators, peers, and the meaning of symbols."""
    kinds = list(_series(runs))
    handles = []
    for kind in dict.fromkeys(kind for kind, _ in kinds):
        color, marker = _LOOKS[kind]
        handles.append(Line2D([], [], color=color, marker=marker, **_LINE, label=kind))
    for package, marker in zip(peers, cycle(_PEER_MARKERS), strict=False):
        look = {**_PEER_LINE, "color": _peer(package)}
        handles.append(Line2D([], [], marker=marker, **look, label=package))
    if any(is_adaptive for _, is_adaptive in kinds):
        look = {"color": "gray", "marker": "o", "mfc": "white", "ls": "--"}
        handles.append(Line2D([], [], **look, **_LINE, label="with tolerance"))
    handles.append(Line2D([], [], color="gray", **_DOTS, label="other runs"))
    look = {"color": _FRONT, "lw": 9, "mec": "black"}
    return [*handles, Line2D([], [], **look, **_RINGS, label="Pareto front")]
