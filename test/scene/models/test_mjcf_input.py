"""Broken models of MuJoCo are refused by file, element and what is wrong; odd ones are read."""

import itertools
import random
import time

import numpy as np
import pytest

from mbd_ros.errors import SceneError
from mbd_ros.scene.models.model_entry import import_model
from mbd_ros.scene.reader import load_scene

GOOD = """<mujoco><default><default class="thin"><geom size="0.01"/></default></default>
<worldbody><body name="a"><joint name="a" pos="0 0 0"/><geom size="0.1" class="thin"/>
<site name="s" pos="0.1 0 0"/><body name="b"><joint name="b" type="slide"/><geom size="0.1"/>
</body></body></worldbody>
<equality><joint joint1="b" joint2="a" polycoef="0 1"/></equality>
<tendon><fixed name="f"><joint joint="a" coef="1"/></fixed></tendon>
<actuator><motor name="m" joint="a"/></actuator></mujoco>"""
BAD = {
    "truncated": (GOOD[:200], ("not well-formed XML",)),
    "another format": ("<robot name='a'/>", ("expected <mujoco>, found <robot>",)),
    "unknown section": (GOOD.replace("actuator>", "actuators>"), ("unknown element <actuators>",)),
    "unknown element": (GOOD.replace('<geom size="0.1"/>', "<gem/>"), ("unknown element", "gem")),
    "unknown attribute": (
        GOOD.replace('pos="0 0 0"', 'rnage="0 1"'),
        ("joint 'a'", "unknown attribute 'rnage'", "range"),
    ),
    "count": (GOOD.replace('pos="0 0 0"', 'pos="0 0"'), ("joint 'a'", "pos has 2 numbers")),
    "no number": (GOOD.replace('pos="0 0 0"', 'pos="0 x 0"'), ("pos holds 'x'",)),
    "not finite": (GOOD.replace('pos="0 0 0"', 'pos="0 nan 0"'), ("pos holds nan",)),
    "word": (GOOD.replace('"slide"', '"glide"'), ("type is 'glide'", "hinge, slide, ball, free")),
    "axis": (GOOD.replace('pos="0 0 0"', 'axis="0 0 0"'), ("axis has no length",)),
    "range": (GOOD.replace('pos="0 0 0"', 'range="2 1"'), ("range is '2 1'",)),
    "class": (GOOD.replace('"thin"/>', '"fat"/>'), ("no default class 'fat'", "thin")),
    "joint of an equality": (GOOD.replace('joint2="a"', 'joint2="z"'), ("no joint 'z'", "a, b")),
    "joint of a tendon": (GOOD.replace('joint="a" c', 'joint="z" c'), ("no joint 'z'",)),
    "joint of an actuator": (GOOD.replace('"m" joint="a"', '"m" joint="z"'), ("motor 'm'",)),
    "tendon": (GOOD.replace('"m" joint="a"', '"m" tendon="z"'), ("no tendon 'z'",)),
    "two bodies": (GOOD.replace('<body name="b">', '<body name="a">'), ("two bodies 'a'",)),
    "two joints": (GOOD.replace('name="b" type', 'name="a" type'), ("two joints",)),
    "size": (GOOD.replace('size="0.1"', 'size="-1"'), ("expected 1 positive",)),
    "inertia of a mesh": (
        GOOD.replace('<geom size="0.1"/>', '<geom type="mesh" mesh="bone"/>'),
        ("there is no mesh 'bone'",),
    ),
    "file of a mesh": (
        GOOD.replace('<geom size="0.1"/>', '<geom type="mesh" mesh="bone"/>').replace(
            "<worldbody>", '<asset><mesh file="bone.stl"/></asset><worldbody>'
        ),
        ("bone.stl is not there", "give <inertial>", "mass='0'"),
    ),
    "flat mesh": (
        GOOD.replace('<geom size="0.1"/>', '<geom type="mesh" mesh="m"/>').replace(
            "<worldbody>",
            '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 1 1 0"/></asset><worldbody>',
        ),
        ("its mesh is flat",),
    ),
    "vertex": (
        GOOD.replace('<geom size="0.1"/>', '<geom type="mesh" mesh="m"/>').replace(
            "<worldbody>",
            '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1e20"/></asset><worldbody>',
        ),
        ("mesh 'm' has a vertex at no place, accepted are numbers up to 1e+06",),
    ),
    "negative moment": (
        GOOD.replace('<geom size="0.1"/>', '<inertial mass="1" diaginertia="-1 1 1"/>'),
        ("inertial", "its moments of inertia are negative"),
    ),
    "shell": (
        GOOD.replace('<geom size="0.1"/>', '<geom size="0.1" shellinertia="true"/>'),
        ("no <inertial>", "shell of a sphere"),
    ),
    "free joint inside": (GOOD.replace('"slide"', '"free"'), ("a free joint stands alone",)),
    "replicate": (GOOD.replace("<site", "<replicate/><site"), ("<replicate>", "write its bodies")),
    "joints": (
        GOOD.replace("<site", "<joint/>" * 1000 + "<site"),
        ("1002 joints, accepted are 1000",),
    ),
    "nested classes": (
        GOOD.replace("<default>", "<default>" + "<default class='c'>" * 300, 1),
        ("nested deeper than 256",),
    ),
    "missing include": (
        GOOD.replace("<default>", '<include file="z.xml"/><default>', 1),
        ("z.xml",),
    ),
    "circle": (GOOD.replace("<default>", '<include file="bad.xml"/><default>', 1), ("before",)),
    "entity": ('<!DOCTYPE a [<!ENTITY b "c">]>' + GOOD, ("DOCTYPE",)),
    "global": (
        GOOD.replace("<default>", '<compiler coordinate="global"/><default>', 1),
        ("local",),
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_model_is_refused(tmp_path, name):
    text, wanted = BAD[name]
    file = tmp_path / "bad.xml"
    file.write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(file)
    for word in ("bad.xml", *wanted):
        assert word in str(caught.value)


def test_files_are_included_and_looks_need_no_mesh(tmp_path):
    """A visual mesh that is not there is no matter; joint and body may have one name."""
    look = '<geom type="mesh" mesh="bone" mass="0" contype="0" conaffinity="0"/>'
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "b.xml").write_text(f"<mujocoinclude>{look}</mujocoinclude>")
    text = GOOD.replace("<site", '<include file="parts/b.xml"/><site')
    file = tmp_path / "good.mjcf"
    file.write_text(text)
    scene = load_scene(file)
    assert [joint.name for joint in scene.parts["robot"].joints] == ["a", "b"]
    assert scene.entries["couplings"]["b"] == {"parent": "a", "polynomial": [0.0, 1.0]}


@pytest.mark.parametrize("kind", ["free", "ball"])
def test_what_joints_do_not_have_is_listed(tmp_path, kind):
    """A free base has no hinge, a ball has three; each is named once."""
    file = tmp_path / "good.xml"
    joint = f'<joint name="j" type="{kind}" damping="0.1" armature="0.2"/>'
    file.write_text(
        f'<mujoco><worldbody><body name="a">{joint}<geom size="0.1"/></body></worldbody></mujoco>'
    )
    left_out = load_scene(file).parts["robot"].ignored
    assert "joint j (without its damping, armature)" in left_out


def test_entries_of_a_scene_win(tmp_path):
    (tmp_path / "good.xml").write_text(GOOD)
    file = tmp_path / "scene.yaml"
    file.write_text("robot: {mjcf: good.xml, locked: {a: 0.3}, gravity: [0, 0, -1]}\n")
    scene = load_scene(file)
    assert scene.parts["robot"].joints == ()
    assert any("'a' is locked" in line for line in scene.parts["robot"].ignored)


def test_includes_inside_includes_end_somewhere(tmp_path):
    """Each file alone is nested less than a document may be."""
    deep = "<frame>" * 150
    for i in range(3):
        inner = f'<include file="{i + 1}.xml"/>' if i < 2 else ""
        text = f"<mujoco>{deep}{inner}{deep.replace('<', '</')}</mujoco>"
        (tmp_path / f"{i}.xml").write_text(text)
    with pytest.raises(SceneError, match="1.xml: elements are nested deeper than 256 with incl"):
        load_scene(tmp_path / "0.xml")


MANY = {
    "actuators of no name": GOOD.replace(
        "</actuator>", "<motor joint='a'/>" * 6000 + "</actuator>"
    ),
    "tendons that are left out": GOOD.replace(
        "</tendon>",
        "".join(f"<spatial name='t{i}'><pulley/></spatial>" for i in range(3000)) + "</tendon>",
    ).replace("</actuator>", "<motor tendon='t9'/>" * 3000 + "</actuator>"),
    "kinds in many classes": GOOD.replace(
        "<default>",
        "<default>"
        + "".join(f"<k{i} a='1'/>" for i in range(3000))
        + "".join(f"<default class='c{i}'/>" for i in range(3000)),
        1,
    ),
    "attributes of a class": GOOD.replace(
        "<default>", "<default><site " + "".join(f"a{i}='' " for i in range(6000)) + "/>", 1
    ).replace("<site name", "<site/>" * 3000 + "<site name"),
}


@pytest.mark.parametrize("kind", MANY)
def test_many_elements_take_linear_time(tmp_path, kind):
    """Each of these models of 100 kB took 8 s and more, or gigabytes."""
    (tmp_path / "many.xml").write_text(MANY[kind])
    begin = time.process_time()
    import_model(tmp_path / "many.xml", "mjcf", {})
    assert time.process_time() - begin < 4.0


CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
FACES = [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5)]
FACES += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]


