"""What a stored result depends on, and what becomes of it when that changes meanwhile."""

import json

import pytest
from report_runs import numbers, pendulum, ran, report, use_fake

import mbd_ros.applications.report.store as hashes
from mbd_ros.applications.report.items import Item
from mbd_ros.applications.report.store import Store
from mbd_ros.jobs.workers.task import Result, cpu

TIMED = Item("fake", "timed", {"n": 1}, 1.0, True)
DONE = Result({"n": 1}, "", 1.0, "here")


@pytest.fixture(autouse=True)
def fake(monkeypatch, tmp_path):
    """Without the sources of the package, on which somebody may be working."""
    use_fake(monkeypatch, tmp_path)
    monkeypatch.setattr(hashes, "_computes", lambda _: False)
    hashes.program.cache_clear()


def needed(kind):
    return {path.stem for path in hashes._needed(f"mbd_ros.applications.report.{kind}")}


def test_what_a_kind_loads_by_name_is_part_of_its_program():
    assert {"kind", "mujoco_peer", "drake_peer", "contenders"} <= needed("peers.kind")
    assert "probe" in needed("left_out.kind")
    assert "mujoco_peer" not in needed("precision.kind")  # the list of all kinds is no use


def test_a_change_in_a_module_that_is_loaded_by_name_changes_the_program(monkeypatch):
    before, contents = (
        hashes.program_now("mbd_ros.applications.report.peers.kind"),
        hashes._contents,
    )

    def edited(files):
        return [f"{line} edited" if "mujoco_peer" in line else line for line in contents(files)]

    monkeypatch.setattr(hashes, "_contents", edited)
    assert hashes.program_now("mbd_ros.applications.report.peers.kind") != before


def test_texts_that_only_look_like_modules_do_no_harm(tmp_path, monkeypatch):
    text = (
        "A, B = 'mbd_ros.applications.report.nothing', 'mbd_ros.applications.report.items.Item'\n"
    )
    (tmp_path / "odd_part.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert [path.name for path in hashes._needed("odd_part")] == ["odd_part.py"]


def during(monkeypatch, change):
    """Do something after the first result came, before it is stored."""
    save, done = Store.save, []

    def changing(self, item, result):
        if not done:
            done.append(change())
        save(self, item, result)

    monkeypatch.setattr(Store, "save", changing)


def test_a_scene_that_changes_meanwhile_leaves_no_result(tmp_path, monkeypatch, capsys):
    out, scene = tmp_path / "out", pendulum(tmp_path / "s.yaml")
    robot = tmp_path / "r.urdf"
    shape = robot.read_text(encoding="utf-8")
    with monkeypatch.context() as patch:
        during(patch, lambda: robot.write_text(f"{shape}<!-- 2 -->", encoding="utf-8"))
        assert report(scene, "--quick", "-o", out) == 0
    assert f"changed while this ran: {robot}; run it again" in capsys.readouterr().out
    page = (out / "index.html").read_text(encoding="utf-8")
    assert f"Changed while this ran: {robot}." in page[: page.index("<section")]
    assert not list(out.glob("results/*/*.json"))
    robot.write_text(shape, encoding="utf-8")
    assert report(scene, "--quick", "-o", out) == 0
    assert len(ran(tmp_path)) == 8 and numbers(out)["changed"] == []


def test_sources_that_change_meanwhile_leave_no_result(tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    during(monkeypatch, lambda: monkeypatch.setattr(hashes, "versions", lambda: {"numpy": "0"}))
    assert report("--quick", "-o", out) == 0
    assert "changed while this ran: the sources of fake; run it again" in capsys.readouterr().out
    assert not list(out.glob("results/*/*.json"))


def test_a_result_is_kept_where_nothing_changed(tmp_path):
    store = Store(tmp_path / "out", "here")
    assert store.load(TIMED) is None
    store.save(TIMED, DONE)
    assert store.load(TIMED) == DONE and not store.changed


def test_times_hold_for_the_processor_that_took_them(tmp_path):
    """Taken elsewhere, by the workers of another machine, and asked for here."""
    there, here = (Store(tmp_path / "out", cpu) for cpu in ("there", "here"))
    for item in (TIMED, TIMED._replace(name="plain", alone=False)):
        assert there.load(item) is None
        there.save(item, DONE._replace(cpu="there"))
    assert there.load(TIMED).cpu == "there"
    assert here.load(TIMED) is None
    assert here.load(TIMED._replace(name="plain", alone=False)).cpu == "there"


def test_a_stored_time_of_another_processor_is_refused_whatever_its_file_is_called(tmp_path):
    store = Store(tmp_path / "out", "here")
    store.load(TIMED)
    store.save(TIMED, DONE)
    (file,) = (tmp_path / "out").glob("results/*/*.json")
    stored = json.loads(file.read_bytes())
    file.write_text(json.dumps(stored | {"cpu": "there"}), encoding="utf-8")
    assert store.load(TIMED) is None


def test_workers_say_which_processor_times(tmp_path, monkeypatch):
    """Results of workers elsewhere are loaded again for them, and not for this machine."""
    monkeypatch.setattr("mbd_ros.jobs.workers.processes.Processes.cpu", lambda _: "elsewhere")
    assert report("-o", tmp_path / "out") == 0
    monkeypatch.setattr("mbd_ros.jobs.workers.processes.Processes.cpu", lambda _: cpu())
    before = len(ran(tmp_path))
    assert report("-o", tmp_path / "out") == 0
    assert len(ran(tmp_path)) == before  # they ran here, whatever was said
    monkeypatch.setattr("mbd_ros.jobs.workers.processes.Processes.cpu", lambda _: "elsewhere")
    assert report("-o", tmp_path / "out") == 0
    assert sorted(ran(tmp_path)[before:]) == [5, 6]
