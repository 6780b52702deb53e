"""The table of commands, and the program that reads it."""

import importlib
import json
import os
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from installed_package import install
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.jobs.table import COMMANDS

EMPTY = ROOT / "config/scenes/empty.yaml"


def loaded_by(*words):
    """Modules of commands that a fresh process holds after `mbd-ros ..`."""
    code = "import json, sys, contextlib\nfrom mbd_ros.cli import main\n"
    code += "with contextlib.suppress(SystemExit): main(sys.argv[1:])\n"
    code += "print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True, check=True
    )
    modules = {command.module for command in COMMANDS.values()}
    return modules & set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_module_of_a_command_has_what_the_table_says(name):
    module = importlib.import_module(COMMANDS[name].module)
    assert callable(module.add_arguments) and callable(module.run)


def test_the_help_names_every_command_and_imports_none(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    said = " ".join(capsys.readouterr().out.split())
    assert [f"{n} {c.text}" for n, c in COMMANDS.items() if f"{n} {c.text}" not in said] == []
    assert loaded_by("--help") == set()


def test_only_the_command_that_is_asked_for_is_imported():
    assert loaded_by("check", EMPTY) == {COMMANDS["check"].module}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_begins_with_what_the_table_says(capsys, name):
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    usage, text, *_ = capsys.readouterr().out.split("\n\n")
    assert caught.value.code == 0
    assert usage.startswith(f"usage: mbd-ros {name}")
    assert " ".join(text.split()) == COMMANDS[name].text


def test_without_words_there_is_the_help_with_an_example_that_runs(capsys, tmp_path, monkeypatch):
    with pytest.raises(SystemExit) as caught:
        main([])
    out, err = capsys.readouterr()
    assert (caught.value.code, out) == (2, "")
    program, *example = err.rpartition("example: ")[2].split()
    assert program == "mbd-ros"
    monkeypatch.chdir(tmp_path)
    assert main(example) == 0
    assert len(list(tmp_path.iterdir())) == 1


def test_an_unknown_command_says_the_nearest_and_all_there_are(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["simulat", "arm7"])
    said = capsys.readouterr().err
    assert caught.value.code == 2
    assert "there is no command 'simulat'; the nearest is 'simulate', accepted: check, " in said
    assert all(name in said for name in COMMANDS)


@pytest.mark.parametrize("target", [["-m", "mbd_ros"], ["-m", "mbd_ros.cli"]])
def test_the_module_is_the_program_and_knows_its_version(tmp_path, target):
    done = subprocess.run(
        [sys.executable, *target, "--version"], cwd=tmp_path, capture_output=True, text=True
    )
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"mbd-ros {version}\n", "")


HELLO = '''\
"""Greets a scene."""

from mbd_ros.jobs.arguments import add_scene
from mbd_ros.scene.reader import load_scene


def add_arguments(parser):
    add_scene(parser)
    parser.add_argument("--times", type=int, default=1, help="how often")


def run(arguments):
    print("hello", load_scene(arguments.scene).robot.model.name, "!" * arguments.times)
    return 1
'''
ENTRIES = {"hello": "greeting", "lost": "no_such_module", "empty": "greeting_empty"}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """`mbd-ros`, in a process that sees a package with commands of its own."""
    modules = {"greeting": HELLO, "greeting_empty": ""}
    folder = tmp_path_factory.mktemp("package")
    target = install(folder, "greeting", modules, "mbd_ros.commands", ENTRIES)

    def run(*given):
        return subprocess.run(
            [sys.executable, "-m", "mbd_ros", *given],
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(target), str(ROOT)))},
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_an_installed_package_adds_a_command_with_one_file(installed):
    done = installed("hello", "empty", "--times", "3")
    assert (done.returncode, done.stdout, done.stderr) == (1, "hello pendulum !!!\n", "")
    told = installed("hello", "--help").stdout
    assert told.startswith("usage: mbd-ros hello [-h] [--allow-code] [--times TIMES] scene")
    assert "Greets a scene." in told and "how often" in told


def test_an_unknown_command_names_those_of_installed_packages(installed):
    done = installed("helo")
    assert done.returncode == 2
    assert "the nearest is 'hello', accepted: check, " in done.stderr
    assert " empty, hello, lost" in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("lost", "command 'lost' (no_such_module) cannot be imported: No module named 'no_such_"),
        ("empty", "command 'empty' (greeting_empty) has no function 'add_arguments'"),
    ],
)
def test_a_command_that_cannot_be_used_is_named(installed, name, said):
    done = installed(name)
    assert done.returncode == 2
    assert said in done.stderr and "Traceback" not in done.stderr


def test_completion_names_the_commands_of_others_and_imports_none(installed):
    assert " hello lost " in installed("completion", "bash").stdout.splitlines()[2]
