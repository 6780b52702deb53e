"""Compressed files that are hostile, damaged or large: refused in words, within a bound."""

import io
import zipfile
import zlib

import numpy as np
import pytest

from mbd_ros import gzip_file, npz_file
from mbd_ros.errors import DataError
from mbd_ros.files.table import MAIN, Column, Result, Table, read_result
from mbd_ros.files.tables import parquet
from mbd_ros.gzip_file import unpacked_gzip
from mbd_ros.npz_file import read_arrays

ARRAYS = {
    "matrix": np.arange(6.0).reshape(2, 3),
    "in_columns": np.asfortranarray(np.arange(6).reshape(2, 3)),
    "text": np.array("a\N{GREEK SMALL LETTER ALPHA}"),
    "texts": np.array(["a", "bc"]),
    "truth": np.array([True, False]),
    "complex": np.array([1j]),
    "empty": np.zeros((0, 3), np.int8),
    "big": np.arange(3.0, dtype=">f4"),
}


def npy(header, content=bytes(8), version=b"\x01\x00"):
    text = header.encode() + b"\n"
    length = len(text).to_bytes(2 if version[:1] == b"\x01" else 4, "little")
    return b"\x93NUMPY" + version + length + text + content


def header_of(shape="(1,)", dtype="<f8"):
    return f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"


def archive(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            packed.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_are_those_of_numpy(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    read = read_arrays(tmp_path / "a.npz", "arrays")
    assert list(read) == list(ARRAYS)
    for name, values in ARRAYS.items():
        assert read[name].dtype == values.dtype and read[name].shape == values.shape
        assert (read[name] == values).all() and read[name].flags.writeable


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy(header_of("(2,)")), r"fewer bytes than shape \(2,\) of float64 needs"),
        (npy(header_of("(0,)")), "more bytes than"),
        (npy(header_of("(1000000000000,)")), "more than 2000000000 bytes"),
        (npy(header_of("(0, 1000000000000)"), b""), "more than 2000000000 bytes"),
        (npy(header_of("(-1,)")), "must be numbers"),
        (npy(header_of("[1]")), "must be numbers"),
        (npy(header_of("1")), "must be numbers"),
        (npy(header_of(f"({'1, ' * 100})")), "array x: "),
        (npy(header_of("(1" + "0" * 5000 + ",)")), "array x: "),
        (npy(header_of(dtype="|O")), "must be numbers"),
        (npy(header_of(dtype="<f3"), bytes(3)), "numpy has no type <f3"),
        (npy(header_of("(1,)", "<U1"), b"\xff" * 4), "invalid characters"),
        (
            npy("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }"),
            "must be numbers",
        ),
        (npy("{'descr': '<f8', 'shape': (1,), }"), "must be numbers"),
        (npy("(" * 9000), "must be numbers"),
        (npy("{'descr': '''"), "must be numbers"),
        (npy(header_of() + " " * 20_000), "must be numbers"),
        (npy(header_of(), version=b"\x09\x00"), "not in .npy format"),
        (b"\x80\x04\x95cos\nsystem\n", "not in .npy format"),
        (b"\x93NUMPY\x01\x00\x01", "is damaged"),
        (b"", "not in .npy format"),
    ],
)
def test_every_broken_array_is_refused_in_words(tmp_path, content, message):
    path = archive(tmp_path / "a.npz", x=content)
    with pytest.raises(DataError, match=message) as caught:
        read_arrays(path, "a table of arrays")
    assert str(caught.value).startswith(f"{path}: is damaged, or not a table of arrays (")


def test_every_cut_or_altered_archive_is_refused_or_reads_well(tmp_path):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, values=np.random.default_rng(0).random(8))
    good = path.read_bytes()
    cuts = [good[:size] for size in range(0, len(good), 5)]
    flips = [bytes([*good[:i], good[i] ^ 0x41, *good[i + 1 :]]) for i in range(len(good))]
    refused = 0
    for data in cuts + flips:
        path.write_bytes(data)
        try:
            read_arrays(path, "arrays")
        except DataError as error:
            refused += str(error).startswith(f"{path}: ")
    assert refused > 0.7 * len(cuts + flips)  # others flip times and versions


