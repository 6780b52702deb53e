"""`make fuzz`: commands on mutated files, in processes of this machine; every case has a seed.

python -m fuzz.run --cases 1000 --seed 1         so many of each kind of file that is read
python -m fuzz.run --only scenes:1234 --keep X   one case again, its files kept in folder X
"""

import argparse
import faulthandler
import multiprocessing
import multiprocessing.connection
import random
import resource
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fuzz.kinds import KINDS, case_of
from fuzz.trial import Outcome, tried

MEMORY = 4 * 1024**3  # that a case may ask for, beyond what a worker has reserved
STUCK = 300.0  # s after which a case that never comes back to Python ends its worker
CASES = 100  # of each kind
FEWEST = 0.1  # share of the cases of a kind that have to pass their reader
ENOUGH = 50  # cases of a kind, to say so


def names(seed: int, count: int, kinds: Sequence[str]) -> list[str]:
    """Names of cases, so many of each kind."""
    return [f"{kind}:{seed + i}" for i in range(count) for kind in kinds]


def quick() -> None:
    """Let `check` time one call instead of thousands: here its lines count, not its cost."""
    import mbd_ros.scene.describe.check

    mbd_ros.scene.describe.check.MEASURED = 0.0


def _work(name_list: list[str], results: Any) -> None:
    quick()
    for name in name_list:
        results.send((name, None))
        _limit_memory()
        faulthandler.dump_traceback_later(STUCK, exit=True)
        outcome = tried(case_of(name))
        faulthandler.cancel_dump_traceback_later()
        results.send((name, outcome))
    results.close()


def _limit_memory() -> None:
    """Let memory grow by so much: libraries reserve gigabytes that they never touch."""
    reserved = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (reserved + MEMORY, resource.RLIM_INFINITY))


def fuzz(todo: list[str], workers: int) -> dict[str, Outcome]:
    """What became of each case, by its name."""
    context, found = multiprocessing.get_context("spawn"), {}
    known: Counter[str] = Counter()
    waiting = [todo[i::workers] for i in range(workers)]
    running: dict[Any, tuple[Any, list[str], int]] = {}
    for part in waiting:
        _start(context, running, part)
    while running:
        for results in multiprocessing.connection.wait(list(running)):
            process, part, done = running[results]
            try:
                name, outcome = results.recv()
            except EOFError:
                del running[results]
                process.join()
                if done < len(part):
                    died = f"the process died with exit code {process.exitcode}"
                    found[part[done]] = Outcome([died], passed=False)
                    _tell_first(part[done], found[part[done]], known)
                    _start(context, running, part[done + 1 :])
                continue
            if outcome is not None:
                running[results] = process, part, done + 1
                found[name] = outcome
                _tell_first(name, outcome, known)
    for fault, count in known.most_common():
        sys.stdout.write(f"{count:5}  {fault}\n")
    return found


def _tell_first(name: str, outcome: Outcome, known: Counter[str]) -> None:
    """Say a fault as soon as it is there, once for those of one cause."""
    for fault in outcome.faults:
        kind = fault[:110]
        if not known[kind]:
            sys.stdout.write(f"{name}: {fault}\n")
            sys.stdout.flush()
        known[kind] += 1


def _start(context: Any, running: dict[Any, Any], part: list[str]) -> None:
    if part:
        mine, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(part, theirs))
        process.start()
        theirs.close()
        running[mine] = process, part, 0


def _one(name: str, keep: Path | None) -> int:
    quick()
    if keep is not None:
        keep.mkdir(parents=True)
    case = case_of(name)
    sys.stdout.write(" ".join(("mbd-ros", *case.words)) + "\n")
    outcome = tried(case, keep)
    read = "the files were read" if outcome.passed else "the files were refused"
    sys.stdout.write("\n".join([read, *(outcome.faults or ["nothing is wrong"])]) + "\n")
    return int(bool(outcome.faults))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=CASES, help="of each kind")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**9))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--workers", type=int, default=multiprocessing.cpu_count())
    parser.add_argument("--only", help="one case, such as scenes:1234")
    parser.add_argument("--keep", type=Path, help="new folder for the files of that case")
    words = parser.parse_args()
    if words.only:
        return _one(words.only, words.keep)
    begin = time.monotonic()
    outcomes = fuzz(names(words.seed, words.cases, words.kinds), words.workers)
    wall = time.monotonic() - begin
    few = _tell_shares(outcomes)
    count = sum(bool(outcome.faults) for outcome in outcomes.values())
    sys.stdout.write(
        f"seed {words.seed}: {len(outcomes)} cases in {wall:.0f} s, {count} with faults; "
        "python -m fuzz.run --only KIND:SEED repeats one\n"
    )
    return int(bool(count or few))


def _tell_shares(outcomes: dict[str, Outcome]) -> list[str]:
    """Say how many cases passed their reader; the kinds of which too few did."""
    cases: Counter[str] = Counter(name.partition(":")[0] for name in outcomes)
    passed = Counter(name.partition(":")[0] for name, one in outcomes.items() if one.passed)
    shares = {kind: passed[kind] / count for kind, count in cases.items()}
    sys.stdout.write("read and not refused, % of the cases: ")
    sys.stdout.write(", ".join(f"{k} {100 * share:.0f}" for k, share in shares.items()) + "\n")
    few = [kind for kind, share in shares.items() if cases[kind] >= ENOUGH and share < FEWEST]
    for kind in few:
        sys.stdout.write(f"{kind}: fewer than {100 * FEWEST:g} % of the cases pass their reader\n")
    return few


if __name__ == "__main__":
    sys.exit(main())
