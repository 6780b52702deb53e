"""Shell completion: the scripts, and an interactive bash on a terminal."""

import os
import pty
import re
import select
import subprocess
import time

import pytest
from deadline import DEADLINE

from mbd_ros.cli import main
from mbd_ros.jobs.table import COMMANDS
from mbd_ros.scene.schema.locate import embedded_scenes

SHOWS = "mbd-ros() { printf '<%s>' \"$@\"; echo; }"  # in place of the program: the words it gets
TAB = "\t"


@pytest.fixture
def script(capsys):
    def printed(shell):
        assert main(["completion", shell]) == 0
        return capsys.readouterr().out

    return printed


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_holds_every_command_option_and_scene(script, shell):
    text = script(shell)
    words = set(re.findall(r"[\w./-]+", text))
    assert {*COMMANDS, *embedded_scenes(), "zero-phase", "sliding_mode"} <= words
    options = "allow-code", "integrator", "derivatives", "scheduler", "version"
    written = [f"-l {o}" if shell == "fish" else f"--{o}" for o in options]
    assert [option for option in written if option not in text] == []


class Terminal:
    """An interactive bash behind a terminal, which gets keys."""

    def __init__(self, folder, script):
        (folder / "rc").write_text(f"PS1='$ '\n{SHOWS}\n{script}\n", encoding="utf-8")
        self.master, slave = pty.openpty()
        words = ["bash", "--noprofile", "--rcfile", str(folder / "rc"), "-i"]
        environment = {**os.environ, "TERM": "dumb", "INPUTRC": "/dev/null"}
        streams = {"stdin": slave, "stdout": slave, "stderr": slave}
        self.process = subprocess.Popen(
            words, cwd=folder, env=environment, start_new_session=True, **streams
        )
        os.close(slave)

    def words_of(self, keys):
        """Words that the program gets for a line of keys."""
        os.write(self.master, f"{keys}\n".encode())
        text, end = "", time.monotonic() + DEADLINE
        while not (found := re.search(r"^<(.*)>\r?$", text, re.MULTILINE)):
            left = end - time.monotonic()
            assert left > 0 and select.select([self.master], [], [], left)[0], text
            text += os.read(self.master, 4096).decode()
        return found[1].split("><")

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.master)


@pytest.fixture
def terminal(tmp_path, script):
    (tmp_path / "motion of today.csv").touch()
    (tmp_path / "checks").mkdir()
    shell = Terminal(tmp_path, script("bash"))
    yield shell
    shell.close()


def test_bash_completes_commands_options_values_scenes_and_files(terminal):
    typed = {
        f"mbd-ros ch{TAB}": ["check"],
        f"mbd-ros check arm{TAB} --al{TAB}": ["check", "arm7", "--allow-code"],
        f"mbd-ros check benchmark/x06{TAB}": ["check", "benchmark/x06_chain"],
        f"mbd-ros inverse empty mot{TAB} --der{TAB} ze{TAB}": [
            "inverse",
            "empty",
            "motion of today.csv",
            "--derivatives",
            "zero-phase",
        ],
        f"mbd-ros simulate empty --from m{TAB}": [
            "simulate",
            "empty",
            "--from",
            "motion of today.csv",
        ],
        f"mbd-ros completion z{TAB}": ["completion", "zsh"],
        f"mbd-ros simulate empty -t m{TAB}": ["simulate", "empty", "-t", "m"],
    }
    assert {keys: terminal.words_of(keys) for keys in typed} == typed
