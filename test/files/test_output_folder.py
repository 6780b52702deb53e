"""Whatever names stand in files of others, results stay in the folder of -o."""

import json
import os
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from osim_models import chain

from mbd_ros.api import load_scene
from mbd_ros.applications.report.page import BEGIN, END, put_headlines
from mbd_ros.applications.report.store import Store
from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.files.output_folder import file_stem, make_folder, place_in, write_files

NAMES = {  # name in a file of others -> stem of the files that are written
    "{outside}/x": None,  # depends on the folder
    "../x": "_._x",
    "../outside/x": "_._outside_x",
    "a/b": "a_b",
    "a\\b": "a_b",
    "CON": "_CON",
    "nul": "_nul",
    "Com1": "_Com1",
    ".hidden": "_hidden",
    "-rf": "_rf",
    "x" * 300: "x" * 200,
    ".": "_",
    "..": "_.",
    " ": "_",
    "a\x1b[2Jb\nrobots: {}": None,
    "\N{LATIN SMALL LETTER U WITH DIAERESIS}" * 300: None,
}
PENDULUM = (
    "<mujoco model={name}><worldbody><body><joint name='j'/><inertial pos='0 0 1' mass='1' "
    "diaginertia='1 1 1'/></body></worldbody></mujoco>"
)


def contents(folder):
    """All paths below a folder, with what they hold or lead to."""
    return {
        path: os.readlink(path) if path.is_symlink() else path.is_file() and path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder for results among others; they are the same afterwards."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "x.yaml").write_text("precious", encoding="utf-8")
    (tmp_path / "x.yaml").write_text("precious", encoding="utf-8")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    before = contents(tmp_path)
    yield tmp_path / "out"
    written = contents(tmp_path)
    inside = {path for path in written if {tmp_path / "out", tmp_path / "work"} & {*path.parents}}
    kept = {path: held for path, held in written.items() if path not in inside}
    assert kept | {tmp_path / "out": False} == before | {tmp_path / "out": False}


def model_of(name, kind):
    """The text of a model of that name."""
    if kind == "model.xml":
        escapes = {c: f"&#{ord(c)};" for c in name if not c.isprintable() and c != "\x1b"}
        return PENDULUM.format(name=quoteattr(name.replace("\x1b", "?"), escapes))
    return chain().replace('Model name="small"', f"Model name={quoteattr(name)}", 1)


@pytest.mark.parametrize("kind", ["model.xml", "model.osim"])
@pytest.mark.parametrize("name", NAMES)
def test_a_name_in_a_model_is_no_path(folder, name, kind):
    name = name.format(outside=folder.parent / "outside") if "{outside}" in name else name
    if kind == "model.osim":
        name = name.replace("\x1b", "?")
    Path(kind).write_text(model_of(name, kind), encoding="utf-8")
    assert main(["import-opensim", kind, "-o", str(folder)]) == 0
    (scene,) = folder.glob("*.yaml")
    names = {f"{scene.stem}{suffix}" for suffix in (".yaml", ".urdf", ".left_out.txt")}
    assert {path.name for path in folder.iterdir()} == names
    assert load_scene(scene).robot.model.nv in (1, 3)  # it names its description by this name


def test_a_character_that_no_name_has_is_refused(folder):
    Path("model.xml").write_text(model_of("x", "model.xml").replace('"x"', '"&#0;"'))
    assert main(["import-mjcf", "model.xml", "-o", str(folder)]) == 2
    assert not folder.exists()


@pytest.mark.parametrize(("name", "stem"), [(n, s) for n, s in NAMES.items() if s])
def test_stems_are_names_that_every_system_takes(name, stem):
    assert file_stem(name) == stem
    assert len(os.fsencode(f"{file_stem(name)}.left_out.txt")) < 255


def test_a_link_to_a_file_is_replaced_and_its_target_kept(folder):
    make_folder(folder)
    for suffix in (".yaml", ".urdf", ".left_out.txt"):
        (folder / f"small{suffix}").symlink_to("../outside/x.yaml")
    Path("small.osim").write_text(chain(), encoding="utf-8")
    assert main(["import-opensim", "small.osim", "-o", str(folder)]) == 0
    assert not (folder / "small.yaml").is_symlink()


def test_folders_that_lead_out_are_refused(folder):
    make_folder(folder)
    (folder / "results").symlink_to("../outside")
    (folder / ".mbd_ros_report").touch()
    with pytest.raises(DataError, match=r"results: is a link that leads out of .*out"):
        Store(folder, "a processor")
    (folder / "circle").symlink_to("circle")
    for name in ("results", "circle"):
        with pytest.raises(DataError, match="leads out|cannot be written"):
            place_in(folder, name, "file")


def test_the_picture_of_a_page_stays_beside_it(folder):
    make_folder(folder)
    (folder / "images").symlink_to("../outside")
    (folder / "README.md").write_text(f"{BEGIN}\n{END}\n", encoding="utf-8")
    section = {"tables": [], "figures": ["cost"], "headline": ["cost"]}
    about = {"machine": {"cpu": "", "cores": 1}, "git": {}, "versions": {}, "wrong": 0}
    numbers = {"quick": False, "date": "", "sections": {"a": section}, **about}
    (folder / "report.json").write_text(json.dumps(numbers), encoding="utf-8")
    (folder / "cost.png").touch()
    with pytest.raises(DataError, match="images: is a link that leads out"):
        list(put_headlines(folder / "README.md", folder))
    (folder / "images").unlink()
    for name in ("../cost", "absent"):
        section["figures"] = section["headline"] = [name]
        (folder / "report.json").write_text(json.dumps(numbers), encoding="utf-8")
        with pytest.raises(DataError, match="no name of a file|absent.png: cannot be read"):
            list(put_headlines(folder / "README.md", folder))
    assert not (folder / "images").exists()


@pytest.mark.parametrize("text", ["{}", "[]", "1", "[" * 100_000, '{"machine": 1}', "\xff"])
def test_reports_that_are_none_are_refused(folder, text):
    make_folder(folder)
    (folder / "README.md").write_text(f"{BEGIN}\n{END}\n", encoding="utf-8")
    (folder / "report.json").write_text(text, encoding="latin-1")
    with pytest.raises(DataError, match="report.json: no report that can be read"):
        list(put_headlines(folder / "README.md", folder))


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/x", "a\\b", "a\0"])
def test_paths_are_no_names(folder, name):
    with pytest.raises(DataError, match="is no name of a file"):
        write_files(folder, {name: b""})


def test_the_folder_itself_may_be_a_link(folder):
    Path("real").mkdir()
    folder.symlink_to(Path("real").absolute())
    write_files(folder, {"a": b"1"})
    assert Path("real/a").read_bytes() == b"1"
    Path(folder).unlink()
