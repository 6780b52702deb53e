"""What `make test` says of failures and crashes, on planted ones."""

import sys
from collections import Counter

import crashes
import pytest
import steps
from nodes.node_process import PROFILES, NodeProcess
from places import ROOT

CRASH = "import ctypes\ndef test_reads_address_0():\n    ctypes.string_at(0)\n"
FAILS = "def test_fails():\n    assert 0\ndef test_passes():\n    pass\n"
SKIPPED = "import pytest\ndef test_skipped():\n    pytest.skip('no compiler here')\n"
PASSES = "def test_passes():\n    pass\n"


@pytest.fixture
def planted(tmp_path, monkeypatch):
    """Steps, each of one file of tests, with the conftest of crashes."""

    def plant(*options, **files):
        (tmp_path / "conftest.py").write_text("from crashes import *\n")
        words = {}
        for name, text in files.items():
            (tmp_path / f"test_{name}.py").write_text(text)
            words[name] = ("-q", "-p", "no:cacheprovider", f"{tmp_path}/test_{name}.py", *options)
        monkeypatch.setattr(steps, "STEPS", words)
        monkeypatch.setattr(steps, "RESULTS", tmp_path / "results")
        monkeypatch.setenv("PYTHONPATH", str(ROOT / "test/support"))

    return plant


def test_later_steps_run_after_a_failure_and_all_stand_in_the_table(planted, capfd):
    planted(first=FAILS, second=SKIPPED, nothing="", last=PASSES)
    assert steps.main() == 1
    table = capfd.readouterr().out.partition("minutes\n")[2].splitlines()
    counts = {line.split()[0]: line.split()[1:4] for line in table[:4]}
    assert counts == {
        "first": ["1", "1", "0"],
        "second": ["0", "0", "1"],
        "nothing": ["0", "1", "0"],
        "last": ["1", "0", "0"],
    }
    assert table[4].startswith("failed, first: ") and table[4].endswith("::test_fails")
    assert table[5] == "failed, nothing: pytest ended with exit code 5"
    assert table[6] == "skipped, second: 1 x no compiler here"


def test_steps_that_pass_give_exit_code_0(planted):
    planted(last=PASSES)
    assert steps.main() == 0


def test_a_worker_that_dies_leaves_its_stack(planted, capfd):
    planted("-n", "1", crash=CRASH)
    assert steps.main() == 1
    said = capfd.readouterr().out
    path = next(line for line in said.splitlines() if str(crashes.FOLDER) in line).rstrip(":")
    with open(path) as file:
        text = file.read()
    assert "Segmentation fault" in text and "in test_reads_address_0" in text
    assert "exit code -11 in " in text
    assert "in test_reads_address_0" in said
    (crashes.FOLDER / path).unlink()


def test_a_node_that_dies_leaves_its_stack_and_its_log(monkeypatch):
    monkeypatch.setenv(PROFILES, "")
    node = NodeProcess([sys.executable, "-c", "import ctypes; ctypes.string_at(0)"], 0)
    assert node.wait() == -11
    path, _, text = node.crash().partition(": ")
    NodeProcess.started.remove(node)
    assert text.startswith("SIGSEGV in ") and "in string_at" in text
    with open(path) as file:
        assert file.read() == text
    crashes.Path(path).unlink()


def test_skips_are_counted_by_their_reason(tmp_path):
    results = tmp_path / "r.xml"
    case = '<testcase classname="a" name="b"><skipped message="{}">{}</skipped></testcase>'
    of_file = case.format(
        "collection skipped", "('/a/test_b.py', 12, 'Skipped: no torch (extra)')"
    )
    results.write_text(f"<r>{case.format('x', '') * 2}{case.format('y', '')}{of_file}</r>")
    assert steps.read(results) == (0, (), Counter({"x": 2, "y": 1, "no torch (extra)": 1}))
