"""`make fuzz`: commands on mutated files, in processes of this machine; every case has a seed.

python -m fuzz.run --cases 10000 --seed 1        mutated scenes, URDFs, tables and bags
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
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fuzz import bags, scenes, tables, urdf
from fuzz.trial import Case, faults

MEMORY = 4 * 1024**3
STUCK = 60.0  # s after which a case that never comes back to Python ends its worker
SCENE = b'{"robot": {"urdf": "r.urdf"}}'


def scene_case(rng: random.Random) -> Case:
    scene = scenes.mutated(rng)
    files = {
        "s.yaml": scene.text.encode("utf-8", "surrogatepass"),
        "r.urdf": scene.urdf.encode("utf-8", "surrogatepass"),
    }
    if rng.random() < 0.15:
        return Case(("check", "@s.yaml"), files)
    if rng.random() < 0.2:
        joints = tuple(f"j{i}" for i in range(1, 7))
        motion = {"m.csv": tables.table(rng, joints)}
        return Case(("inverse", "@s.yaml", "@m.csv", "-o", "@o.csv"), files | motion, "o.csv")
    words = ("simulate", "@s.yaml", "-t", "0.003", "-o", "@o.csv")
    if rng.random() < 0.2:
        words = (*words, "--integrator", rng.choice(tuple(scenes.PARTS["integrators"])))
    return Case(words, files, "o.csv")


def urdf_case(rng: random.Random) -> Case:
    robot = urdf.mutated(rng)
    files = {"s.yaml": SCENE, "r.urdf": robot.text.encode("utf-8", "surrogatepass")}
    if rng.random() < 0.3:
        return Case(("check", "@s.yaml"), files)
    if rng.random() < 0.5:
        files["m.csv"] = tables.table(rng, robot.joints)
        return Case(("inverse", "@s.yaml", "@m.csv", "-o", "@o.csv"), files, "o.csv")
    return Case(("simulate", "@s.yaml", "-t", "0.002", "-o", "@o.csv"), files, "o.csv")


def table_case(rng: random.Random) -> Case:
    robot = urdf.robot(rng, 3)
    name, data = tables.mutated(rng, robot.joints)
    files = {"s.yaml": SCENE, "r.urdf": robot.text.encode(), name: data}
    draw = rng.random()
    if draw < 0.6:
        derivatives = rng.choice(("given", "causal", "zero-phase"))
        words = ("inverse", "@s.yaml", f"@{name}", "-o", "@o.csv", "--derivatives", derivatives)
    else:
        option = rng.choice(("--from", "--efforts"))
        words = ("simulate", "@s.yaml", "-t", "0.002", "-o", "@o.csv", option, f"@{name}")
    return Case(words, files, "o.csv")


def bag_case(rng: random.Random) -> Case:
    name, files = bags.mutated(rng)
    robot = two_joints()
    files = {"s.yaml": SCENE, "r.urdf": robot.encode(), **files}
    words = ("inverse", "@s.yaml", f"@{name}", "-o", "@o.csv", "--derivatives", "causal")
    return Case(words, files, "o.csv")


def two_joints() -> str:
    seed = 0
    while True:
        robot = urdf.robot(random.Random(seed), 2)
        if robot.joints == bags.JOINTS and "<mimic" not in robot.text:
            return robot.text
        seed += 1


KINDS: dict[str, Callable[[random.Random], Case]] = {
    "scenes": scene_case,
    "urdf": urdf_case,
    "tables": table_case,
    "bags": bag_case,
}
SHARES = {"scenes": 6, "urdf": 2, "tables": 1, "bags": 1}


def case_of(name: str) -> Case:
    """The case of a seed such as scenes:1234."""
    return KINDS[name.partition(":")[0]](random.Random(name))


def names(seed: int, count: int, kinds: list[str]) -> list[str]:
    """Names of cases, kinds mixed by their shares."""
    mix = [kind for kind in kinds for _ in range(SHARES[kind])]
    return [f"{mix[i % len(mix)]}:{seed + i}" for i in range(count)]


def quick() -> None:
    """Let `check` time one call instead of thousands: here its lines count, not its cost."""
    import mbd_ros.scene.describe.check

    mbd_ros.scene.describe.check.MEASURED = 0.0


def _work(name_list: list[str], results: Any) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    quick()
    for name in name_list:
        results.send((name, None))
        faulthandler.dump_traceback_later(STUCK, exit=True)
        found = faults(case_of(name))
        faulthandler.cancel_dump_traceback_later()
        results.send((name, found))
    results.close()


def fuzz(todo: list[str], workers: int) -> dict[str, list[str]]:
    """Faults by the name of the case."""
    context, found = multiprocessing.get_context("spawn"), {}
    waiting = [todo[i::workers] for i in range(workers)]
    running: dict[Any, tuple[Any, list[str], int]] = {}
    for part in waiting:
        _start(context, running, part)
    while running:
        for results in multiprocessing.connection.wait(list(running)):
            process, part, done = running[results]
            try:
                name, faults_of = results.recv()
            except EOFError:
                del running[results]
                process.join()
                if done < len(part):
                    found[part[done]] = [f"the process died with exit code {process.exitcode}"]
                    _start(context, running, part[done + 1 :])
                continue
            if faults_of is not None:
                running[results] = process, part, done + 1
                if faults_of:
                    found[name] = faults_of
    return found


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
    found = faults(case, keep)
    sys.stdout.write("\n".join(found or ["nothing is wrong"]) + "\n")
    return int(bool(found))


def _kind(fault: str) -> str:
    """What faults of one cause have in common."""
    return fault[:110]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**9))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--workers", type=int, default=multiprocessing.cpu_count())
    parser.add_argument("--only", help="one case, such as scenes:1234")
    parser.add_argument("--keep", type=Path, help="new folder for the files of that case")
    words = parser.parse_args()
    if words.only:
        return _one(words.only, words.keep)
    begin = time.monotonic()
    found = fuzz(names(words.seed, words.cases, words.kinds), words.workers)
    wall = time.monotonic() - begin
    kinds: Counter[str] = Counter()
    first: dict[str, tuple[str, str]] = {}
    for name, faults_of in found.items():
        for fault in faults_of:
            kinds[_kind(fault)] += 1
            first.setdefault(_kind(fault), (name, fault))
    for kind, count in kinds.most_common():
        name, fault = first[kind]
        sys.stdout.write(f"{count:5}  {name}: {fault}\n")
    sys.stdout.write(
        f"seed {words.seed}: {words.cases} cases in {wall:.0f} s, {len(found)} with faults; "
        "python -m fuzz.run --only KIND:SEED repeats one\n"
    )
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
