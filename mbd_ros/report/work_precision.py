"""Error against run time as a picture."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_ros.report.choices import of_record
from mbd_ros.report.pareto import Point

_COLORS = {
    "semi_implicit_euler": "tab:gray",
    "rk4": "tab:orange",
    "adams": "tab:green",
    "dopri5": "tab:cyan",
    "dop853": "tab:blue",
    "filippov": "tab:blue",
    "gauss_legendre": "tab:purple",
    "generalized_alpha": "tab:pink",
    "rattle": "tab:olive",
    "shake": "tab:brown",
}
_MARKERS = "osD^v<>P*X"
_PEER = "tab:red"


def diagram(
    title: str,
    runs: Sequence[Mapping[str, Any]],
    points: Sequence[Point],
    best: Sequence[int],
    peers: Mapping[str, Sequence[Point]] | None = None,
) -> Figure:
    """Position error over CPU time, log-log, with the Pareto front marked.

    Args:
        title: Above the picture.
        runs: Records of runs; other formulations and stabilizations than those of the scene
            are faint and not in the legend.
        points: Their cost [ms per simulated s] and error.
        best: Indices of the front.
        peers: Name of another package and its set-up -> its runs.
    """
    figure = Figure(figsize=(8.0, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for i, (label, members) in enumerate(_series(runs).items()):
        place = sorted(members, key=lambda k: (points[k].cost, points[k].error))
        cost, error = zip(*(points[k] for k in place), strict=True)
        color, is_main = _COLORS.get(label.split()[0], "black"), _is_main(runs[members[0]])
        shape = {"marker": _MARKERS[i % len(_MARKERS)] if is_main else ".", "ms": 3.5, "lw": 0.8}
        look = {"alpha": 0.85 if is_main else 0.3, "label": label if is_main else f"_{label}"}
        axes.plot(cost, error, color=color, **shape, **look)
    for i, (label, theirs) in enumerate((peers or {}).items()):
        cost, error = zip(*sorted(theirs), strict=True)
        axes.plot(
            cost, error, marker=_MARKERS[i % 10], ms=5, lw=1, ls="--", color=_PEER, label=label
        )
    ring = [points[i] for i in best]
    if ring:
        cost, error = zip(*ring, strict=True)
        axes.plot(cost, error, "ko-", ms=8, lw=1.4, fillstyle="none", label="Pareto front")
    axes.set(xscale="log", yscale="log", title=title)
    axes.set_xlabel("CPU ms per simulated second")
    axes.set_ylabel("position error [rad or m]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=6.5, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _series(runs: Sequence[Mapping[str, Any]]) -> dict[str, list[int]]:
    """Runs by method, formulation and stabilization."""
    found: dict[str, list[int]] = {}
    for i, run in enumerate(runs):
        choice = of_record(run)
        words = [choice.method, "" if choice.solver == "auto" else choice.solver]
        stabilization = (choice.stabilization or {}).get("type", "projection")
        words += ["" if stabilization == "projection" else stabilization]
        words += ["fixed" if _is_fixed(choice.integrator) else ""]
        found.setdefault(" ".join(word for word in words if word), []).append(i)
    return found


def _is_main(run: Mapping[str, Any]) -> bool:
    """Whether formulation and stabilization are those that the scene has by itself."""
    stabilization = (run["stabilization"] or {}).get("type", "projection")
    return run["solver"] == "auto" and stabilization == "projection"


def _is_fixed(integrator: Mapping[str, Any]) -> bool:
    return integrator["type"] in ("dopri5", "dop853", "filippov") and "tolerance" not in integrator
