"""Faults while a scene is compiled, kept and loaded: a correct run or a clear error."""

import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import pytest
from deadline import DEADLINE, until

from mbd_ros.compiled.build import library as building
from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.emit import emit

CHILD = """
import casadi as ca
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.emit import emit
from mbd_ros.errors import MbdError
x = ca.SX.sym("x")
try:
    source = emit([ca.Function("f", [x], [2 * x * x])])
    library = load(source, lambda line: print(line, flush=True))
except MbdError as error:
    raise SystemExit(f"error: {error}")
f = library.function("f")
f.arguments[0][:] = 3.0
f()
print(f.results[0][0])
"""
COMPILER = """#!/bin/sh
echo called >> {folder}/calls
while test -e {folder}/hold; do sleep 0.02; done
exec {cc} "$@"
"""
TELLTALE = '__attribute__((constructor)) void run(void) { fclose(fopen("MARK", "w")); }'


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The cache folder of a user who has compiled nothing yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.delenv("CC", raising=False)
    return tmp_path / "xdg/mbd_ros/compiled"


@pytest.fixture
def slow(tmp_path, monkeypatch):
    """A folder; while it has a file `hold` the compiler waits, and `calls` has a line a call."""
    program = tmp_path / "slow_cc"
    program.write_text(COMPILER.format(folder=tmp_path, cc=shutil.which("cc")))
    program.chmod(0o700)
    monkeypatch.setenv("CC", str(program))
    (tmp_path / "hold").touch()
    return tmp_path


def squared(said=None):
    """2 * 3 * 3, compiled."""
    x = ca.SX.sym("x")
    source = emit([ca.Function("f", [x], [2 * x * x])])
    f = load(source, (lambda line: None) if said is None else said.append).function("f")
    f.arguments[0][:] = 3.0
    f()
    return f.results[0][0]


def entry(cache):
    (path,) = cache.glob("*.so")
    return path


def start(*before, **more):
    words = [*before, sys.executable, "-c", CHILD]
    return subprocess.Popen(
        words, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **more
    )


def test_the_second_time_nothing_is_compiled(cache):
    first, second = [], []
    assert squared(first) == squared(second) == 18.0
    assert first[0] == f"compiling 2 operations by {shutil.which('cc')}"
    assert first[1].startswith("compiled in ") and second == []
    assert cache.stat().st_mode & 0o777 == 0o700


def test_a_process_killed_during_compilation_leaves_nothing_that_counts(cache, slow):
    child = start()
    until(lambda: list(cache.glob("*.part")))
    child.send_signal(signal.SIGKILL)
    child.communicate()
    assert list(cache.glob("*.part")) and not list(cache.glob("*.so"))
    (slow / "hold").unlink()
    assert squared() == 18.0
    assert not list(cache.glob("*.part")) and entry(cache)


def test_an_interrupted_compilation_ends_its_compiler(cache, slow):
    child = start()
    until(lambda: (slow / "calls").exists())
    child.send_signal(signal.SIGINT)
    child.communicate()
    (slow / "hold").unlink()
    time.sleep(0.2)  # a compiler that goes on would write now
    assert not list(cache.glob("*.part")) and not list(cache.glob("*.so"))


def test_two_processes_that_want_the_same_scene_compile_it_once(cache, slow):
    first = start()
    until(lambda: (slow / "calls").exists())
    second = start()
    assert second.stdout.readline() == "another process compiles the same code: waiting for it\n"
    (slow / "hold").unlink()
    assert first.communicate()[0].endswith("18.0\n")
    assert second.communicate()[0] == "18.0\n"
    assert (slow / "calls").read_text() == "called\n"


def test_a_full_disk_under_the_cache_folder_is_passed_by(cache):
    cache.mkdir(parents=True)
    script = f'mount -t tmpfs -o size=8k,mode=700 none {cache} && exec "$@"'
    child = start("unshare", "-rm", "sh", "-c", script, "sh")
    said = child.communicate()[0]
    if "unshare" in said or "mount" in said:
        pytest.skip("file systems cannot be mounted here")
    assert "not kept: " in said and said.endswith("18.0\n")


