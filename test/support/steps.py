"""`make test`: run every step, also after one that fails, and end with one table.

A step is one run of pytest. Its result is read from the JUnit file that pytest writes; a run that
ends without one, or with an exit code that its tests do not explain, has failed as well.
"""

import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from places import ROOT

RESULTS = ROOT / "build" / "steps"
TWO, FOUR = ("-n", "2", "--dist", "worksteal"), ("-n", "4", "--dist", "worksteal")
STEPS = {
    "package": (*TWO, "--ignore=test/nodes", "--ignore=test/browser"),
    "browser": ("test/browser",),
    "nodes": (*FOUR, "-m", "not soak and not alone", "test/nodes"),
    "alone": ("-m", "alone and not soak", "test/nodes"),
}


class Outcome(NamedTuple):
    """What one step gave; `skipped` counts by reason, `failed` holds names of tests."""

    step: str
    passed: int
    failed: tuple[str, ...]
    skipped: Counter[str]
    minutes: float


def run(step: str, words: tuple[str, ...]) -> Outcome:
    """Run pytest with some words and read what it wrote."""
    results = RESULTS / f"{step}.xml"
    results.unlink(missing_ok=True)
    sys.stdout.write(f"\n==== {step}: pytest {' '.join(words)}\n")
    sys.stdout.flush()
    begin = time.monotonic()
    command = (sys.executable, "-m", "pytest", f"--junitxml={results}", *words)
    # Else each of some thousand processes compiles the same modules.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    code = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    minutes = (time.monotonic() - begin) / 60.0
    passed, failed, skipped = read(results)
    if code and not failed:
        failed = (f"pytest ended with exit code {code}",)
    return Outcome(step, passed, failed, skipped, minutes)


def read(results: Path) -> tuple[int, tuple[str, ...], Counter[str]]:
    """Count of tests that passed, names of those that failed, skipped ones by reason."""
    if not results.is_file():
        return 0, (), Counter()
    passed, failed, skipped = 0, dict[str, None](), Counter[str]()
    for case in ElementTree.parse(results).iter("testcase"):
        name = f"{case.get('classname')}::{case.get('name')}"
        reason = case.find("skipped")
        if case.find("failure") is not None or case.find("error") is not None:
            failed[name] = None
        elif reason is not None:
            skipped[_why(reason)] += 1
        else:
            passed += 1
    return passed, tuple(failed), skipped


def _why(skipped: ElementTree.Element) -> str:
    """The reason of a skip; that of a whole file stands in the text, behind its place."""
    whole_file = (skipped.text or "").rpartition("Skipped: ")[2][:-2]
    is_file = skipped.get("message") == "collection skipped"
    return whole_file if is_file else skipped.get("message", "")


def table(outcomes: list[Outcome]) -> str:
    """The outcomes as text: a line a step, then what failed and why tests were skipped."""
    lines = [f"{'step':10}{'passed':>8}{'failed':>8}{'skipped':>9}{'minutes':>9}"]
    for o in outcomes:
        counts = f"{o.passed:8}{len(o.failed):8}{o.skipped.total():9}"
        lines.append(f"{o.step:10}{counts}{o.minutes:9.1f}")
    lines += [f"failed, {o.step}: {name}" for o in outcomes for name in o.failed]
    lines += [
        f"skipped, {o.step}: {count} x {reason}"
        for o in outcomes
        for reason, count in o.skipped.most_common()
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    RESULTS.mkdir(parents=True, exist_ok=True)
    outcomes = [run(step, words) for step, words in STEPS.items()]
    sys.stdout.write(f"\n{table(outcomes)}")
    return int(any(o.failed for o in outcomes))


if __name__ == "__main__":
    sys.exit(main())
