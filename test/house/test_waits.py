"""Waits of tests: as long as it takes, by the one time-out of `deadline`."""

import ast

import pytest
from places import ROOT

TESTS = ROOT / "test"
CLOCKS = {"monotonic", "perf_counter", "time"}
FILES = sorted(
    path.relative_to(TESTS)
    for path in TESTS.rglob("*.py")
    if "fuzz" not in path.parts and not path.stem.endswith("soak")  # these last as they are told
)


def is_number(node):
    return isinstance(node, ast.Constant) and isinstance(node.value, (int, float))


def called(node):
    """Name of the function of a call."""
    function = node.func if isinstance(node, ast.Call) else None
    return getattr(function, "attr", getattr(function, "id", ""))


def own_limits(tree, sleeps_are_waits):
    """Lines on which a test waits for a time of its own, and what is wrong there.

    Args:
        sleeps_are_waits: Whether a test may not sleep at all.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            if called(node.left) in CLOCKS and is_number(node.right):
                yield node.lineno, "a deadline in seconds"
        elif called(node) == "sleep" and sleeps_are_waits:
            yield node.lineno, "a sleep"
        elif called(node) in {"run", "communicate", "wait", "join", "spin_until", "wait_health"}:
            values = [keyword.value for keyword in node.keywords if keyword.arg == "timeout"]
            values += [] if called(node) == "run" else node.args
            if any(map(is_number, values)):
                yield node.lineno, "a time-out in seconds"
        elif isinstance(node, ast.Assert) and sleeps_are_waits and reads_log(node.test):
            yield node.lineno, "a log that may be incomplete"


def reads_log(test):
    """Return whether an assertion needs lines of a node's log, which may come after its answer."""
    match test:
        case ast.Compare(ops=[ast.In()], comparators=[ast.Attribute(attr="log")]):
            return True
        case ast.Compare(
            left=ast.Call(func=ast.Attribute(ast.Attribute(attr="log"), "count")),
            ops=[ast.Eq()],
            comparators=[ast.Constant()],
        ):
            return True
    return False


def test_no_test_has_a_time_out_of_its_own():
    """A quick machine would not notice, and a busy one would be red."""
    wrong = {
        f"{file}:{line}": what
        for file in FILES
        for line, what in own_limits(
            ast.parse((TESTS / file).read_text(encoding="utf-8")), file.parts[0] == "nodes"
        )
    }
    assert wrong == {}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("end = time.monotonic() + 30.0", "a deadline in seconds"),
        ("time.sleep(0.1)", "a sleep"),
        ("subprocess.run(words, timeout=60)", "a time-out in seconds"),
        ("node.wait(10)", "a time-out in seconds"),
        ("probe.spin_until(done, timeout=3.0)", "a time-out in seconds"),
        ("assert 'refused' in node.log", "a log that may be incomplete"),
        ("assert node.log.count('refused') == 1", "a log that may be incomplete"),
    ],
)
def test_what_is_refused(text, wrong):
    assert list(own_limits(ast.parse(text), True)) == [(1, wrong)]
