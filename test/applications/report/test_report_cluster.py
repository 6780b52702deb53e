"""The report on Dask: the same as without, whatever happens to the workers."""

import json
import os
import signal
import threading
import time
from functools import cache

import pytest
from report_runs import ran, use_fake

from mbd_ros.cli import main
from mbd_ros.jobs.workers.cluster import Cluster
from mbd_ros.jobs.workers.task import Task, cpu

distributed = pytest.importorskip("distributed", reason="pip install 'mbd_ros[dask]'")


@pytest.fixture(autouse=True)
def fake(monkeypatch, tmp_path):
    use_fake(monkeypatch, tmp_path)


@pytest.fixture
def cluster():
    """Two workers behind an address."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        yield cluster


def outcome(folder):
    loaded = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return loaded["sections"], [(i["name"], i["outcome"]) for i in loaded["items"]]


@pytest.mark.soak
def test_one_worker_killed_during_the_sweep_changes_nothing(tmp_path, cluster):
    killed = []

    def kill():
        while len(ran(tmp_path)) < 6:
            time.sleep(0.02)
        killed.append(next(iter(cluster.workers.values())).pid)
        os.kill(killed[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    words = ["report", "--scheduler", cluster.scheduler_address, "-o", str(tmp_path / "out")]
    assert main(words) == 0
    killer.join()
    assert killed
    assert ran(tmp_path)[:2] == [5, 6]  # those that time, one after the other
    assert set(ran(tmp_path)) == set(range(12))
    assert main(["report", "-o", str(tmp_path / "here")]) == 0
    assert outcome(tmp_path / "out") == outcome(tmp_path / "here")


@pytest.mark.soak
def test_an_item_that_takes_every_worker_with_it_is_wrong(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FAKE_FAULT", "segfault")
    assert main(["report", "--scheduler", "local:2", "-o", str(tmp_path / "out")]) == 1
    assert "fake/number-03: Dask abandoned it" in capsys.readouterr().err
    assert set(ran(tmp_path)) == set(range(12))


def test_a_worker_with_other_sources_is_refused(tmp_path, monkeypatch, capsys, cluster):
    other = cache(lambda _: "0" * 64)
    monkeypatch.setattr("mbd_ros.applications.report.compose.program", other)
    words = ["report", "--quick", "--scheduler", cluster.scheduler_address]
    assert main([*words, "-o", str(tmp_path / "out")]) == 1
    assert "this worker has other sources" in capsys.readouterr().err


def test_a_task_that_never_ends_is_given_up():
    """With one worker that others wait for."""
    tasks = [Task("hung", "time:sleep", 600.0, limit=0.5)]
    tasks += [Task(f"{n}", "math:sqrt", n * n, limit=60.0) for n in range(3)]
    with Cluster("local:1") as workers:
        assert workers.cpu() == cpu()
        found = {task.name: result for task, result in workers.run(tasks, alone=False)}
    assert found["hung"].failure == "no result within 0.5 s"
    assert [found[f"{n}"].value for n in range(3)] == [0.0, 1.0, 2.0]


def test_a_pause_is_no_failure_on_python_3_10(monkeypatch):
    """There what `distributed.wait` raises is not the builtin TimeoutError."""
    wait, pauses = distributed.wait, []

    class Waited(Exception):
        pass

    def late(*words, **more):
        if not pauses:
            pauses.append(1)
            raise Waited
        return wait(*words, **more)

    monkeypatch.setattr(distributed, "TimeoutError", Waited)
    monkeypatch.setattr(distributed, "wait", late)
    with Cluster("local:1") as workers:
        ((_, result),) = workers.run([Task("root", "math:sqrt", 4.0)], alone=False)
    assert result.value == 2.0 and pauses


def test_without_dask_the_line_that_brings_it_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    assert main(["report", "--scheduler", "local:2", "-o", str(tmp_path / "out")]) == 2
    assert "pip install 'mbd_ros[dask]'" in capsys.readouterr().err


def test_an_address_without_an_answer_is_bad_input(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("mbd_ros.jobs.workers.cluster._CONNECT_TIMEOUT", 1.0)
    words = ["report", "--scheduler", "tcp://127.0.0.1:9", "-o", str(tmp_path / "out")]
    assert main(words) == 2
    assert "--scheduler tcp://127.0.0.1:9" in capsys.readouterr().err