def test_archives_are_not_unpacked_beyond_the_bound(tmp_path, monkeypatch):
    monkeypatch.setattr(npz_file, "MAX_UNPACKED", 1_000_000)
    zeros = np.zeros(100_000)
    np.savez_compressed(tmp_path / "one.npz", a=zeros)
    assert len(read_arrays(tmp_path / "one.npz", "arrays")["a"]) == 100_000
    np.savez_compressed(tmp_path / "two.npz", a=zeros, b=zeros)
    with pytest.raises(DataError, match="array b: more than 1000000 bytes when unpacked"):
        read_arrays(tmp_path / "two.npz", "arrays")
    np.savez(tmp_path / "stored.npz", a=zeros, b=zeros)  # no larger than its file
    assert len(read_arrays(tmp_path / "stored.npz", "arrays")["b"]) == 100_000


def test_sizes_in_headers_of_archives_are_not_believed(tmp_path):
    path = archive(tmp_path / "a.npz", x=npy(header_of("(1000,)"), bytes(8000)))
    content = path.read_bytes()
    real = len(npy(header_of("(1000,)"), bytes(8000))).to_bytes(4, "little")
    assert content.count(real) == 2
    path.write_bytes(content.replace(real, (100).to_bytes(4, "little")))
    with pytest.raises(DataError, match="Bad CRC-32|fewer bytes"):
        read_arrays(path, "arrays")


def test_gzip_is_not_unpacked_beyond_the_bound(monkeypatch):
    monkeypatch.setattr(gzip_file, "MAX_UNPACKED", 1_000_000)
    packer = zlib.compressobj(wbits=31)
    packed = packer.compress(b"time,a\n" + b"0" * 999_993) + packer.flush()
    assert len(unpacked_gzip(io.BytesIO(packed)).read()) == 1_000_000
    with pytest.raises(OSError, match="more than 1000000 bytes when unpacked"):
        unpacked_gzip(io.BytesIO(packed + packed)).read()  # another member of the same stream


@pytest.mark.parametrize("name", ["a.csv.gz", "a.mot.gz", "a.sto.gz", "a.trc.gz"])
def test_packed_tables_are_refused_before_their_lines_are_read(tmp_path, monkeypatch, name):
    monkeypatch.setattr(gzip_file, "MAX_UNPACKED", 1_000_000)
    packer = zlib.compressobj(wbits=31)
    content = b"time,a\nendheader\ntime\ta\n0\t0\n0\t0\n"
    (tmp_path / name).write_bytes(packer.compress(content + b"\n" * 2_000_000) + packer.flush())
    with pytest.raises(DataError, match=f"{name}: .*more than 1000000 bytes when unpacked"):
        read_result(tmp_path / name)


def test_columns_of_parquet_are_not_unpacked_beyond_the_bound(tmp_path, monkeypatch):
    """A value that repeats takes no room in the file."""
    monkeypatch.setattr(parquet, "MAX_UNPACKED", 1_000_000)
    fits, numbers, texts = (tmp_path / f"{name}.parquet" for name in ("fits", "numbers", "texts"))
    Result({MAIN: Table([Column("a", np.zeros(100_000))])}).to(fits)
    assert len(read_result(fits)[MAIN]["a"]) == 100_000
    Result({MAIN: Table([Column("a", np.zeros(200_000))])}).to(numbers)
    Result({MAIN: Table([Column("a", np.full(3_000, "x" * 1_000))])}).to(texts)
    for file in (numbers, texts):
        assert file.stat().st_size < 200_000
        with pytest.raises(DataError, match="more than 1000000 bytes when unpacked"):
            read_result(file)
