"""What the pages name exists: files, modules, links, pages, commands and goals of make."""

import importlib
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from places import ROOT
from scipy.integrate import simpson

from mbd_ros.applications.report.page import BEGIN, END
from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.features.tools.completion import all_words
from mbd_ros.files import formats
from mbd_ros.files.table import Column, Result, Table, read_result

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/*.md"))]
FOLDERS = ("benchmarks", "config", "docs", "launch", "mbd_ros", "msg_adapters", "test")
IDS = [page.name for page in PAGES]

FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
PATH = re.compile(r"[\w.-]+(?:/[\w.*-]+)*/?")
MODULE = re.compile(r"mbd_ros(?:\.[a-z_]\w*)+")


def words_of(page):
    """What stands between backticks, and every word of the fenced blocks."""
    text = page.read_text(encoding="utf-8")
    blocks = "\n".join(FENCE.findall(text))
    return [w for code in CODE.findall(FENCE.sub("", text)) for w in code.split()], blocks


def tracked():
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], **RUN).stdout
    return listed.splitlines()


RUN = {"cwd": ROOT, "capture_output": True, "text": True, "check": True}


def paths_in(words):
    """Words that can only be paths of this package, without line numbers and classes."""
    inside = {f.name for f in (ROOT / "mbd_ros").iterdir() if f.is_dir()}
    for word in words:
        match = PATH.fullmatch(word.rstrip(",.;:"))
        if match is None:
            continue
        name, first = match[0], match[0].split("/")[0]
        if name.endswith(".py") or ("/" in name and first in {*FOLDERS, *inside}):
            yield name


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_path_exists(page):
    files = tracked()
    words, _ = words_of(page)

    def exists(name):
        if "/" not in name:
            return any(f.rsplit("/", 1)[-1] == name for f in files)
        return any(any(base.glob(name.rstrip("/"))) for base in (ROOT, ROOT / "mbd_ros"))

    assert [name for name in paths_in(words) if not exists(name)] == []


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_module_exists(page):
    named = MODULE.findall(page.read_text(encoding="utf-8"))
    entry_points = {"mbd_ros.commands", "mbd_ros.formats", "mbd_ros.sections"}
    assert [name for name in named if name not in entry_points and not is_module(name)] == []


def is_module(name):
    """A module, or a public name in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:count])
        if path.with_suffix(".py").is_file():
            rest = parts[count:]
            return not rest or re.search(rf"\b{rest[0]}\b", path.with_suffix(".py").read_text())
        if path.is_dir() and count == len(parts):
            return True
    return hasattr(__import__(parts[0]), parts[1]) if find_spec(parts[0]) else False


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_link_leads_somewhere(page):
    lost = []
    for target in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            lost.append(target)
    assert lost == []


def anchors(file):
    """What a heading is called in a link, as code hosts make it."""
    headings = re.findall(r"^#+ (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_goal_of_make_exists(page):
    goals = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    named = re.findall(r"(?:`|^)make ([a-z-]+)", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert set(named) <= set(goals)


OTHERS = {
    "--ros-args",
    "--params-file",
    "--full-length",
    "--nthreads",
    "--nworkers",
    "--help",
    "--version",
}
EXAMPLES = {"weigh": ("--limit",)}  # commands of docs/extend.md
FUZZ = {"--keep"}  # python -m fuzz.run


@pytest.fixture(scope="module")
def words():
    return all_words()


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_command_and_option_exists(page, words):
    text = page.read_text(encoding="utf-8")
    known = {name for w in words.values() for option in w.options for name in option.names}
    known |= OTHERS | FUZZ | {name for names in EXAMPLES.values() for name in names}
    options = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text))
    commands = set(re.findall(r"(?:`|^|\. )mbd-ros ([a-z][a-z_-]*)", text, re.MULTILINE))
    assert options <= known
    assert commands <= {*words, *EXAMPLES}


def test_the_index_lists_every_page():
    listed = set(LINK.findall((ROOT / "docs/index.md").read_text(encoding="utf-8")))
    assert [page.name for page in PAGES[2:] if page.name not in {"index.md", *listed}] == []


@pytest.mark.parametrize("page", PAGES[2:], ids=IDS[2:])
def test_a_page_says_first_what_you_can_do_after_it(page):
    if page.name == "index.md":
        return
    _, first, *_ = page.read_text(encoding="utf-8").split("\n\n")
    assert re.search(r"\byou\b", first, re.IGNORECASE), first


def test_the_first_screen_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    """Three commands, and six lines of Python that find the forces which the scene left out."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("mbd-ros ")][:3]
    assert [main(shlex.split(line, comments=True)[1:]) for line in lines] == [0, 0, 0]
    assert np.isfinite(np.array(list(table("torques.csv").values()))).all()
    code = re.search(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)[1]
    assert len([line for line in code.splitlines() if line]) == 6
    exec(code, {})
    found = table("torques.csv")
    spring = -30.0 * found["ankle.position"] - 0.5 * found["ankle.velocity"]
    np.testing.assert_allclose(found["ankle.effort"], spring, rtol=0, atol=1e-6)
    assert np.abs(spring).max() > 0.1


