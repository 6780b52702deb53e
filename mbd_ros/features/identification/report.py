"""Files of an identification: description, scene, tables and a page."""

from base64 import b64encode
from collections.abc import Iterator, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.identification.identified_scene import (
    description_of,
    scene_text,
    write_files,
)
from mbd_ros.features.identification.job import run_identify
from mbd_ros.features.identification.task import Identified, Task
from mbd_ros.files.replacing import refuse_overwriting
from mbd_ros.files.table import Table
from mbd_ros.jobs.lines import Say
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;margin:1rem 0;display:block;overflow-x:auto}"
    "td,th{padding:.2rem .7rem;border-bottom:1px solid #ccc;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_POINTS = 4000  # a curve: more is not to be seen
_TITLES = {
    "validation": "Torques that were not learned from",
    "base_parameters": "Base parameters",
    "bodies": "Bodies, all of positive density",
    "friction": "Friction",
    "drives": "Drives: torque for a unit of effort, answer to noise of the measured velocity",
}


def identify_to(scene: Scene, task: Task, folder: Path, say: Say) -> None:
    """Write `identified.urdf`, `scene.yaml`, tables (.csv) and `report.html`; all, or none.

    Raises:
        MbdError: As `identify`, or a place that cannot be written to.
    """
    sources: Sequence[Source] = (*task.motions, *task.held, *task.wrenches)
    refuse_overwriting(folder, *(source for source in sources if isinstance(source, Path)))
    description_of(scene)  # refuses scenes that no file can hold
    lines: list[str] = []

    def told(line: str) -> None:
        lines.append(line)
        say(line)

    found = run_identify(scene, task, told)._replace(remarks=lines)
    files = {
        "identified.urdf": description_of(found.scene).encode(),
        "scene.yaml": scene_text(found.scene, "identified.urdf").encode(),
        **{f"{name}.csv": _csv(table) for name, table in found.tables.items()},
        "report.html": page(found, scene.name).encode(),
    }
    write_files(folder, files, say)


def page(found: Identified, title: str) -> str:
    """The result as one page."""
    policy = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
    return "\n".join(
        [
            f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">{policy}',
            f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
            f"<h1>Identification of {escape(Path(title).name)}</h1>",
            *(f"<p>{escape(line)}</p>" for line in found.remarks),
            *_pictures(found),
            *(line for key, name in _TITLES.items() for line in _table(name, found.tables[key])),
            "</body></html>\n",
        ]
    )


def _csv(table: Table) -> bytes:
    """Comma-separated values with a line of names; texts are quoted where they need it."""
    lines = [",".join(column.name for column in table.columns)]
    lines += [",".join(_word(x) for x in row) for row in _rows(table)]
    return ("\n".join(lines) + "\n").encode()


def _word(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"' if "," in value else value
    return repr(float(value))


def _rows(table: Table) -> Iterator[tuple[Any, ...]]:
    return zip(*(column.values.tolist() for column in table.columns), strict=True)


def _table(title: str, table: Table) -> Iterator[str]:
    yield f"<h2>{escape(title)}</h2><table><tr>"
    yield "".join(f"<th>{escape(column.label)}</th>" for column in table.columns) + "</tr>"
    for row in _rows(table):
        cells = (x if isinstance(x, str) else f"{x:.4g}" for x in row)
        yield "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
    yield "</table>"


def _pictures(found: Identified) -> Iterator[str]:
    """Torques of the test and what is left of them, a panel a joint."""
    if found.residuals is None:
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = found.tables["validation"]["joint"].tolist()
    times, measured, identified, given = found.residuals
    every = slice(None, None, max(1, len(times) // _POINTS))
    t = times[every] - times[0]
    picture = Figure(figsize=(10.0, 2.0 * len(names) + 0.6), layout="constrained")
    FigureCanvasAgg(picture)
    grid: Any = picture.subplots(len(names), 2, sharex=True, squeeze=False)
    for k, name in enumerate(names):
        _curves(grid[k], name, t, [v[every, k] for v in (measured, identified, given)])
    grid[0, 0].legend(fontsize=7, loc="upper right")
    drawn = BytesIO()
    picture.savefig(drawn, format="png", dpi=100)
    data = b64encode(drawn.getvalue()).decode()
    yield f'<img alt="torques and residuals of the test" src="data:image/png;base64,{data}">'


def _curves(panels: Any, name: str, t: Array, values: list[Array]) -> None:
    """Torques of a joint, and their residuals with the band of 95 %."""
    measured, identified, given = values
    for curve, label in ((measured, "measured"), (identified, "identified"), (given, "given")):
        panels[0].plot(t, curve, lw=0.8, label=label)
    panels[0].set_ylabel(f"{name} [N·m or N]", fontsize=7)
    panels[1].plot(t, given - measured, lw=0.5, color="C2")
    panels[1].plot(t, identified - measured, lw=0.5, color="C1")
    band = 1.96 * float(np.std(identified - measured))
    panels[1].axhspan(-band, band, alpha=0.15)
    panels[1].set_ylabel("residual", fontsize=7)
    for panel in panels:
        panel.tick_params(labelsize=7)
        panel.grid(visible=True, alpha=0.3)
