"""The table of commands, and the program that reads it."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from mbd_ros.cli import main
from mbd_ros.jobs.table import COMMANDS

ROOT = Path(__file__).parents[1]
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
