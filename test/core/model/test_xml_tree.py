"""XML is read leniently, in linear time, and takes nothing from elsewhere."""

import statistics
import time

import pytest

from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.model.xml_tree import MAX_DEPTH, MarkupError, decoded, xml_tree
from mbd_ros.errors import MbdError
from mbd_ros.features.markers.osim_setup import read_setup
from mbd_ros.files.laboratory.external_loads import read_external_loads
from mbd_ros.scene.models.model_entry import import_model
from mbd_ros.scene.schema.strict_yaml import mapping_of

GROWING = {
    "comments that never end": lambda n: "<!--" * (n // 4),
    "blanks": lambda n: " " * n,
    "nested elements": lambda n: "<a>" * (n // 3),
}
ALSO = {
    "blanks in a name": lambda n: "<" + " " * n,
    "blanks in a declaration": lambda n: "<!" + " " * n,
    "nested elements with ends": lambda n: "<a>" * (n // 7) + "</a>" * (n // 7),
    "elements that never end": lambda n: "<a>" + "<b/>" * (n // 4),
    "declarations": lambda n: "<?xml " * (n // 6),
    "a name with colons": lambda n: "<a" + "::a" * (n // 3),
}
READERS = {
    "model.osim": lambda path: import_model(path, "osim", {}),
    "model.xml": lambda path: import_model(path, "mjcf", {}),
    "robot.urdf": lambda path: read_robot(path.read_text()),
    "setup.xml": read_setup,
    "loads.xml": read_external_loads,
    "scene.yaml": lambda path: mapping_of(path.read_text(), path.name),
}


def assert_linear(read, grow, large):
    """A text twice as long takes at most 2.6 times as long: median of five interleaved runs."""
    ratios = []
    for _ in range(5):
        seconds = []
        for size in (large // 2, large):
            text = grow(size)
            begin = time.process_time()
            with pytest.raises((MbdError, MarkupError)):
                read(text)
            seconds.append(time.process_time() - begin)
        if seconds[1] < 0.005:
            return  # of which the clock measures little
        ratios.append(seconds[1] / seconds[0])
    assert statistics.median(ratios) <= 2.6, seconds


@pytest.mark.parametrize("kind", GROWING)
@pytest.mark.parametrize("name", READERS)
def test_hostile_text_is_read_in_linear_time(tmp_path, name, kind):
    path = tmp_path / name

    def read(text):
        path.write_text(text)
        READERS[name](path)

    assert_linear(read, GROWING[kind], 400_000)


@pytest.mark.parametrize("kind", ALSO)
def test_any_text_becomes_a_tree_in_linear_time(kind):
    assert_linear(xml_tree, ALSO[kind], 50_000)


def test_numbers_of_many_digits_take_linear_time():
    """A word of 200 kB that is almost a number is a word; it took minutes."""
    digits = "1" * 200_000
    assert mapping_of(f"a: {digits}x", "scene")["a"] == digits + "x"
    with pytest.raises(MbdError, match="expected 3 finite numbers"):
        read_robot(
            f"<robot name='a'><link name='b'/><joint name='c'><origin xyz='{digits}x'/></joint>"
            "</robot>"
        )


def test_comments_may_hold_anything_and_lines_keep_their_numbers():
    text = "\n <!-- a -- b\n & <x> <!DOCTYPE c> -->\n<?xml version='1.0' encoding='big5'?>\n<a>\n"
    root = xml_tree(text + "<b>é<!-- - ---></b><![CDATA[<!-- kept -->]]>\n</a>")
    assert root[0].text == "é"
    assert root[0].tail == "<!-- kept -->\n"
    with pytest.raises(MarkupError, match=r"not well-formed XML: mismatched tag: line 6, column"):
        xml_tree(text + "</b>")
    with pytest.raises(MarkupError, match="unclosed token: line 6, column 3"):
        xml_tree(text + "<b/><!-- no end".replace("<b/>", "   "))


def test_names_keep_their_prefixes_and_two_colons_become_two_bars():
    root = xml_tree("<a::b::c x:y='1'><p:q/></a::b::c>")
    assert (root.tag, root.attrib, root[0].tag) == ("a__b__c", {"x:y": "1"}, "p:q")


@pytest.mark.parametrize(
    "text",
    [
        "<!DOCTYPE a><a/>",
        "<!-- b --><!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>",
        "<?p <!-- ?><!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>",
        "<?p <![CDATA[ ?><!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a><?p ]]> ?>",
        "<!doctype a><a/>",
        "<! ENTITY b SYSTEM '/etc/passwd'><a/>",
    ],
)
def test_declarations_are_refused(text):
    with pytest.raises(MarkupError, match="DOCTYPE and ENTITY declarations are refused"):
        xml_tree(text)


@pytest.mark.parametrize("name", [name for name in READERS if not name.endswith("yaml")])
def test_elements_inside_elements_end_somewhere(tmp_path, name):
    path = tmp_path / name
    path.write_text("<a>" * 100_000 + "</a>" * 100_000)
    with pytest.raises(MbdError, match=f"elements are nested deeper than {MAX_DEPTH}"):
        READERS[name](path)
    assert len(list(xml_tree("<a>" * MAX_DEPTH + "</a>" * MAX_DEPTH).iter())) == MAX_DEPTH


def test_old_files_are_in_latin_1():
    assert xml_tree(decoded("<a>Öl</a>".encode("latin-1"))).text == "Öl"
    assert xml_tree(decoded("\ufeff<a>Öl</a>".encode())).text == "Öl"
