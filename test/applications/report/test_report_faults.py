"""`mbd-ros report` when it is killed, when its workers die, and when something is wrong."""

import os
import signal
import subprocess
import sys
import time

import pytest
from deadline import DEADLINE
from places import ROOT
from report_runs import numbers, ran, report, use_fake


@pytest.fixture(autouse=True)
def fake(monkeypatch, tmp_path):
    use_fake(monkeypatch, tmp_path)


@pytest.mark.parametrize(
    "how", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.soak)]
)
def test_killed_halfway_the_rest_is_done_later(tmp_path, how):
    """The whole process group, as a closed terminal or Ctrl-C would."""
    out, log = tmp_path / "out", tmp_path / "log"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, ROOT / "test/support/report_driver.py", "report", "-o", out]
    driver = subprocess.Popen(
        words, env=environment, start_new_session=True, stderr=subprocess.PIPE, text=True
    )
    stop = time.monotonic() + DEADLINE
    while len(ran(tmp_path)) < 5 and time.monotonic() < stop:
        time.sleep(0.02)
    os.killpg(driver.pid, how)
    errors = driver.communicate()[1]
    assert driver.returncode == (130 if how == signal.SIGINT else -how), errors
    assert "Traceback" not in errors
    stored = len(list(out.glob("results/*/*.json")))
    assert 3 <= stored < 12
    assert not (out / "index.html").exists()
    log.unlink()
    assert subprocess.run(words, env=environment, check=False).returncode == 0
    assert len(ran(tmp_path)) == 12 - stored
    resumed = numbers(out)
    assert report("-o", tmp_path / "whole") == 0
    assert resumed == numbers(tmp_path / "whole")


def test_workers_end_with_a_killed_parent(tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [
        sys.executable,
        ROOT / "test/support/report_driver.py",
        "report",
        "-o",
        tmp_path / "out",
    ]
    driver = subprocess.Popen(words, env=environment, start_new_session=True)
    stop = time.monotonic() + DEADLINE
    while len(ran(tmp_path)) < 3 and time.monotonic() < stop:
        time.sleep(0.02)
    driver.kill()
    driver.wait()
    while time.monotonic() < stop:
        try:
            os.killpg(driver.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a worker outlived the report")


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("segfault", "its process ended by SIGSEGV in each of 2 attempts"),
        ("raise", "RuntimeError: planted"),
    ],
)
def test_an_item_that_fails_is_wrong_and_tried_again_later(
    tmp_path, monkeypatch, capsys, fault, reason
):
    out = tmp_path / "out"
    monkeypatch.setenv("FAKE_FAULT", fault)
    assert report("-o", out) == 1
    assert f"fake/number-03: {reason}" in capsys.readouterr().err
    assert ran(tmp_path).count(3) == (2 if fault == "segfault" else 1)
    assert sorted(set(ran(tmp_path))) == list(range(12))
    page = (out / "index.html").read_text(encoding="utf-8")
    assert page.index(reason) < page.index("<section")
    assert "11 numbers over 3." in page
    before = len(ran(tmp_path))
    assert report("-o", out) == 1
    assert set(ran(tmp_path)[before:]) == {3}


@pytest.mark.soak
def test_a_worker_lost_once_costs_nothing(tmp_path, monkeypatch):
    assert report("-o", tmp_path / "whole") == 0
    monkeypatch.setenv("FAKE_FAULT", "once")
    assert report("-o", tmp_path / "out") == 0
    sections = [numbers(tmp_path / folder)["sections"] for folder in ("out", "whole")]
    assert sections[0] == sections[1]


def test_an_item_that_never_ends_is_wrong(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("mbd_ros.applications.report.compose._PATIENCE", 0.1)
    monkeypatch.setattr("mbd_ros.applications.report.compose._SLOWER", 0.1)
    assert report("--quick", "-o", tmp_path / "out") == 1
    assert "fake/number-00: no result within 0.1 s" in capsys.readouterr().err


def test_wrong_fails_the_command(tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    monkeypatch.setenv("FAKE_FAULT", "wrong")
    assert report("-o", out) == 1
    assert "Thirds & <halves>: number-03 is planted" in capsys.readouterr().err
    assert numbers(out)["wrong"] == ["Thirds & <halves>: number-03 is planted"]
    page = (out / "index.html").read_text(encoding="utf-8")
    assert '<td class="wrong">WRONG: planted</td>' in page
    assert page.index("number-03 is planted") < page.index("<section")
