"""Bags whose compressed parts unpack to more than a reader should hold."""

import tracemalloc

import lz4.frame
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, ReaderError, StoragePlugin, Writer
from rosbags.rosbag2.reader import zstd
from rosbags.rosbag2.storage_mcap import decompress

from mbd_ros.errors import DataError
from mbd_ros.files.bags import bag_unpacking
from mbd_ros.files.bags.bag_reader import raw_blocks, raw_messages, topic_types
from mbd_ros.files.bags.bag_types import TYPES

TEXT, TOPIC = "std_msgs/msg/String", "/said"
SIZE = 100_000  # bytes of a message, which compress to some ten
COUNT = 8
PLUGINS = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]
MODES = [CompressionMode.STORAGE, CompressionMode.MESSAGE, CompressionMode.FILE]
KINDS = [(PLUGINS[0], mode) for mode in MODES] + [(PLUGINS[1], mode) for mode in MODES[1:]]


@pytest.fixture(params=KINDS, ids=lambda kind: f"{kind[0].value}-{kind[1].value}")
def bag(request, tmp_path):
    """A folder with `COUNT` messages of one byte repeated, packed in every way there is."""
    plugin, mode = request.param
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(TOPIC, TEXT, typestore=TYPES)
        for i in range(COUNT):
            writer.write(connection, 1 + i, bytes(SIZE))
    return tmp_path / "bag"


def read(bag):
    return [len(message.cdr) for message in raw_messages(bag, {TOPIC: TEXT})]


def test_packed_bags_are_read(bag):
    assert topic_types(bag) == {TOPIC: TEXT}
    assert read(bag) == [SIZE] * COUNT
    assert sum(len(block.log_times) for block in raw_blocks(bag, TOPIC, TEXT)) == COUNT


def test_all_parts_together_are_bounded(bag, monkeypatch):
    monkeypatch.setattr(bag_unpacking, "_RATIO", 1)
    monkeypatch.setattr(bag_unpacking, "MAX_UNPACKED", 3 * SIZE)
    with pytest.raises(DataError, match=f"bag: more than {3 * SIZE} bytes when unpacked"):
        read(bag)
    with pytest.raises(DataError, match="bytes when unpacked"):
        list(raw_blocks(bag, TOPIC, TEXT))


def test_each_part_is_bounded(bag, monkeypatch):
    monkeypatch.setattr(bag_unpacking, "MAX_PART", SIZE // 2)
    if "compression_mode: file" in (bag / "metadata.yaml").read_text(encoding="utf-8").lower():
        assert read(bag) == [SIZE] * COUNT  # as large as the file that was unpacked
        return
    with pytest.raises(DataError, match=f"has more than {SIZE // 2} bytes when unpacked"):
        read(bag)


@pytest.mark.parametrize(
    ("name", "pack"), [("zstd", zstd.compress), ("lz4", lz4.frame.compress)], ids=["zstd", "lz4"]
)
def test_a_chunk_is_not_unpacked_beyond_its_size(name, pack):
    content = bytes(20_000_000)
    packed = pack(content)
    assert decompress(packed, name, len(content), 0) == content
    halves = pack(content[:7]) + pack(content[7:])  # frames that follow one another
    assert decompress(halves, name, len(content), 0) == content
    tracemalloc.start()
    with pytest.raises(ReaderError, match="expected 1000 bytes, got 1001"):
        decompress(packed, name, 1000, 0)
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()
    with pytest.raises(ReaderError, match="expected 20000000 bytes, got"):
        decompress(packed[: len(packed) // 2], name, len(content), 0)