def mesh_files():
    """A cube as files of all formats that are read."""
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    corners = [CUBE[list(face)].astype("<f4") for face in FACES]
    facets = [np.zeros(3, "<f4").tobytes() + one.tobytes() + b"\0\0" for one in corners]
    binary = b" " * 80 + len(FACES).to_bytes(4, "little") + b"".join(facets)
    text = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in one)
        + "endloop\nendfacet\n"
        for one in corners
    )
    return {
        "a.obj": "\n".join(lines).encode(),
        "a.stl": binary,
        "b.stl": f"solid a\n{text}endsolid a\n".encode(),
    }


@pytest.mark.parametrize("name", mesh_files())
@pytest.mark.parametrize("rule", ["convex", "legacy", "exact"])
def test_broken_meshes_are_refused_by_name(tmp_path, name, rule):
    """Cut, without numbers, at infinity, with corners that are not there, or of no text."""
    whole, rng, read = mesh_files()[name], random.Random(f"{name} {rule}"), 0
    mesh = f'<asset><mesh name="m" file="{name}" inertia="{rule}"/></asset>'
    body = '<body><joint/><geom type="mesh" mesh="m"/></body>'
    model = tmp_path / "m.xml"
    model.write_text(f"<mujoco>{mesh}<worldbody>{body}</worldbody></mujoco>")
    (tmp_path / name).write_bytes(whole)
    import_model(model, "mjcf", {})
    for _ in range(40):
        data = bytearray(whole)
        for _ in range(rng.choice((1, 2, 5))):
            begin = rng.randrange(len(data))
            new = rng.choice(
                (b"nan", b"-1", b"1e300", b"99", b"\xff", b"\0\0\xc0\x7f", b"\0\0\x80\x7f")
            )
            data[begin : begin + rng.choice((0, len(new)))] = new
        cut = rng.choice((len(data), len(data), rng.randrange(len(data))))
        (tmp_path / name).write_bytes(data[:cut])
        try:
            import_model(model, "mjcf", {})
            read += 1
        except SceneError as error:
            assert "geom" in str(error)
    assert read
