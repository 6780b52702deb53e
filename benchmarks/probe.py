"""What one commit computes; run with its tree first on PYTHONPATH by `against.py`.

python probe.py bits           JSON: scene -> hashes of states, multipliers and tables
python probe.py run NAME STEPS simulates that many steps of a scene of `COSTS`
"""

import hashlib
import importlib
import json
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scenes_of_comparison import COSTS, EMBEDDED, PLANTED

_LOADERS = ("mbd_ros.scene.reader:load_scene", "mbd_ros.scene:load_scene")  # where commits have it
_PROGRAMS = ("mbd_ros.cli:main", "mbd_ros.__main__:main")


def main(words: list[str]) -> None:
    """Do what the words say."""
    if words[0] == "bits":
        json.dump(bits(), sys.stdout)
    else:
        run(words[1], int(words[2]))


def bits() -> dict[str, dict[str, str]]:
    """Hashes by scene; an error of the package is its own text."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, seconds in EMBEDDED.items():
            found[name] = _scene_bits(name, seconds, Path(folder))
        for name, planted in PLANTED.items():
            path = Path(folder) / "scene.yaml"
            path.write_text(planted.text, encoding="utf-8")
            found[name] = _scene_bits(str(path), planted.seconds, Path(folder))
    return found


def run(name: str, steps: int) -> None:
    """Simulate a scene of `COSTS`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.yaml"
        path.write_text(COSTS[name].text, encoding="utf-8")
        scene = _first(_LOADERS)(str(path))
    simulation = scene.simulation()
    y = simulation.start(scene.initial)
    simulation.advance(y, None, steps * scene.dt)


def _scene_bits(name: str, seconds: float, folder: Path) -> dict[str, str]:
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
    return found


def _solved(system: Any, x: Any) -> tuple[Any, Any]:
    """Accelerations and multipliers."""
    if hasattr(system, "evaluate"):
        now = system.evaluate(x)
        return now.a, now.lam
    a, lam = system.solve(system.reduce(x))  # commits before `evaluate`
    return a, lam


def _table_bits(name: str, seconds: float, folder: Path) -> dict[str, str]:
    """The tables of `simulate`, and of `inverse` on what it wrote."""
    program, motion, torques = _first(_PROGRAMS), folder / "motion.csv", folder / "torques.csv"
    found = {}
    for command, out in (
        (["simulate", name, "-t", str(seconds), "-o", str(motion)], motion),
        (["inverse", name, str(motion), "-o", str(torques)], torques),
    ):
        out.unlink(missing_ok=True)
        with open("/dev/null", "w", encoding="utf-8") as nowhere:
            sys.stdout, shown = nowhere, sys.stdout
            try:
                code = program(command)
            finally:
                sys.stdout = shown
        content = out.read_bytes() if out.is_file() else b""
        found[command[0]] = f"{code} {hashlib.sha256(content).hexdigest()}"
    return found


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
