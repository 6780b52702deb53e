"""Another commit beside this checkout: what programs import, and how long they take to start.

python benchmarks/imports.py BASE [--rounds 21] [--only CASE ..]

Prints JSON. Modules: those that a process has at its end and had not at BASE, where modules that
git sees as renamed are the same. Time: processes of both commits in turn, the median of the paired
ratios, and of this checkout to itself, which says what a ratio is worth. CPU time is judged, since
a node also waits. Exit code 1: more modules or foreign ones, or more than `--limit` times as long.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from against import ROOT, checkout

from mbd_ros.jobs.domain_claim import claimed_domain

_CHECK = "import timeit; timeit.Timer.timeit = lambda *_: 1.0; "  # `check` times no call then
_CHECK += "from mbd_ros.cli import main; main(['check', 'config/scenes/{scene}.yaml'])"
_NODE = "import sys; sys.argv = ['{name}', '--ros-args', '-p', 'scene:=config/scenes/{scene}.yaml'"
_NODE += "]; import mbd_ros.programs; mbd_ros.programs.{name}()"
_LIST = "\nimport json, sys; print(); print(json.dumps(sorted(sys.modules)))"
CASES = {
    "import mbd_ros": "import mbd_ros",
    "check empty": _CHECK.format(scene="empty"),
    "check four_bar_leg": _CHECK.format(scene="four_bar_leg"),
    **{
        f"node {name}": _NODE.format(name=name, scene=scene)
        for name, scene in (
            ("inverse_dynamics", "prosthetic_leg"),
            ("simulator", "controlled_arm"),
            ("sliding_mode_controller", "controlled_arm"),
        )
    },
}


class Run(NamedTuple):
    """A process that ended.

    Attributes:
        seconds: CPU time [s].
        output: What it printed.
    """

    seconds: float
    output: str


def main() -> int:
    """Compare, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("base", help="commit to compare with")
    parser.add_argument("--only", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--rounds", type=int, default=21, help="pairs of timed processes")
    parser.add_argument("--limit", type=float, default=1.05, help="of the time")
    words = parser.parse_args()
    found: dict[str, Any] = {}
    with checkout(words.base) as base:
        renamed = _renamed(words.base)
        for case in words.only:
            found[case] = _modules(base, case, renamed) | _times(base, case, words.rounds)
    json.dump(found, sys.stdout, indent=2)
    print()
    wrong = [line for case, facts in found.items() for line in _faults(case, facts, words.limit)]
    print("\n".join(wrong) or "nothing is wrong", file=sys.stderr)
    return int(bool(wrong))


def _faults(case: str, facts: Mapping[str, Any], limit: float) -> list[str]:
    wrong = [f"{case}: imports {name}" for name in facts["foreign"]]
    if facts["modules here"] > facts["modules of base"]:
        wrong.append(f"{case}: {facts['modules here']} modules, {facts['modules of base']} before")
    if facts["here to base"] > limit:
        wrong.append(f"{case}: {facts['here to base']:.3f} x the time")
    return wrong


def _renamed(base: str) -> dict[str, str]:
    """Module here -> what it was called at the other commit."""
    words = ["git", "-C", str(ROOT), "diff", "--name-status", "-M40", "--diff-filter=R", base]
    lines = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    pairs = (line.split("\t")[1:] for line in lines if line.endswith(".py"))
    return {_module(here): _module(there) for there, here in pairs}


def _module(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _modules(base: Path, case: str, renamed: Mapping[str, str]) -> dict[str, Any]:
    """What both import; this also leaves both trees with compiled modules."""
    code = CASES[case] + _LIST
    there, here = (json.loads(_run(t, code).output.splitlines()[-1]) for t in (base, ROOT))
    gone = {name.rpartition(".")[2]: name for name in set(there) - set(here)}
    known = {name: renamed.get(name, name) for name in here}
    for name, before in known.items():
        if before not in there:  # too much of it changed for git
            known[name] = gone.get(name.rpartition(".")[2], name)
    more = [name for name, before in known.items() if before not in there]
    fewer = set(there) - set(known.values())
    own = [name for name in more if name.startswith(("mbd_ros", "msg_adapters"))]
    return {
        "modules here": len(here),
        "modules of base": len(there),
        "foreign": sorted(set(more) - set(own)),
        "more": own,
        "fewer": sorted(fewer),
    }


def _times(base: Path, case: str, rounds: int) -> dict[str, float]:
    """Medians: seconds, and paired ratios of this checkout to itself and to the other commit."""
    taken: dict[str, list[float]] = {"here to here": [], "here to base": []}
    seconds = []
    for turn in range(rounds):
        trees = [ROOT, ROOT, base]
        order = range(3) if turn % 2 else reversed(range(3))
        times = {i: _run(trees[i], CASES[case]).seconds for i in order}
        seconds.append(times[0])
        taken["here to here"].append(times[0] / times[1])
        taken["here to base"].append(times[0] / times[2])
    return {"seconds here": median(seconds)} | {name: median(r) for name, r in taken.items()}


def _run(tree: Path, code: str) -> Run:
    """Run a program of a tree to its end; a node until it is active."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    with (
        claimed_domain() as domain,
        tempfile.TemporaryFile("w+") as out,
        tempfile.TemporaryFile("w+") as log,
    ):
        environment["ROS_DOMAIN_ID"] = str(domain)
        words: Sequence[str] = [sys.executable, "-c", code]
        process = subprocess.Popen(words, cwd=tree, env=environment, stdout=out, stderr=log)
        if "programs" in code:
            while process.poll() is None and "]: active" not in _text(log):
                time.sleep(0.01)
            process.send_signal(signal.SIGINT)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{code} in {tree}:\n{_text(log)}")
        return Run(used.ru_utime + used.ru_stime, _text(out))


def _text(file: Any) -> str:
    """What another process wrote so far."""
    size = os.fstat(file.fileno()).st_size
    return os.pread(file.fileno(), size, 0).decode()


if __name__ == "__main__":
    sys.exit(main())
