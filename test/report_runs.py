"""What the tests of the report share: the fake part in place, what it ran, what is reported."""

import json

from mbd_ros.cli import main
from mbd_ros.report import items

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
