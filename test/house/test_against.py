"""`benchmarks/against.py` and `imports.py`: another commit beside this one."""

import json
import subprocess
import sys

import pytest
from places import ROOT

AGAINST = [sys.executable, "benchmarks/against.py"]
IMPORTS = [sys.executable, "benchmarks/imports.py"]


def run(*words, cwd=ROOT, program=AGAINST):
    return subprocess.run([*program, *words], cwd=cwd, capture_output=True, text=True, check=False)


def test_an_unknown_commit_is_refused():
    done = run("no_such_commit", "--only", "bits")
    assert done.returncode != 0 and "no_such_commit" in done.stderr


@pytest.mark.soak
def test_a_changed_number_is_seen_and_nothing_else(tmp_path):
    """A clone whose gravity compensation is off by rounding, against the commit it came from."""
    clone = tmp_path / "clone"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    part = clone / "mbd_ros/parts/forces/gravity_compensation.py"
    text = part.read_text(encoding="utf-8")
    changed = text.replace("= self._gain *", "= 1.0000000000000002 * self._gain *")
    assert changed != text
    part.write_text(changed, encoding="utf-8")
    done = run("HEAD", "--only", "bits", cwd=clone)
    found = json.loads(done.stdout)["bits"]
    assert done.returncode == 1 and found["scenes"] > 40
    assert {line.partition(":")[0] for line in found["different"]} == {"loads"}


@pytest.mark.soak
def test_a_module_that_is_imported_in_addition_is_seen(tmp_path):
    """A clone whose command line imports more modules, foreign ones too."""
    clone = tmp_path / "clone"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    program = clone / "mbd_ros/features/tools/check.py"
    text = program.read_text(encoding="utf-8")
    program.write_text(text + "import mbd_ros.scene.schema.nearest\n", encoding="utf-8")
    words = "HEAD", "--only", "check empty", "--rounds", "1", "--limit", "9"
    done = run(*words, cwd=clone, program=IMPORTS)
    found = json.loads(done.stdout)["check empty"]
    assert done.returncode == 1
    assert found["more"] == ["mbd_ros.scene.schema.nearest"] and "difflib" in found["foreign"]
    assert "check empty: imports difflib" in done.stderr
    program.write_text(text, encoding="utf-8")
    done = run(*words, cwd=clone, program=IMPORTS)
    assert (done.returncode, done.stderr) == (0, "nothing is wrong\n")