@pytest.mark.parametrize("room", [100, 9000])
def test_without_room_for_any_file_the_error_says_so(cache, room):
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))\n"
    words = [sys.executable, "-c", limit + CHILD]
    ran = subprocess.run(words, capture_output=True, text=True)
    assert ran.returncode == 1 and "Traceback" not in ran.stderr
    assert ran.stderr.startswith("error: ")
    assert "File too large" in ran.stderr or "File size limit exceeded" in ran.stderr


@pytest.mark.parametrize(
    ("script", "match"),
    [
        ("echo 'no licence' >&2; exit 3", r"(?s)ended with exit code 3.*no licence"),
        ("kill -9 $$", "was ended by signal 9"),
        ("exit 0", "ended without an error but wrote no library"),
        (
            'while test "$1" != -o; do shift; done; echo no > $2',
            "the compiled library cannot be loaded",
        ),
    ],
)
def test_a_compiler_that_fails_is_named(cache, tmp_path, monkeypatch, script, match):
    program = tmp_path / "broken_cc"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o700)
    monkeypatch.setenv("CC", str(program))
    with pytest.raises(BuildError, match=match):
        squared()
    assert not list(cache.glob("*.part"))


def test_a_compiler_that_is_missing_is_named(cache, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "no_such_cc -O1")
    with pytest.raises(BuildError, match=r"the variable CC names 'no_such_cc', which is not a"):
        squared()
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("mbd_ros.compiled.build.compiler.find_spec", lambda name: None)
    with pytest.raises(BuildError, match=r"no C compiler found: none of cc, gcc, clang on the"):
        squared()


