"""One command on hostile files in this process, and whether it behaved."""

import contextlib
import csv
import io
import os
import re
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from mbd_ros import cli
from mbd_ros.errors import MbdError
from mbd_ros.files.formats import FORMATS, PICTURES
from mbd_ros.files.table import read_result
from mbd_ros.nodes.shell.params_file import file_warnings

SECONDS = 10.0  # of work: others may use the machine, too
PATIENCE = 120.0  # s in all, for one that waits and does not work
LONGEST = 2000  # characters of a message
NOT_FINITE = re.compile(r"(?<![\w.])(?<!\.\. )[-+]?(nan|inf)(?![\w.]| \.\.)", re.IGNORECASE)
LABELS = re.compile(r"(?m)^recorded and not in the scene: .*")  # names, "inf" among them
CONTROL = re.compile(r"[^\n\x20-\x7e\xa0-\u2027\u202f-\u2065\u2070-\ufefe\uff00-\U0010ffff]")
EARLIER = b"time,earlier\n0.0,1.0\n"


class Case(NamedTuple):
    """Words of a command, and files by name.

    Attributes:
        out: Name of its result, with a slash behind it for a folder; empty without one.
        behind: Regular expression of a refusal that comes when all files have been read.
    """

    words: tuple[str, ...]
    files: Mapping[str, bytes]
    out: str = ""
    behind: str = ""


class Outcome(NamedTuple):
    """What became of a case.

    Attributes:
        faults: What the command did wrong, by its kind; empty for one that behaved.
        passed: Whether it has read its files.
    """

    faults: list[str]
    passed: bool


class Ended(NamedTuple):
    code: int
    said: str  # on stdout
    told: str  # on stderr


class Hang(BaseException):
    """Not an Exception, so that nothing takes it for a fault of the input."""


def faults(case: Case) -> list[str]:
    """What a command did wrong."""
    return tried(case).faults


def tried(case: Case, folder: Path | None = None) -> Outcome:
    """Run a case in a folder of its own, which stands in another one that has to stay as it is."""
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="fuzz") as place:
            return tried(case, Path(place))
    inside, before = folder / "case", Path.cwd()
    for name, data in case.files.items():
        (inside / name).parent.mkdir(exist_ok=True, parents=True)
        (inside / name).write_bytes(data)
    out = inside / case.out if case.out else None
    if out is not None and not case.out.endswith("/"):
        out.write_bytes(EARLIER)
    there = _files_of(folder)
    try:
        os.chdir(inside)  # where relative names lead that are taken as they are
        ended, noise = _run([word.replace("@", f"{inside}/", 1) for word in case.words])
    except Hang:
        return Outcome([f"hang: more than {SECONDS:g} s of work"], passed=False)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is a finding
        return Outcome([_where(error)], passed=False)
    finally:
        os.chdir(before)
    new = _files_of(folder) - there
    left = (name for name in new if "diverged" not in name and not _belongs(name, case.out, ended))
    given = b"".join(case.files.values())
    is_behind = bool(case.behind and re.search(case.behind, ended.told))
    return Outcome(
        [
            *_of_streams(ended, noise, str(inside), given, is_behind),
            *(_of_result(ended.code, out, given) if out is not None else ()),
            *(f"left behind: {name}" for name in left),
        ],
        passed=ended.code < 2 or is_behind,
    )


