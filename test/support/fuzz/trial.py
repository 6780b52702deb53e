"""One command on hostile files in this process, and whether it behaved."""

import contextlib
import csv
import gzip
import io
import math
import re
import signal
import tempfile
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

from mbd_ros import cli

SECONDS = 10.0
LONGEST = 2000  # characters of a message
NOT_FINITE = re.compile(r"(?<![\w.])[-+]?(nan|inf)(?![\w.])", re.IGNORECASE)
CONTROL = re.compile(r"[^\n\x20-\x7e\xa0-\u2027\u202f-\u2065\u2070-\ufefe\uff00-\U0010ffff]")
EARLIER = b"time,earlier\n0.0,1.0\n"


class Case(NamedTuple):
    """Words of a command, files by name, and the name of its result, if any."""

    words: tuple[str, ...]
    files: Mapping[str, bytes]
    out: str = ""


class Ended(NamedTuple):
    code: int
    said: str  # on stdout
    told: str  # on stderr


class Hang(BaseException):
    """Not an Exception, so that nothing takes it for a fault of the input."""


def faults(case: Case, folder: Path | None = None) -> list[str]:
    """What a command did wrong, by its kind: empty for one that behaved."""
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="fuzz") as place:
            return faults(case, Path(place))
    for name, data in case.files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    out = folder / case.out if case.out else None
    if out is not None:
        out.write_bytes(EARLIER)
    before = {path.name for path in folder.iterdir()}
    try:
        ended, noise = _run([word.replace("@", f"{folder}/") for word in case.words])
    except Hang:
        return [f"hang: more than {SECONDS:g} s"]
    except Exception as error:  # noqa: BLE001 - whatever it is, it is a finding
        return [_where(error)]
    new = {p.name for p in folder.iterdir()} - before
    return [
        *_of_streams(ended, noise, str(folder), b"".join(case.files.values())),
        *_of_result(ended.code, out),
        *(f"left behind: {name}" for name in new if "diverged" not in name),
    ]


def _run(words: list[str]) -> tuple[Ended, list[str]]:
    said, told = io.StringIO(), io.StringIO()
    before = signal.signal(signal.SIGALRM, _hang)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        with (
            warnings.catch_warnings(record=True) as noise,
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(told),
        ):
            warnings.simplefilter("always")
            try:
                code = cli.main(words)
            except SystemExit as end:
                code = int(end.code or 0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    return Ended(code, said.getvalue(), told.getvalue()), [_warned(w) for w in noise]


def _hang(signum: int, frame: object) -> None:
    raise Hang


def _warned(warning: warnings.WarningMessage) -> str:
    where = f"{Path(warning.filename).name}:{warning.lineno}"
    return f"warning: {warning.category.__name__} at {where}: {warning.message}"


def _where(error: Exception) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "mbd_ros/" in frame.filename] or frames
    at = f"{Path(ours[-1].filename).name}:{ours[-1].lineno} {ours[-1].name}"
    return f"traceback: {type(error).__name__} in {at}: {str(error)[:100]!r}"


def _of_streams(ended: Ended, noise: list[str], folder: str, given: bytes) -> list[str]:
    found, lines = list(dict.fromkeys(noise)), (ended.said + ended.told).splitlines()
    if ended.code not in (0, 1, 2):
        found.append(f"exit {ended.code}")
    if ended.code and not (folder in ended.told or "--" in ended.told or "-t:" in ended.told):
        found.append(f"names no file: {ended.told[:200]!r}")
    longest = max(map(len, lines), default=0)
    if longest > LONGEST:
        found.append(f"a line of {longest} characters: {max(lines, key=len)[:150]!r}")
    if control := CONTROL.search(ended.said + ended.told):
        around = (ended.said + ended.told)[max(control.start() - 60, 0) : control.end() + 20]
        found.append(f"control character: {around!r}")
    shown = ended.said.replace(folder, "")
    word = NOT_FINITE.search(shown)
    is_name = word is not None and f"'{word.group()}'".encode() in given
    if ended.code == 0 and word is not None and not is_name:
        line = shown[shown.rfind("\n", 0, word.start()) + 1 :].partition("\n")[0]
        found.append(f"exit 0 with {word.group()}: {line[:150]!r}")
    return found


def _of_result(code: int, out: Path | None) -> list[str]:
    if out is None:
        return []
    data = out.read_bytes()
    if code:
        return [] if data == EARLIER else [f"exit {code}, and the earlier result is replaced"]
    if data == EARLIER:
        return ["exit 0 without a result"]
    text = (gzip.decompress(data) if out.suffix == ".gz" else data).decode()
    rows = list(csv.reader(text.splitlines()))
    if len(rows) < 2:
        return ["exit 0 with an empty result"]
    for row in rows[1:]:
        for name, cell in zip(rows[0], row, strict=True):
            if not math.isfinite(float(cell)):
                return [f"exit 0 with {cell} in the result, column {name[:60]!r}"]
    return []


def behaves(case: Case) -> None:
    """Fail a test with what a command did wrong."""
    found = faults(case)
    if found:
        pytest.fail("; ".join(found))
