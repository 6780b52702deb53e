"""What the tests of the report share: the fake part in place, what it ran, records of runs."""

import json
from pathlib import Path

from mbd_ros.applications.report import items
from mbd_ros.applications.report.precision.converged import Choice
from mbd_ros.cli import main
from mbd_ros.scene.schema.locate import find_file

ROBOTS = "package://mbd_ros/config/robots/benchmark"
TIMES = {"date", "duration", "work", "machine"}  # what differs from run to run


def use_fake(monkeypatch, tmp_path):
    """Only the fake part, which notes what it runs."""
    monkeypatch.setattr(items, "PARTS", {"fake": "report_fake_part"})
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "log"))
    monkeypatch.delenv("FAKE_FAULT", raising=False)


def report(*words):
    return main(["report", *map(str, words)])


def ran(tmp_path):
    """Numbers of the items that were run, in order."""
    log = tmp_path / "log"
    return [int(line) for line in log.read_text().split()] if log.exists() else []


def numbers(folder):
    """report.json without what differs from run to run."""
    loaded = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    for item in loaded["items"]:
        del item["took"]
    return {key: value for key, value in loaded.items() if key not in TIMES}


def pendulum(path):
    """A scene of a user that can be built, its robot `r.urdf` beside it."""
    robot = find_file(Path(), f"{ROBOTS}/point_pendulum.urdf", "robot").read_bytes()
    path.with_name("r.urdf").write_bytes(robot)
    path.write_text("robot: {urdf: r.urdf}\ndt: 1.0e-2\n", encoding="utf-8")
    return path


def run_of(integrator, cost, error, solver="plain", stabilization=None):
    """A record with a cost [ms per simulated s] and a position error [rad]."""
    choice = Choice(solver, stabilization, integrator, 0.01)
    return {**choice._asdict(), "seconds": 1e-3 * cost, "spread": 0.0, "position": error}


RUNS = [
    run_of({"type": "rk4"}, 1.0, 2e-4),
    run_of({"type": "dop853", "tolerance": 1e-8}, 2.5, 1e-8, "kkt", {"type": "none"}),
    run_of({"type": "dop853", "tolerance": 1e-8}, 4.0, 1e-8, stabilization={"type": "projection"}),
]