@pytest.mark.skipif(find_spec("ziglang") is None, reason="ziglang is not installed")
def test_ziglang_stands_in_where_there_is_no_compiler(cache, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    said = []
    assert squared(said) == 18.0 and said[0].endswith("-m ziglang cc")


def test_a_library_for_another_processor_is_not_executed(cache, monkeypatch):
    with monkeypatch.context() as other:
        other.setattr(building, "cpu", lambda: "another processor")
        squared()
    foreign, said = entry(cache), []
    squared(said)
    assert said[0].startswith("compiling") and len(list(cache.glob("*.so"))) == 2
    (own,) = {*cache.glob("*.so")} - {foreign}
    own.write_bytes(foreign.read_bytes())
    squared(said)
    assert said[2].startswith("compiling") and own.read_bytes() != foreign.read_bytes()


def cut(library, _):
    os.truncate(library, library.stat().st_size // 2)


def emptied(library, _):
    os.truncate(library, 0)


def changed(library, _):
    content = bytearray(library.read_bytes())
    content[len(content) // 2] ^= 1
    library.write_bytes(content)


def replaced(library, folder):
    """By one that leaves a mark when it is loaded."""
    text = "#include <stdio.h>\n" + TELLTALE.replace("MARK", str(folder / "mark"))
    (folder / "mark.c").write_text(text)
    words = ["cc", "-shared", "-fPIC", "-o", library, folder / "mark.c"]
    subprocess.run(words, check=True)


def opened(library, _):
    """To others, who may have written it."""
    library.chmod(0o777)


def linked(library, folder):
    """To a good one, which may be another one later."""
    library.rename(folder / "elsewhere.so")
    library.symlink_to(folder / "elsewhere.so")


def piped(library, _):
    """Nobody writes to it: who opens it to read waits for ever."""
    library.unlink()
    os.mkfifo(library)


@pytest.mark.parametrize("spoil", [cut, emptied, changed, replaced, opened, linked, piped])
def test_an_entry_that_cannot_be_trusted_is_built_again(cache, tmp_path, spoil):
    assert squared() == 18.0
    spoil(entry(cache), tmp_path)
    said = []
    assert squared(said) == 18.0 and said[0].startswith("compiling")
    assert not (tmp_path / "mark").exists()
    assert squared(said) == 18.0 and len(said) == 2


def test_a_folder_in_the_place_of_an_entry_is_passed_by(cache):
    squared()
    path = entry(cache)
    path.unlink()
    path.mkdir()
    said = []
    assert squared(said) == 18.0 and said[-1].startswith("not kept: ")


def lock_linked(lock, folder):
    (folder / "precious").write_text("precious")
    lock.symlink_to(folder / "precious")


def lock_piped(lock, _):
    os.mkfifo(lock)


def lock_folder(lock, _):
    lock.mkdir()


@pytest.mark.parametrize(
    ("plant", "kind"),
    [(lock_linked, "a symbolic link"), (lock_piped, "a FIFO"), (lock_folder, "a directory")],
)
def test_what_is_no_lock_is_passed_by(cache, tmp_path, plant, kind):
    squared()
    library = entry(cache)
    library.unlink()
    lock = library.with_suffix(".lock")
    lock.unlink()
    plant(lock, tmp_path)
    said = []
    assert squared(said) == 18.0 and not library.exists()
    assert said[-1] == f"not kept: {lock}: it is {kind}, not a regular file"
    if kind == "a symbolic link":
        assert (tmp_path / "precious").read_text() == "precious"


@pytest.mark.parametrize("above", [0, 1])
def test_a_cache_folder_that_is_a_link_is_passed_by(cache, tmp_path, above):
    squared()
    folder = [cache, cache.parent][above]
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    said = []
    assert squared(said) == 18.0
    assert said[-1] == f"not kept: {folder} is a symbolic link; replace it by a folder"


def test_a_link_in_the_place_of_a_part_is_not_followed(cache, tmp_path):
    squared()
    library = entry(cache)
    library.unlink()
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious/file").touch()
    library.with_suffix(".left.part").symlink_to(tmp_path / "precious")
    assert squared() == 18.0 and entry(cache) == library
    assert (tmp_path / "precious/file").exists()


@pytest.mark.parametrize("mode", [0o777, 0o770])
def test_a_cache_that_others_can_write_is_not_used(cache, mode):
    squared()
    replaced(entry(cache), cache.parent)
    cache.chmod(mode)
    said = []
    assert squared(said) == 18.0
    assert said[-1] == f"not kept: {cache} can be written by others: chmod go-w {cache}"
    assert not (cache.parent / "mark").exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_what_belongs_to_another_user_is_not_executed(cache):
    squared()
    said = []
    os.chown(entry(cache), 12345, -1)
    assert squared(said) == 18.0 and said[0].startswith("compiling")
    os.chown(cache, 12345, -1)
    assert squared(said) == 18.0
    assert said[-1] == f"not kept: {cache} belongs to another user"


def test_a_cache_folder_that_cannot_be_made_is_passed_by(cache):
    cache.parents[1].write_text("a file where the folder should be")
    said = []
    assert squared(said) == 18.0
    assert "Not a directory" in said[-1] or "File exists" in said[-1]


def test_a_user_without_a_home_compiles_each_time(cache, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "relative/is/not/meant")
    monkeypatch.setenv("HOME", "relative")
    said = []
    assert squared(said) == 18.0
    reason = "the user has no home folder; set XDG_CACHE_HOME to an absolute path"
    assert said[-1] == f"not kept: {reason}"


def test_what_was_not_used_for_long_is_removed(cache, monkeypatch):
    squared()
    used = entry(cache)
    os.utime(used, (0, time.time() - 80 * 86400))
    squared()
    assert time.time() - used.stat().st_mtime < DEADLINE
    os.utime(used, (0, time.time() - 100 * 86400))
    monkeypatch.setattr(building, "cpu", lambda: "another processor")
    squared()
    assert entry(cache) != used


def test_what_a_check_refuses_is_compiled_again_once(cache):
    x, asked, said = ca.SX.sym("x"), [], []
    source = emit([ca.Function("f", [x], [2 * x * x])])

    def refuse(library):
        asked.append(library)
        raise BuildError("wrong numbers")

    with pytest.raises(BuildError, match="wrong numbers"):
        load(source, said.append, refuse)
    assert len(asked) == 2 and "compiling again: wrong numbers" in said
    assert Path(cache).is_dir()
