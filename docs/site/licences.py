"""Generate the page of licences: `make licences`, or `python docs/site/licences.py PYTHON ..`.

Licences come from the metadata of installed packages, which pip-licenses reads in the environment
of each interpreter. `licences.csv` has the licences of packages without such metadata, and of
packages that none of these environments contains.
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

With this page you can check the licence of every package that the files in `requirements/` pin.
mbd_ros itself is under the Apache-2.0.

`make licences` generates this page from the metadata of the installed packages. The last column
names the place in which a licence was looked up if the metadata do not state it. The recordings in
`test/data` have their licences beside them.

## What to look at

- **qpsolvers** is under the LGPL-3.0. It is required, and imported if a scene names another
  `backend` than `proxqp`. mbd_ros uses it unchanged, so you may replace it by your own version.
- **casadi** is under the LGPL-3.0 or later. The extra `compiled` installs it.
- **quadprog** is under the GPL-2.0 or later. Only the extra `dev` installs it: tests compare
  solutions with it. No module of mbd_ros imports it; a scene that names it as `backend` reaches it
  through qpsolvers, if you installed it.
- **Mosek** and **exudyn** have licences of their own. They belong to the programs with which
  `mbd-ros report` compares mbd_ros.
"""


class Licence(NamedTuple):
    """A licence and, where the metadata of the package do not name it, where it was looked up."""

    text: str
    looked_up_in: str = ""


def main(pythons: Sequence[str]) -> None:
    """Write the page.

    Args:
        pythons: Interpreters of the environments to read.
    """
    licences = looked_up() | {
        name: licence for python in reversed(pythons) for name, licence in installed(python)
    }
    pins = {name: dict(pinned(name)) for name in FILES}
    missing = {p for names in pins.values() for p in names if plain(p) not in licences}
    if missing:
        names = ", ".join(sorted(missing))
        sys.exit(f"the licence of {names} is unknown: look it up and add it to {LOOKED_UP}")
    PAGE.write_text(page(licences), encoding="utf-8")


def page(licences: Mapping[str, Licence]) -> str:
    """Return the page as Markdown."""
    pieces = [_HEAD]
    for name, title in FILES.items():
        rows = ((pin, version, *licences[plain(pin)]) for pin, version in pinned(name))
        pieces += [
            f"## {title}\n\nPinned in `requirements/{name}.txt`:\n",
            table(("package", "version", "licence", "looked up in"), rows),
        ]
    return "\n".join(pieces)


def pinned(name: str) -> list[tuple[str, str]]:
    """Return names and versions of a file of requirements."""
    return _PIN.findall((ROOT / f"requirements/{name}.txt").read_text(encoding="utf-8"))


def installed(python: str) -> Iterator[tuple[str, Licence]]:
    """Yield the plain name and licence of each package in an environment."""
    command = [sys.executable, "-m", "piplicenses", "--python", python]
    command += ["--from=all", "--format=json", "--with-system"]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    for package in json.loads(output):
        kinds = ("License-Expression", "License-Classifier", "License-Metadata")
        named = [package[kind] for kind in kinds if package[kind] not in _UNKNOWN]
        if named:
            yield plain(package["Name"]), Licence(named[0].splitlines()[0])


def looked_up() -> dict[str, Licence]:
    """Return the licences of `licences.csv` by the plain names of packages."""
    with LOOKED_UP.open(encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file)
        return {plain(r["package"]): Licence(r["licence"], r["looked up in"]) for r in rows}


def plain(name: str) -> str:
    """Return the name of a package as PyPI compares it."""
    return re.sub("[-_.]+", "-", name).lower()


if __name__ == "__main__":
    main(sys.argv[1:])
