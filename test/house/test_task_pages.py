"""Commands and code of the README and of the task pages do what the pages say."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from deadline import DEADLINE
from page_blocks import ROOT, blocks, commands, task_pages

from mbd_ros.cli import main
from mbd_ros.nodes.table import NODES

PAGES = task_pages()
IDS = [page.name for page in PAGES]
MINUTES = ("demo", "gait", "report")  # commands that run for longer than others
PROCESSES = ("replay", *MINUTES)  # which take hold of signals or of this process's files
IN_A_SHELL = ("eval", "export", "ros2", "pip", "colcon", "make", "dask", ".")  # checked, not run
SYNOPSIS = re.compile(r"\b[A-Z]{2,}\b|\.\.(?!/)|\||\[")  # SCENE, `..`, [a|b]
ELSEWHERE = {  # pages whose blocks other tests run
    "extend.md": "test/house/test_docs.py",
    "laboratory.md": "test/applications/demo/test_laboratory.py",  # recordings of others
}


def is_long(page):
    """Whether a page runs a command of minutes."""
    lines = [line for b in blocks(page) if b.kind == "bash" for line in commands(b)]
    return any(line.split()[:2] == ["mbd-ros", name] for line in lines for name in MINUTES)


def run(line, folder):
    """Run a command of a page; those that serve a page in a browser only until it is there."""
    words = shlex.split(line)
    assert words[0] == "mbd-ros", line
    if words[1] == "view":
        serve(words[1:], folder)
        return
    if words[1] in PROCESSES:
        started = [sys.executable, "-m", "mbd_ros", *words[1:]]
        ran = subprocess.run(started, cwd=folder, capture_output=True, text=True)
        sys.stdout.write(ran.stdout)
        assert ran.returncode == 0, ran.stderr
        return
    try:
        code = main(words[1:])
    except SystemExit as ended:  # of --help
        code = ended.code
    assert code == 0, line


def serve(words, folder):
    pytest.importorskip("viser", reason="viser is not installed")
    command = [sys.executable, "-m", "mbd_ros", *words, "--no-browser"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    served = subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
    )
    try:
        assert any("http://127.0.0.1:" in line for line in served.stdout), words
        served.send_signal(signal.SIGINT)
        assert served.wait(DEADLINE) == 0
    finally:
        served.kill()


@pytest.fixture
def follow(tmp_path, monkeypatch):
    """A function that does what a page says, in an empty folder; it returns that folder."""
    monkeypatch.chdir(tmp_path)

    def followed(name):
        names = {}
        page = ROOT / name
        for block in blocks(page):
            if block.file:
                Path(block.file).write_text(block.text, encoding="utf-8")
            elif block.kind == "python":
                exec(block.text, names)
            elif block.kind == "bash":
                for line in commands(block):
                    if line.split()[0] not in (*IN_A_SHELL, *NODES):
                        run(line, tmp_path)
        return tmp_path

    return followed


def table(name):
    names = Path(name).read_text(encoding="utf-8").split("\n", 1)[0].split(",")
    values = np.loadtxt(name, delimiter=",", skiprows=1)
    return dict(zip(names, values.T, strict=True))


def test_get_started(follow, capsys):
    folder = follow("docs/get_started.md")
    assert {"swing.csv", "swing.png"} <= {path.name for path in folder.iterdir()}
    said = capsys.readouterr().out
    assert "prosthetic_leg" in said and "ros__parameters" in said and "--derivatives" in said


def test_my_first_scene(follow, capsys):
    follow("docs/first_scene.md")
    found, events = table("torques.csv"), table("stops.csv")
    spring = -5.0 * found["shoulder.position"] - 0.3 * found["shoulder.velocity"]
    np.testing.assert_allclose(found["shoulder.effort"], spring, rtol=0, atol=1e-9)
    swing = table("swing.csv")
    stop = swing["elbow_joint_stop.torque"]
    np.testing.assert_allclose(found["elbow.effort"], -stop, rtol=0, atol=1e-9)
    assert len(events["time"]) > 2
    lines = [line for line in capsys.readouterr().out.splitlines() if "N m/rad: up to" in line]
    assert len(lines) == 3
    tendon = table("tendon_torques.csv")
    assert "elbow.effort" not in tendon and np.abs(tendon["elbow.multiplier"]).max() > 0.1


def test_my_bag(follow, capsys):
    """Zero-phase torques of the recording are those with which it was made; the node lags."""
    folder = follow("docs/my_bag.md")
    output = capsys.readouterr().out
    assert "causal derivatives at 8 Hz lag by 0.0256 s" in output
    assert float(re.search(r"off the measured effort by (\S+) %", output)[1]) < 1e-3
    assert "400 answered, 0 lost" in output
    assert float(re.search(r"^overall (\S+) %", output, re.MULTILINE)[1]) < 1.1
    assert (folder / "torques.mcap").stat().st_size > 10_000


def test_my_prosthesis(follow, capsys):
    follow("docs/my_prosthesis.md")
    said = capsys.readouterr().out
    assert float(re.search(r"gives up to ([\d.]+) N m", said)[1]) > 0.1
    torques = table("torques.csv")
    pin = np.hypot(*(torques[f"shank_loop_closure.force_{axis}"] for axis in "xz"))
    assert 70.0 < pin.max() < 85.0
    np.testing.assert_allclose(torques["hip_flexion.effort"], 0.0, rtol=0, atol=1e-9)
    stance = table("stance.csv")
    assert np.abs(stance["ankle.external"]).max() > 10.0


def test_from_markers_to_the_knee_load(follow, capsys):
    """The page quotes what the commands print; OpenSim's JointReaction finds 3438 N."""
    follow("docs/knee_load.md")
    output = capsys.readouterr().out
    page = (ROOT / "docs/knee_load.md").read_text(encoding="utf-8")
    quoted = re.findall(r"^ {4}(\S.*)$", page.partition("## Look")[2], re.MULTILINE)
    assert len([line for line in quoted if line in output]) == 2
    assert output.endswith("3436 N, 4.83 body weights\n")


