"""What a user may give to `mbd-ros report`: scenes, their names, and folders."""

import pytest
from report_runs import numbers, pendulum, ran, report, use_fake

from mbd_ros.applications.report import items
from mbd_ros.applications.report.compose import collect
from mbd_ros.applications.report.left_out import kind as left_out
from mbd_ros.applications.report.precision import kind as precision
from mbd_ros.applications.report.store import Store
from mbd_ros.applications.report.subjects import subjects


@pytest.fixture
def fake(monkeypatch, tmp_path):
    use_fake(monkeypatch, tmp_path)


@pytest.mark.parametrize("kind", list(items.PARTS))
def test_a_scene_that_cannot_be_built_is_bad_input_for_every_kind(tmp_path, capsys, kind):
    scene = pendulum(tmp_path / "s.yaml")
    scene.write_text(scene.read_text(encoding="utf-8") + "gravty: 1\n", encoding="utf-8")
    assert report(scene, "--only", kind, "-o", tmp_path / "out") == 2
    said = capsys.readouterr()
    assert "s.yaml" in said.err and "gravty" in said.err
    assert said.out == "" and not (tmp_path / "out").exists()


def test_scenes_of_any_names_have_names_of_their_own(tmp_path):
    names = ["my leg", "Prüfstand", "arm", "a/arm", "b/ARM", "arm_2", "x.y", "脚", "n" * 200]
    paths = [str(tmp_path / f"{name}.yaml") for name in names]
    found = [subject.name for subject in subjects(paths, True)]
    assert found[:7] == ["my_leg", "Prufstand", "arm", "arm_2", "ARM_3", "arm_2_2", "x_y"]
    assert found[7] == "scene" and found[8] == "n" * 60


@pytest.mark.parametrize("part", [precision, left_out])
def test_items_of_strange_and_equal_names_can_be_stored(tmp_path, part):
    (tmp_path / "b").mkdir()
    paths = [tmp_path / "my leg.yaml", tmp_path / "Prüfstand.yaml", tmp_path / "b/my leg.yaml"]
    kind = next(kind for kind in ("precision", "left_out") if items.part(kind) is part)
    work = collect([kind], [str(pendulum(path)) for path in paths], True)[kind]
    store = Store(tmp_path / "out", "a processor")
    assert [store.load(item) for item in work] == [None] * len(work)
    assert {item.name.split(".")[0] for item in work} == {"my_leg", "Prufstand", "my_leg_2"}


def test_a_scene_given_twice_is_done_once(tmp_path, fake):
    scene = pendulum(tmp_path / "s.yaml")
    again = f"{tmp_path}/../{tmp_path.name}/s.yaml"
    assert report(scene, again, "--quick", "-o", tmp_path / "out") == 0
    assert numbers(tmp_path / "out")["items"][0]["spec"]["scenes"] == [str(scene)]


def test_a_folder_below_a_file_is_bad_input(tmp_path, fake, capsys):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for out in (tmp_path / "file", tmp_path / "file/out", tmp_path / "file/a/b"):
        assert report("-o", out) == 2
        assert str(out) in capsys.readouterr().err
    assert ran(tmp_path) == []


@pytest.mark.parametrize("out", ["/proc/report_out", "/proc/self/a/b"])
def test_a_folder_that_nobody_can_write_is_bad_input(tmp_path, fake, capsys, out):
    """Not even root, who may write into any folder of a disk."""
    assert report("-o", out) == 2
    assert out in capsys.readouterr().err
    assert ran(tmp_path) == []


def test_what_the_system_refuses_while_saving_is_told(tmp_path, fake, monkeypatch, capsys):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    assert report("--quick", "-o", tmp_path / "out") == 0
    monkeypatch.setattr("mbd_ros.applications.report.store.replacing", refuse)
    assert report("-o", tmp_path / "out") == 2
    assert f"{tmp_path / 'out'}: cannot be written (Permission denied)" in capsys.readouterr().err


@pytest.mark.parametrize("names", [["index.html"], ["results/", "index.html"], ["report.json"]])
def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path, fake, names):
    out = tmp_path / "out"
    out.mkdir()
    for name in names:
        if name.endswith("/"):
            (out / name).mkdir()
        else:
            (out / name).write_text("{}", encoding="utf-8")
    assert report("-o", out) == 2
    assert sorted(path.name for path in out.iterdir()) == sorted(n.strip("/") for n in names)
    assert "{}" in [path.read_text(encoding="utf-8") for path in out.iterdir() if path.is_file()]


def test_a_report_from_before_there_was_a_mark_is_one(tmp_path, fake):
    out = tmp_path / "out"
    assert report("-o", out) == 0
    (out / ".mbd_ros_report").unlink()
    assert report("-o", out) == 0
    (out / ".mbd_ros_report").unlink()
    (out / "report.json").unlink()
    assert report("-o", out) == 2
