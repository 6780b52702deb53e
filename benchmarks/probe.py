"""What one commit computes; run with its tree first on PYTHONPATH by `against.py`.

python probe.py bits [FOLDER]  JSON: scene -> hashes of states, multipliers and tables, kept there
python probe.py at FOLDER      JSON: scene -> how far evaluations are from those kept there
python probe.py run NAME STEPS simulates that many steps of a scene of `COSTS`
"""

import hashlib
import importlib
import json
import re
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from scenes_of_comparison import COSTS, EMBEDDED, PLANTED

from mbd_ros.core.state import State

_LOADERS = ("mbd_ros.api:load_scene", "mbd_ros.scene:load_scene")  # where commits have it
RENAMED = (  # columns: the old name, the new one; equal where what stands in brackets is equal
    (r".+-(.+)\.([xyz])\.multiplier", r"(.+)_loop_closure\.force_([xyz])"),
    (r".+-(.+)\.r([xyz])\.multiplier", r"(.+)_loop_closure\.torque_([xyz])"),
    (r".+-(.+)\.distance#?(\d?)\.multiplier", r"(.+)_distance_?(\d?)\.force"),
    (r".+-(.+)\.normal\.multiplier", r"(.+)_point_on_plane\.force"),
    (r"(.+)\.stop\.multiplier", r"(.*?)_?joint_stop\.torque_?(.*)"),
    (r"(.+)\.friction\.multiplier", r"(.+)_dry_friction\.torque"),
    (r"(.+)\.motion\.multiplier", r"(.+)_prescribed_motion\.(?:torque|force)"),
)
_EFFORT = re.compile(r"multiplier|(force|torque)(_.*)?")  # of one motion, some of them zero
_PROGRAMS = ("mbd_ros.cli:main", "mbd_ros.__main__:main")


def main(words: list[str]) -> None:
    """Do what the words say."""
    if words[0] == "bits":
        json.dump(bits(Path(words[1]) if words[1:] else None), sys.stdout)
    elif words[0] == "at":
        json.dump(differences(Path(words[1])), sys.stdout)
    else:
        run(words[1], int(words[2]))


def bits(kept: Path | None) -> dict[str, dict[str, str]]:
    """Hashes by scene."""
    with tempfile.TemporaryDirectory() as folder:
        return {
            name: _scene_bits(file, seconds, Path(folder), kept and kept / str(i))
            for i, (name, file, seconds) in enumerate(_scenes(Path(folder)))
        }


def differences(kept: Path) -> dict[str, dict[str, float]]:
    """Scene -> how far evaluations are from those of another commit at the same states.

    Differences are relative to the largest value of their quantity.
    """
    with tempfile.TemporaryDirectory() as folder:
        return {
            name: _scene_differences(file, Path(folder), kept / str(i))
            for i, (name, file, _) in enumerate(_scenes(Path(folder)))
        }


def _scenes(folder: Path) -> Iterator[tuple[str, str, float]]:
    """Name, file and seconds of every scene; the file stays until the next one."""
    for name, seconds in EMBEDDED.items():
        yield name, name, seconds
    for name, planted in PLANTED.items():
        path = folder / "scene.yaml"
        path.write_text(planted.text, encoding="utf-8")
        yield name, str(path), planted.seconds


