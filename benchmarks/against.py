"""Another commit beside this checkout: the same bits, and what a step costs.

python benchmarks/against.py BASE [--only bits|instructions|time] [--rounds 15]

Prints JSON. Bits: hashes of states, accelerations, multipliers and tables of every scene, and,
where some differ, how far evaluations are apart at one and the same states: a run amplifies what
one evaluation rounds otherwise.
Instructions: those of one step, counted by callgrind as the difference of two run lengths, so that
what comes before the first step drops out. Time: processes of both commits in turn, and of this
checkout against itself first, which says what a ratio is worth. Exit code 1: bits differ, or a
evaluations by more than 1e-13, or a step takes more than `--limit` times the instructions.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from scenes_of_comparison import COSTS

ROOT = Path(__file__).resolve().parents[1]
PROBE = Path(__file__).with_name("probe.py")
_SHORT, _LONG = 50, 250  # steps that callgrind counts
_ROUNDING = 1.0e-13  # relative: how far evaluations of two commits may be apart
_TIMED = 20_000  # steps that are timed
_COUNT = re.compile(r"Collected : (\d+)")
_CALLGRIND = ("valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null")
PARTS = ("bits", "instructions", "time")


def main() -> int:
    """Compare, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("base", help="commit to compare with")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--rounds", type=int, default=15, help="pairs of timed processes")
    parser.add_argument("--limit", type=float, default=1.03, help="of instructions a step")
    words = parser.parse_args()
    found: dict[str, Any] = {}
    with checkout(words.base) as base:
        if "bits" in words.only:
            found["bits"] = _bits(base)
        if "instructions" in words.only:
            found["instructions"] = {name: _instructions(name, base) for name in COSTS}
        if "time" in words.only:
            found["time"] = {name: _time(name, base, words.rounds) for name in COSTS}
    json.dump(found, sys.stdout, indent=2)
    print()
    wrong = _too_far(found.get("bits", {}))
    dear = {n: c["ratio"] for n, c in found.get("instructions", {}).items()}
    wrong += [f"{n}: {r:.4f} x the instructions" for n, r in dear.items() if r > words.limit]
    print("\n".join(wrong) or "nothing is wrong", file=sys.stderr)
    return int(bool(wrong))


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """A work tree of another commit, for a while."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "base"
        git = ("git", "-C", str(ROOT), "worktree")
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), commit], check=True)
        try:
            yield tree
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def _too_far(bits: Mapping[str, Any]) -> list[str]:
    """Evaluations that are not those of the base, in bits or to rounding."""
    apart = bits.get("apart", {})
    for line in bits.get("different", ()):
        print(f"bits differ: {line}", file=sys.stderr)
    return [
        f"{scene}: {what} are {by:.3g} apart"
        for scene, values in apart.items()
        for what, by in values.items()
        if not by <= _ROUNDING
    ]


def _bits(base: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        theirs = json.loads(_probe(base, ["bits", folder]).stdout)
        ours = json.loads(_probe(ROOT, ["bits"]).stdout)
        apart = json.loads(_probe(ROOT, ["at", folder]).stdout) if theirs != ours else {}
    different = [
        f"{scene}: {what}"
        for scene in {**theirs, **ours}
        for what in {**theirs.get(scene, {}), **ours.get(scene, {})}
        if theirs.get(scene, {}).get(what) != ours.get(scene, {}).get(what)
    ]
    hashes = sum(map(len, ours.values()))
    changed = {scene: apart[scene] for scene in apart if theirs.get(scene) != ours.get(scene)}
    return {"scenes": len(ours), "hashes": hashes, "different": different, "apart": changed}


def _instructions(name: str, base: Path) -> Mapping[str, float]:
    theirs, ours = (_a_step(tree, name) for tree in (base, ROOT))
    return {"base": theirs, "here": ours, "ratio": ours / theirs}


def _a_step(tree: Path, name: str) -> float:
    short, long = (
        int(_COUNT.findall(_probe(tree, ["run", name, str(n)], _CALLGRIND).stderr)[-1])
        for n in (_SHORT, _LONG)
    )
    return (long - short) / (_LONG - _SHORT)


def _time(name: str, base: Path, rounds: int) -> Mapping[str, float]:
    """Median of paired ratios: this checkout to itself, and to the other commit."""
    return {
        "here to here": _paired(name, ROOT, ROOT, rounds),
        "here to base": _paired(name, ROOT, base, rounds),
    }


def _paired(name: str, one: Path, other: Path, rounds: int) -> float:
    ratios = []
    for turn in range(rounds):
        trees = (one, other) if turn % 2 else (other, one)
        taken = [_seconds(tree, name) for tree in trees]
        ratios.append(taken[0] / taken[1] if turn % 2 else taken[1] / taken[0])
    return median(ratios)


def _seconds(tree: Path, name: str) -> float:
    begin = time.perf_counter()
    _probe(tree, ["run", name, str(_TIMED)])
    return time.perf_counter() - begin


def _probe(
    tree: Path, words: Sequence[str], before: Sequence[str] = ()
) -> "subprocess.CompletedProcess[str]":
    """Run the probe on a tree, without anything that differs from run to run."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "PYTHONHASHSEED": "0",
        "PYTHONDONTWRITEBYTECODE": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [*before, sys.executable, str(PROBE), *words]
    done = subprocess.run(
        command, env=environment, cwd=tree, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} in {tree}:\n{done.stderr}")
    return done


if __name__ == "__main__":
    sys.exit(main())
