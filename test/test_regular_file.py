"""Only regular files are opened, and nobody waits for others."""

import os
import socket

import pytest

from mbd_ros.regular_file import check_regular, open_regular


@pytest.fixture
def places(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # paths of sockets are short
    os.mkfifo("fifo")
    os.symlink("fifo", "link_to_fifo")
    os.symlink("/dev/zero", "device")
    os.mkdir("folder")
    (tmp_path / "file").write_bytes(b"content")
    os.symlink("file", "link")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        yield


@pytest.mark.parametrize("access", [open_regular, check_regular])
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("fifo", "it is a FIFO, not a regular file"),
        ("link_to_fifo", "it is a FIFO, not a regular file"),
        ("socket", "it is a socket, not a regular file"),
        ("device", "it is a device, not a regular file"),
        ("folder", "it is a directory, not a regular file"),
        ("absent", "No such file or directory"),
        ("a\0b", "no file can have this name: embedded null byte"),
    ],
)
def test_what_is_no_regular_file_is_refused_at_once(places, access, name, reason):
    with pytest.raises(OSError, match=reason) as caught:
        access(name)
    assert caught.value.strerror == reason
    assert caught.value.filename == name


@pytest.mark.parametrize("name", ["file", "link"])
def test_regular_files_and_links_to_them_are_read(places, name):
    check_regular(name)
    with open_regular(name) as file:
        assert file.read() == b"content"
        assert not os.get_inheritable(file.fileno())
