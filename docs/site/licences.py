"""Write the page of licences: `make licences`, or `python docs/site/licences.py PYTHON ..`.

Licences come from the metadata of installed packages, which pip-licenses reads in the environment
of each interpreter named. `licences.csv` has those of packages whose metadata name none, and of
packages that none of these environments holds.
"""

import csv
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tables import table

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/licences.md"
LOOKED_UP = Path(__file__).with_suffix(".csv")
FILES = {
    "pins": "To run and to develop",
    "docs": "To build the pages",
    "report": "For the report, for Dask and for tests in a browser",
    "learn": "To train networks",
    "ziglang": "A C compiler for machines that have none",
    "colcon": "For `make colcon`",
}
_PIN = re.compile(r"^([\w.-]+)==([\w.]+)", re.MULTILINE)
_UNKNOWN = ("UNKNOWN", "OSI Approved")
_HEAD = """\
# Licences

This page lists the licence of every package that the files in `requirements/` pin, so that you
can check what you install. mbd_ros itself is under the Apache-2.0. The recordings that only tests
read have their licences beside them, in `test/data`.

`make licences` writes this page from the metadata of the installed packages. The last column says
where a licence was looked up if the metadata name none, or if `.venv` does not hold the package.

## What to look at

- **qpsolvers** is under the LGPL-3.0. It is required, and imported where a scene names another
  `backend` than `proxqp`. mbd_ros uses it as published, so that you may replace it by a version of
  your own.
- **casadi** is under the LGPL-3.0 or later. Of the extras that users install, only `compiled`
  brings it.
- **quadprog** is under the GPL-2.0 or later. It is for development only: tests compare solutions
  with it, and only the extra `dev` brings it. No module of mbd_ros imports it; a scene that names
  it as `backend` reaches it through qpsolvers, if you installed it.
- **Mosek** and **exudyn** have licences of their own. They belong to the programs that
  `mbd-ros report` compares mbd_ros with.
"""


class Licence(NamedTuple):
    """A licence and, where the metadata of the package do not name it, where it was looked up."""

    text: str
    looked_up_in: str = ""


def main(pythons: Sequence[str]) -> None:
    """Write the page.

    Args:
        pythons: Interpreters of the environments whose packages are read.
    """
    licences = looked_up() | {
        name: licence for python in reversed(pythons) for name, licence in installed(python)
    }
    pins = {name: dict(pinned(name)) for name in FILES}
    lacking = {p for names in pins.values() for p in names if plain(p) not in licences}
    if lacking:
        words = ", ".join(sorted(lacking))
        sys.exit(f"no licence of {words}: look it up and add it to {LOOKED_UP}")
    PAGE.write_text(page(licences), encoding="utf-8")


def page(licences: Mapping[str, Licence]) -> str:
    """The page as Markdown."""
    pieces = [_HEAD]
    for name, title in FILES.items():
        rows = ((pin, version, *licences[plain(pin)]) for pin, version in pinned(name))
        pieces += [
            f"## {title}\n\nPinned in `requirements/{name}.txt`:\n",
            table(("package", "version", "licence", "looked up in"), rows),
        ]
    return "\n".join(pieces)


def pinned(name: str) -> list[tuple[str, str]]:
    """Names and versions of a file of requirements."""
    return _PIN.findall((ROOT / f"requirements/{name}.txt").read_text(encoding="utf-8"))


def installed(python: str) -> Iterator[tuple[str, Licence]]:
    """Plain names of the packages of an environment, each with the licence that it names."""
    words = [sys.executable, "-m", "piplicenses", "--python", python]
    words += ["--from=all", "--format=json", "--with-system"]
    found = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    for package in json.loads(found):
        kinds = ("License-Expression", "License-Classifier", "License-Metadata")
        named = [package[kind] for kind in kinds if package[kind] not in _UNKNOWN]
        if named:
            yield plain(package["Name"]), Licence(named[0].splitlines()[0])


def looked_up() -> dict[str, Licence]:
    """Plain names of the packages of `licences.csv` and their licences."""
    with LOOKED_UP.open(encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file)
        return {plain(r["package"]): Licence(r["licence"], r["looked up in"]) for r in rows}


def plain(name: str) -> str:
    """The name of a package as PyPI compares it."""
    return re.sub("[-_.]+", "-", name).lower()


if __name__ == "__main__":
    main(sys.argv[1:])