def _files_of(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def _belongs(name: str, out: str, ended: "Ended") -> bool:
    """Whether a new file is a result: one in the folder of it, or a table beside it."""
    if ended.code == 2 or not out:
        return False
    return name.startswith(f"case/{out if out.endswith('/') else out.partition('.')[0]}")


def _run(words: list[str]) -> tuple[Ended, list[str]]:
    said, told = io.StringIO(), io.StringIO()
    alarms = {signal.SIGPROF: signal.ITIMER_PROF, signal.SIGALRM: signal.ITIMER_REAL}
    before = {alarm: signal.signal(alarm, _hang) for alarm in alarms}
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        with (
            warnings.catch_warnings(record=True) as noise,
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(told),
        ):
            warnings.simplefilter("always")
            try:
                code = _program(words)
            except SystemExit as end:
                code = int(end.code or 0)
    finally:
        for alarm, timer in alarms.items():
            signal.setitimer(timer, 0.0)
            signal.signal(alarm, before[alarm])
    return Ended(code, said.getvalue(), told.getvalue()), [_warned(w) for w in noise]


def _program(words: list[str]) -> int:
    """A command, or what nodes do with a file of parameters before they start."""
    if words[0] != "params-file":
        return cli.main(words)
    try:
        warned = file_warnings(["--params-file", words[1]], "/simulator")
    except MbdError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write("\n".join(warned))
    return 0


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


def _of_streams(
    ended: Ended, noise: list[str], folder: str, given: bytes, is_behind: bool
) -> list[str]:
    found, lines = list(dict.fromkeys(noise)), (ended.said + ended.told).splitlines()
    if ended.code not in (0, 1, 2):
        found.append(f"exit {ended.code}")
    if (
        ended.code == 2
        and not is_behind
        and not (
            str(Path(folder).parent) in ended.told or "--" in ended.told or "-t:" in ended.told
        )
    ):
        found.append(f"names no file: {ended.told[:200]!r}")
    longest = max(map(len, lines), default=0)
    if longest > LONGEST:
        found.append(f"a line of {longest} characters: {max(lines, key=len)[:150]!r}")
    if control := CONTROL.search(ended.said + ended.told):
        around = (ended.said + ended.told)[max(control.start() - 60, 0) : control.end() + 20]
        found.append(f"control character: {around!r}")
    shown = LABELS.sub("", ended.said.replace(folder, ""))
    word = NOT_FINITE.search(shown)
    if ended.code == 0 and word is not None and not _is_name(word, given):
        line = shown[shown.rfind("\n", 0, word.start()) + 1 :].partition("\n")[0]
        found.append(f"exit 0 with {word.group()}: {line[:150]!r}")
    return found


def _is_name(word: re.Match[str], given: bytes) -> bool:
    """Whether the files call something so."""
    return any(f"{quote}{word.group()}{quote}".encode() in given for quote in "'\"")


def _of_result(code: int, out: Path, given: bytes) -> list[str]:
    """What is wrong with a file that was there before, or with a new folder."""
    if out.name == "o":
        texts = (path for path in out.glob("*") if path.suffix in (".yaml", ".urdf", ".csv"))
        words = {path.name: NOT_FINITE.search(path.read_text()) for path in texts}
        wrong = {
            n: word.group() for n, word in words.items() if word and not _is_name(word, given)
        }
        return [f"exit {code} with {word} in {name}" for name, word in wrong.items()]
    data = out.read_bytes()
    if code == 2:
        return [] if data == EARLIER else ["exit 2, and the earlier result is replaced"]
    if code:
        return []
    if data == EARLIER:
        return ["exit 0 without a result"]
    if out.suffix not in FORMATS or out.suffix in PICTURES:
        return [] if data else ["exit 0 with an empty result"]
    tables = {"samples": _columns(data)} if out.suffix == ".csv" else read_result(out).tables
    for name, table in tables.items():
        if not len(next(iter(table.values()), ())):
            return [f"exit 0 with an empty table {name}"]
        for column, values in table.items():
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                return [f"exit 0 with numbers that are not finite in column {column[:60]!r}"]
    return []


def _columns(data: bytes) -> dict[str, np.ndarray]:
    """The columns of numbers of a table as text, which need not be a motion."""
    head, *rows = csv.reader(data.decode().splitlines())
    columns = {}
    for name, *cells in zip(head, *rows, strict=True):
        with contextlib.suppress(ValueError):  # of a column of words
            columns[name] = np.array([float(cell) for cell in cells])
    return columns


def behaves(case: Case) -> None:
    """Fail a test with what a command did wrong."""
    found = faults(case)
    if found:
        pytest.fail("; ".join(found))
