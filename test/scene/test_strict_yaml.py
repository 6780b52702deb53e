"""YAML that means what it says, or an error with file, line and key."""

import os
import random

import pytest
import yaml

from mbd_ros.errors import SceneError
from mbd_ros.scene.schema.strict_yaml import MAX_BYTES, MAX_DEPTH, read_mapping, read_text


@pytest.fixture
def file(tmp_path):
    def write(content):
        path = tmp_path / "scene.yaml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1E+3", 1000.0),
        ("-1.5e-3", -0.0015),
        (".5", 0.5),
        ("5.", 5.0),
        ("-0.0", -0.0),
        ("7", 7),
        ("-7", -7),
        ("010", 10),
        ("123456789012345678901", 1.2345678901234568e20),
        ("1e-999", 0.0),
        ("true", True),
        ("false", False),
        ("null", None),
        ("~", None),
        ("", None),
        *((word, word) for word in ("yes", "on", "y", "True", "nan", ".nan", ".inf", "-.inf")),
        *((word, word) for word in ("1_000", "0x10", "0o17", "0b1", "1:30", "2001-01-01")),
        *((word, word) for word in ("١", "1e", "e5", ".", "+", "--1", "1.2.3", "Infinity")),
        ('"1.5"', "1.5"),
        ("'true'", "true"),
        ("[1, 2.5, x]", [1, 2.5, "x"]),
        ("{a: 1, b: {c: no}}", {"a": 1, "b": {"c": "no"}}),
    ],
)
def test_only_plain_numbers_are_numbers(file, text, value):
    read = read_mapping(file(f"key: {text}"))["key"]
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "the file is empty"),
        ("# only a comment\n", "the file is empty"),
        ("- 1\n- 2", "expected a mapping such as"),
        ("word", "expected a mapping such as"),
        ("a: 1\nb: 2\na: 3", "line 3: key 'a' is given twice"),
        ("a: {b: 1, c: 2, b: 1}", "line 1: key 'a.b' is given twice"),
        ('a: 1\n"a": 2', "line 2: key 'a' is given twice"),
        ("a: [{b: 1, b: 2}]", "key 'a[0].b' is given twice"),
        ("a:\n  b: 1e999", "line 2: a.b: 1e999 is not a finite number"),
        ("a: [0, -1e400]", "a[1]: -1e400 is not a finite number"),
        ("a: " + "9" * 400, "is not a finite number"),
        ("a: !!python/object:os.system {}", "tag tag:yaml.org,2002:python/object:os.system is"),
        ("a: !!python/object/apply:os.system ['id']", "is refused"),
        ("a: !!str 1", "line 1: tag tag:yaml.org,2002:str is refused"),
        ("a: !x 1", "line 1: tag !x is refused"),
        ("a: ! 1", "line 1: tag ! is refused"),
        ("%TAG ! tag:x,2000:\n---\na: !b 1", "is refused"),
        ("a: &x 1", "line 1: anchors and aliases are refused"),
        ("a: 1\nb: *x", "line 2: anchors and aliases are refused"),
        ("a: &a [x,x]\nb: &b [*a,*a]\nc: [*b,*b]", "anchors and aliases are refused"),
        ("<<: {a: 1}\n? [b]\n: 1", "a key must be a word"),
        ("{[a]: 1}", "a key must be a word"),
        ("a: " + "[" * 100 + "]" * 100, f"nested deeper than {MAX_DEPTH}"),
        ("a: " + "[" * 100_000, f"nested deeper than {MAX_DEPTH}"),
        ("a: 1\n---\nb: 2", "line 2: expected a single document in the stream, but found another"),
        ("a: [1", "while parsing a flow sequence, "),
        ("a: b: c", "line 1: "),
        ("a: 'x", "line 1: "),
        ("\ta: 1", "line 1: "),
        ("%YAML 9.0\n---\na: 1", "line 1: "),
        (b"a: 1\n\x00", "unacceptable character #x0000"),
        (b"\x01\x02\x03", "unacceptable character"),
        (b"\x80\x81\xff", "is not UTF-8 text"),
        (bytes(range(256)) * 20, "is not UTF-8 text"),
        ("a: 1 #" + "x" * MAX_BYTES, f"bytes, accepted are {MAX_BYTES}"),
    ],
)
def test_everything_else_is_refused_with_file_and_place(file, content, message):
    path = file(content)
    with pytest.raises(SceneError) as caught:
        read_mapping(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.yaml", "robot cannot be read: No such file"),
        (".", "robot cannot be read: it is a directory, not a regular file"),
        ("pipe", "robot cannot be read: it is a FIFO, not a regular file"),
        ("a\0b", "robot cannot be read: "),
        ("a\ud800b", "robot cannot be read: "),
        ("x" * 300, "robot cannot be read: File name too long"),
    ],
)
def test_file_that_cannot_be_read_is_named(tmp_path, name, message):
    """A pipe would be waited for without end, /dev/zero would fill the memory."""
    if name == "pipe":
        os.mkfifo(tmp_path / name)
    with pytest.raises(SceneError) as caught:
        read_text(tmp_path / name, 100, "robot")
    assert message in str(caught.value)


def test_file_of_exactly_the_limit_is_read(tmp_path):
    path = tmp_path / "a"
    path.write_text("x" * 100)
    assert read_text(path, 100, "robot") == "x" * 100
    with pytest.raises(SceneError, match="robot has 100 bytes, accepted are 99"):
        read_text(path, 99, "robot")


def test_plain_scenes_read_as_pyyaml_reads_them(file):
    text = "a: {b: [1, 2.5, -3.0e+2, word], c: null}\nd:\n- {e: true}\n- 'quoted: text'\n"
    assert read_mapping(file(text)) == yaml.safe_load(text)


def test_random_bytes_never_raise_anything_else(file):
    dice, read = random.Random(7), 0
    pieces = ["a: 1\n", "  b: ", "[", "]", "{", "}", ",", "&x ", "*x", "!!int ", "- ", "\n", "'"]
    pieces += ['"', "|", ">", "?", ": ", "#", "%", "@", "`", "1e9", "\t", "---\n", "...\n", "é"]
    for _ in range(600):
        path = file("".join(dice.choices(pieces, k=dice.randint(1, 12))))
        try:
            read += isinstance(read_mapping(path), dict)
        except SceneError as error:
            assert str(error).startswith(f"{path}: ")
    assert read > 10
