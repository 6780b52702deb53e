"""A part of the report for its tests: numbers, slow ones, and what can go wrong with them."""

import os
import signal
import time
from pathlib import Path

from mbd_ros.applications.report.items import Item, Section, Table

COUNT, SECONDS = 12, 0.1


def items(scenes, quick):
    """Twelve of them; a file named by FAKE_LOG gets a line a run, FAKE_FAULT breaks the third."""
    fault = os.environ.get("FAKE_FAULT", "")
    made = [
        Item(
            "fake",
            f"number-{i:02}",
            {"n": i, "scenes": list(scenes), "fault": fault if i == 3 else ""},
            SECONDS,
            alone=i in (5, 6),
        )
        for i in range(COUNT)
    ]
    return made[:4] if quick else made


def run(spec):
    time.sleep(SECONDS)
    log = Path(os.environ["FAKE_LOG"])
    with log.open("a", encoding="utf-8") as file:
        file.write(f"{spec['n']}\n")
    if spec["fault"] == "segfault":
        os.kill(os.getpid(), signal.SIGSEGV)
    if spec["fault"] == "once" and not Path(f"{log}.once").exists():
        Path(f"{log}.once").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if spec["fault"] == "raise":
        raise RuntimeError("planted")
    wrong = spec["fault"] == "wrong"
    threads = os.environ.get("OMP_NUM_THREADS")
    return {"third": spec["n"] / 3, "nan": float("nan"), "wrong": wrong, "threads": threads}


def section(outcomes):
    from matplotlib.figure import Figure  # workers need it not

    rows = [
        (item.name, f"{out['third']:.17g}", "WRONG: planted" if out["wrong"] else "converged")
        for item, out in outcomes
    ]
    figure = Figure(figsize=(8, 3))
    axes = figure.subplots()
    axes.plot([out["third"] for _, out in outcomes], "o-")
    axes.set_xlabel("a <script>alert(1)</script> & more")
    return Section(
        "Thirds & <halves>",
        [f"{len(outcomes)} numbers over 3."],
        [Table("All | thirds", ["name", "third", "state"], rows)],
        {"thirds": figure},
        [f"{item.name} is planted" for item, out in outcomes if out["wrong"]],
        {"A scene": "integrator: {type: rk4}\n"},
        ["All | thirds", "thirds"],
    )