def run(name: str, steps: int) -> None:
    """Simulate a scene of `COSTS`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.yaml"
        path.write_text(COSTS[name].text, encoding="utf-8")
        scene = _first(_LOADERS)(str(path))
    simulation = scene.simulation()
    y = simulation.start(scene.initial)
    simulation.advance(y, None, steps * scene.dt)


def _scene_bits(name: str, seconds: float, folder: Path, kept: Path | None) -> dict[str, str]:
    scene = _first(_LOADERS)(name)
    simulation = scene.simulation()
    states = list(simulation.run(scene.initial, seconds))
    solved = [_solved(simulation.system, x) for x in states]
    found = {
        "states": _hash(np.concatenate([[x.t], x.q, x.v]) for x in states),
        "accelerations": _hash(solution[0] for solution in solved),
        "multipliers": _hash(solution[1] for solution in solved),
    }
    if not scene.robot.floating:
        found |= _table_bits(str(scene.path), seconds, folder)
    if kept is not None:
        kept.mkdir(parents=True)
        t, q, v, *_ = zip(*states, strict=True)
        a, lam = zip(*solved, strict=True)
        np.savez(kept / "states.npz", t=t, q=q, v=v, a=a, l=lam)
        for file in folder.glob("*.csv"):
            file.rename(kept / file.name)
    return found


def _scene_differences(name: str, folder: Path, kept: Path) -> dict[str, float]:
    system = _first(_LOADERS)(name).simulation().system
    before = np.load(kept / "states.npz")
    states = [State(*x) for x in zip(before["t"].tolist(), before["q"], before["v"], strict=True)]
    solved = [_solved(system, x) for x in states]
    found = {
        "accelerations": _relative(before["a"], np.array([now[0] for now in solved])),
        "multipliers": _relative(before["l"], np.array([now[1] for now in solved])),
    }
    if (kept / "torques.csv").is_file() and name.endswith(".yaml"):
        _run(["inverse", name, str(kept / "motion.csv"), "-o", str(folder / "torques.csv")])
        pairs = zip(*(_by_quantity(at / "torques.csv") for at in (kept, folder)), strict=True)
        found["torques"] = max(_relative(*pair) for pair in pairs)
    return found


def _by_quantity(table: Path) -> list[Any]:
    """Columns of a table, those of one quantity in one piece; efforts and multipliers are one."""
    names = table.read_text(encoding="utf-8").partition("\n")[0].split(",")
    values = np.loadtxt(table, delimiter=",", skiprows=1, ndmin=2)
    words = [name.rpartition(".")[2] for name in names]
    quantities = np.array(["effort" if _EFFORT.fullmatch(w) else w for w in words])
    return [values[:, quantities == one] for one in sorted(set(quantities))]


def _relative(before: Any, now: Any) -> float:
    """Largest difference, relative to the largest value."""
    if before.shape != now.shape:
        return float("inf")
    off, size = np.abs(before - now).max(initial=0.0), np.abs(before).max(initial=0.0)
    return float(off / size) if size > 0.0 else float(off)


def _solved(system: Any, x: Any) -> tuple[Any, Any]:
    """Accelerations and multipliers."""
    if hasattr(system, "evaluate"):
        now = system.evaluate(x)
        return now.a, now.lam
    a, lam = system.solve(system.reduce(x))  # commits before `evaluate`
    return a, lam


def _table_bits(name: str, seconds: float, folder: Path) -> dict[str, str]:
    """The tables of `simulate`, and of `inverse` on what it wrote."""
    motion, torques = folder / "motion.csv", folder / "torques.csv"
    found = {}
    for command, out in (
        (["simulate", name, "-t", str(seconds), "-o", str(motion)], motion),
        (["inverse", name, str(motion), "-o", str(torques)], torques),
    ):
        out.unlink(missing_ok=True)
        code = _run(command)
        content = _under_one_name(out.read_bytes() if out.is_file() else b"")
        found[command[0]] = f"{code} {hashlib.sha256(content).hexdigest()}"
    return found


def _run(command: list[str]) -> int:
    """The exit code of the program, which shows nothing."""
    with open("/dev/null", "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
        code: int = _first(_PROGRAMS)(command)
    return code


def _under_one_name(table: bytes) -> bytes:
    """The table with a header that both names of a column give."""
    header, newline, rows = table.partition(b"\n")
    names = [_one_name(name) for name in header.decode().split(",")]
    return ",".join(names).encode() + newline + rows


def _one_name(column: str) -> str:
    for number, names in enumerate(RENAMED):
        for name in names:
            if found := re.fullmatch(name, column):
                return f"{number} {''.join(found.groups())}"
    return column


def _hash(arrays: Iterable[Any]) -> str:
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
    return whole.hexdigest()


def _first(targets: Iterable[str]) -> Any:
    """The first of several `module:name` that this commit has."""
    for target in targets:
        module, _, name = target.partition(":")
        try:
            return getattr(importlib.import_module(module), name)
        except (ModuleNotFoundError, AttributeError):
            continue
    raise SystemExit(f"this commit has none of {', '.join(targets)}")


if __name__ == "__main__":
    main(sys.argv[1:])