def test_the_page_on_python_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    names = {}
    for code in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        exec(code, names)
    said = capsys.readouterr().out
    assert "True {'python': " in said
    assert "forces[0]: no joint 'knee'; the robot has shoulder_flexion" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["torques.npz", "torques.png"]


def test_the_page_on_results_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    *lines, last = code.strip().splitlines()
    names = {}
    exec("\n".join(lines), names)
    assert eval(last, names)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["torques.npz", "torques.png"]


def test_the_report_page_has_one_place_for_the_headlines():
    text = (ROOT / "docs/report.md").read_text(encoding="utf-8")
    assert (text.count(BEGIN), text.count(END)) == (1, 1)


def test_pictures_are_small():
    most = {".gif": 1_500_000}
    sizes = {f.name: (f.stat().st_size, f.suffix) for f in ROOT.glob("docs/images/*")}
    assert [n for n, (size, kind) in sizes.items() if size > most.get(kind, 150_000)] == []


def test_the_moving_picture_moves():
    with Image.open(ROOT / "docs/images/muscle_leg.gif") as picture:
        first = np.asarray(picture.convert("RGB")).astype(int)
        picture.seek(picture.n_frames // 2)
        changed = (np.asarray(picture.convert("RGB")) != first).any(axis=2)
    assert changed.mean() > 0.01


@pytest.mark.soak
def test_the_moving_picture_is_made_by_its_script(tmp_path):
    made = tmp_path / "again.gif"
    subprocess.run([sys.executable, ROOT / "docs/site/moving_picture.py", made], check=True)
    with Image.open(made) as again, Image.open(ROOT / "docs/images/muscle_leg.gif") as kept:
        assert (again.n_frames, again.size) == (kept.n_frames, kept.size)
        for i in (0, again.n_frames // 2, again.n_frames - 1):
            again.seek(i), kept.seek(i)
            pair = [np.asarray(image.convert("RGB")).astype(int) for image in (again, kept)]
            assert np.abs(pair[0] - pair[1]).mean() < 2.0  # of 255: text depends on versions


KEYS = ("name", "version")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


ENTRY = re.compile(r"^\[project\.entry-points.*?(?=^\[tool)", re.MULTILINE | re.DOTALL)


@pytest.fixture
def follow(tmp_path, monkeypatch):
    """A function that writes the files of a section of docs/extend.md and runs its commands."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield lambda heading: _follow(heading, tmp_path)
    for name, module in list(sys.modules.items()):
        if Path(getattr(module, "__file__", None) or "/").parent == tmp_path:
            del sys.modules[name]


def _follow(heading, folder):
    text = (ROOT / "docs/extend.md").read_text(encoding="utf-8")
    section = re.search(rf"^## {heading}$(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)[1]
    for kind, block in BLOCK.findall(section):
        if kind:
            (folder / block.split("\n", 1)[0].removeprefix("# ")).write_text(block)
        if kind == "toml":
            install(block, folder)
    for line in "".join(block for kind, block in BLOCK.findall(section) if not kind).splitlines():
        words = shlex.split(line.removeprefix("PYTHONPATH=. "))
        assert words[0] == "mbd-ros" and main(words[1:]) == 0, line


def install(project, folder):
    """What pip leaves of a project beside its modules: name, version and entry points."""
    name, version = (re.search(rf'^{key} = "(.*)"', project, re.MULTILINE)[1] for key in KEYS)
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
    points = ENTRY.search(project)[0].replace("project.entry-points.", "").replace('"', "")
    (info / "entry_points.txt").write_text(points)
    importlib.invalidate_caches()


def table(name):
    names = Path(name).read_text(encoding="utf-8").split("\n", 1)[0].split(",")
    values = np.loadtxt(name, delimiter=",", skiprows=1)
    return dict(zip(names, values.T, strict=True))


def test_a_force_of_ones_own(follow, capsys):
    follow("A force")
    assert "hard_spring:HardSpring" in capsys.readouterr().out
    swing = table("swing.csv")
    np.testing.assert_allclose(swing["energy"], swing["energy"][0], rtol=0, atol=1e-9)
    assert np.ptp(swing["hinge.position"]) > 0.9
    q = swing["hinge.position"]
    np.testing.assert_allclose(swing["hinge_hard_spring.torque"], -3.0 * q - 40.0 * q**3)


def test_a_constraint_of_ones_own(follow):
    follow("A constraint")
    fall = table("fall.csv")
    np.testing.assert_allclose(fall["joint4.position"] + fall["joint6.position"], 0.3, atol=1e-12)
    assert np.abs(fall["level_tool.torque"]).max() > 0.1


def test_a_command_of_ones_own(follow, capsys):
    follow("A command")
    assert capsys.readouterr().out == "15.940 kg in 9 links\n"
    assert main(["weigh", "arm7", "--limit", "15"]) == 1


def test_a_format_of_ones_own(follow, tmp_path, monkeypatch):
    monkeypatch.setattr(formats, "_installed", formats._installed.__wrapped__)
    follow("A format")
    torques = read_result("torques.npz")["samples"]
    assert np.abs(torques["joint2.effort"]).max() < 1e-9  # of free motion
    time, place = np.linspace(0.0, 1.0, 4), np.array([1 / 3, 2.0, -0.1, 1e-300])
    made = Table([Column("time", time, "s"), Column("knee.position", place, "rad")])
    Result({"samples": made}).to(tmp_path / "knee.txt")
    assert read_result(tmp_path / "knee.txt")["samples"] == made
    with pytest.raises(DataError, match="column tensor is float64 of shape 3 x 3 a row"):
        Result({"samples": Table([Column("tensor", np.zeros((2, 3, 3)))])}).to("t.txt")
    Path("empty.txt").write_text("")
    with pytest.raises(DataError, match="empty.txt: no table of text"):
        read_result("empty.txt")


def test_a_section_of_ones_own(follow, capsys):
    follow("A section")
    assert "wind        mistral, Gust at hinge\n" in capsys.readouterr().out
    blown = table("blown.csv")
    pushed = blown["time"] < 0.1 - 1e-9
    assert np.diff(blown["energy"][pushed]).min() > 0
    np.testing.assert_allclose(np.diff(blown["energy"][~pushed])[1:], 0.0, atol=1e-9)


def test_an_actuator_of_ones_own(follow, capsys):
    """A motor whose winding is short-circuited brakes; inverse dynamics asks for no voltage."""
    follow("An actuator")
    said = capsys.readouterr().out
    assert "actuator: hinge_voltage_motor" in re.sub(r" +", " ", said).replace(
        "actuator ", "actuator: "
    )
    braked, voltages = table("braked.csv"), table("voltages.csv")
    assert np.diff(braked["energy"]).max() < 1e-9
    assert np.abs(voltages["hinge.command"]).max() < 1e-6
    assert np.abs(voltages["hinge.effort"]).max() > 0.1


def test_an_actuator_with_a_state_of_ones_own(follow, capsys):
    """The law of its winding without a voltage, L i' = -R i - c q', as an integral."""
    follow("An actuator with a state of its own")
    assert "motor.current [A], starts at -2, in -100 .. 100" in capsys.readouterr().out
    found = table("current.csv")
    current, q = found["motor.current"], found["hinge.position"]
    lost = 0.8 * simpson(current, x=found["time"]) + 1.2 * (q[-1] - q[0])
    assert 0.02 * (current[-1] - current[0]) == pytest.approx(-lost, abs=1e-9)


def test_a_guard_of_ones_own(follow):
    """Energy of a rod that swings down from 0.3 rad and gets faster by 0.2 rad/s in the middle."""
    follow("A guard with a reset")
    energy, inertia, weight = table("clock.csv")["energy"], 0.0833583 + 0.25, 9.81 * 0.5
    speed, expected = np.sqrt(2.0 * weight * (1.0 - np.cos(0.3)) / inertia), [energy[0]]
    for _ in range(3):
        expected.append(energy[0] + inertia * (speed + 0.2) ** 2 / 2 - weight * (1 - np.cos(0.3)))
        speed += 0.2
    kept = energy[np.abs(np.diff(energy, prepend=energy[0])) < 1e-9]
    np.testing.assert_allclose(np.unique(kept.round(7)), expected, rtol=0, atol=1e-6)