TESTED = {
    "get_started.md",
    "first_scene.md",
    "my_bag.md",
    "my_prosthesis.md",
    "knee_load.md",
    "README.md",
}
OTHERS = [page for page in PAGES if page.name not in TESTED]


@pytest.mark.parametrize("page", [p for p in OTHERS if not is_long(p)], ids=lambda p: p.name)
def test_commands_of_a_task_page_run(page, follow):
    if page.name not in ELSEWHERE:
        follow(f"docs/{page.name}")


@pytest.mark.soak
@pytest.mark.parametrize("page", [p for p in OTHERS if is_long(p)], ids=lambda p: p.name)
def test_commands_that_take_minutes_run(page, follow):
    follow(f"docs/{page.name}")


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_command_of_a_page_is_run_or_a_synopsis(page):
    """What looks like a command stands in a block that runs, or shows its words in general."""
    text = page.read_text(encoding="utf-8")
    ran = {line for b in blocks(page) if b.kind == "bash" for line in commands(b)}
    shown = re.findall(r"^(?: {4})?(mbd-ros .*?)(?:\s+#.*)?$", text, re.MULTILINE)
    if page.name in ELSEWHERE:
        pages = (ROOT / ELSEWHERE[page.name]).read_text(encoding="utf-8")
        assert page.name in pages
        return
    left = {line for line in shown if line not in ran and not SYNOPSIS.search(line)}
    assert left == set()


def lines_of(pages, begin):
    """Lines of all blocks that begin so, without their comments."""
    every = (line for page in pages for block in blocks(page) for line in commands(block))
    return [line for line in every if line.startswith(begin)]


def test_lines_for_ros_name_what_there_is():
    """`ros2` is no wheel: its files, executables and arguments are looked up here."""
    launched = [line.split()[3:] for line in lines_of(PAGES, "ros2 launch mbd_ros")]
    assert launched
    for file, *arguments in launched:
        paths = (ROOT / "launch" / file, ROOT / "mbd_ros/nodes/launching.py")
        text = "".join(path.read_text(encoding="utf-8") for path in paths)
        names = [word.partition(":=")[0] for word in arguments]
        assert [name for name in names if f'"{name}"' not in text] == [], file
    started = {line.split()[3] for line in lines_of(PAGES, "ros2 run mbd_ros")}
    assert started <= {*NODES, "mbd-ros"}


def test_lines_for_pip_name_what_setup_names():
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    for line in lines_of(PAGES, "pip install"):
        for word in shlex.split(line)[2:]:
            extra = re.fullmatch(r"mbd_ros\[(\w+)\]", word)
            assert f'"{extra[1] if extra else word}"' in setup, line


def test_the_readme_tests_as_continuous_integration_does():
    readme = lines_of([ROOT / "README.md"], "make ")
    assert "make test" in readme
    assert "exec make --keep-going lint test" in (ROOT / ".ci/run").read_text(encoding="utf-8")
