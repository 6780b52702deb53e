"""Odd files of OpenSim are read; broken ones are refused by file, element and what is wrong."""

import gzip
import time

import pytest
from osim_models import (
    COUPLERS,
    body,
    chain,
    coordinate,
    coupler,
    frame,
    joint,
    linear,
    loaded,
    model,
)

from mbd_ros.api import load_scene
from mbd_ros.errors import SceneError
from mbd_ros.scene.models.model_entry import import_model

GOOD = chain(ConstraintSet=COUPLERS)
BAD = {
    "truncated": (GOOD[: len(GOOD) // 2], ("not well-formed XML",)),
    "no XML": ("model: 3\n", ("not well-formed XML",)),
    "empty": ("", ("not well-formed XML",)),
    "another document": (
        "<robot name='a'/>",
        ("expected <OpenSimDocument> with <Model>", "<robot>"),
    ),
    "no model": (
        "<OpenSimDocument Version='40000'><ForceSet/></OpenSimDocument>",
        ("with ForceSet",),
    ),
    "version": (GOOD.replace('"40000"', '"99999"'), ("Version='99999'", "10000 .. 49999")),
    "doctype": ("<!DOCTYPE a>" + GOOD, ("DOCTYPE",)),
    "unknown body": (
        GOOD.replace("/bodyset/c<", "/bodyset/nose<"),
        ("PinJoint 'third'", "no body or frame '/bodyset/nose'", "ground, a, b, c"),
    ),
    "no frame": (
        GOOD.replace("<socket_parent_frame>/bodyset/b</socket_parent_frame>", ""),
        ("PinJoint 'third'", "names no parent_frame"),
    ),
    "unknown coordinate": (
        GOOD.replace(">q3<", ">nose<"),
        ("CoordinateCouplerConstraint 'q3_by_q2'", "no coordinate 'nose'"),
    ),
    "coupled in a circle": (
        chain(ConstraintSet=COUPLERS + coupler("q1", "q3", linear(1.0))),
        ("couplings form a cycle",),
    ),
    "no number": (
        GOOD.replace("<mass>1.0<", "<mass>heavy<", 1),
        ("Body 'a'", "<mass>", "'heavy'"),
    ),
    "not finite": (GOOD.replace("<mass>1.0<", "<mass>nan<", 1), ("Body 'a'", "<mass>", "nan")),
    "two numbers": (
        GOOD.replace("<mass>1.0<", "<mass>1 2<", 1),
        ("Body 'a'", "<mass> has 2 numbers"),
    ),
    "no vector": (
        GOOD.replace("<mass_center>0 0.5 0<", "<mass_center>0 0.5<", 1),
        ("Body 'a'", "<mass_center> has 2 numbers, expected 3"),
    ),
    "negative mass": (GOOD.replace("<mass>1.0<", "<mass>-1<", 1), ("'a'", "mass is -1 kg")),
    "frames in a circle": (
        model(
            [body("a")],
            [
                joint(
                    "PinJoint",
                    "j",
                    "f",
                    "/bodyset/a",
                    coordinate("q"),
                    frames=frame("f", "g") + frame("g", "f"),
                )
            ],
        ),
        ("frames form a cycle",),
    ),
    "no geometry": (
        chain(
            ForceSet='<HuntCrossleyForce name="f"><HuntCrossleyForce::ContactParametersSet>'
            "<objects><HuntCrossleyForce::ContactParameters><geometry>heel</geometry>"
            "</HuntCrossleyForce::ContactParameters></objects>"
            "</HuntCrossleyForce::ContactParametersSet></HuntCrossleyForce>"
        ),
        ("HuntCrossleyForce 'f'", "no contact geometry 'heel'"),
    ),
    "no wrap object": (
        chain(
            ForceSet='<PathActuator name="f"><GeometryPath><PathPointSet><objects>'
            '<PathPoint name="p"><socket_parent_frame>/ground</socket_parent_frame></PathPoint>'
            '<PathPoint name="r"><socket_parent_frame>/bodyset/c</socket_parent_frame></PathPoint>'
            '</objects></PathPointSet><PathWrapSet><objects><PathWrap name="w"><wrap_object>bone'
            "</wrap_object></PathWrap></objects></PathWrapSet></GeometryPath></PathActuator>"
        ),
        ("PathWrap 'w'", "no wrap object 'bone'"),
    ),
    "bodies": (
        model([body(f"b{i}") for i in range(1001)], []),
        ("Model", "1001 bodies, accepted are 1000"),
    ),
    "pairs of shapes": (
        chain(
            ContactGeometrySet="<ContactSphere name='s'><body>a</body><radius>1</radius>"
            "</ContactSphere><ContactHalfSpace name='h'><body>ground</body></ContactHalfSpace>",
            ForceSet='<HuntCrossleyForce name="f"><HuntCrossleyForce::ContactParametersSet>'
            f"<objects><P><geometry>{'s h ' * 1000}</geometry></P></objects>"
            "</HuntCrossleyForce::ContactParametersSet></HuntCrossleyForce>",
        ),
        ("HuntCrossleyForce 'f'", "more than 10000 pairs of shapes are not accepted"),
    ),
    "flag": (
        GOOD.replace('name="q1">', 'name="q1"><locked>perhaps</locked>'),
        ("Coordinate 'q1'", "<locked> is 'perhaps'", "true or false"),
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_with_a_file_is_named_with_its_element(case, tmp_path):
    text, words = BAD[case]
    assert text != GOOD
    with pytest.raises(SceneError) as caught:
        loaded(text, tmp_path)
    said = str(caught.value)
    assert said.startswith(str(tmp_path / "small.osim"))
    assert [word for word in words if word not in said] == []


def test_a_file_that_is_not_there_or_no_gzip_is_named(tmp_path):
    with pytest.raises(SceneError, match="none.osim: model cannot be read: No such file"):
        load_scene(tmp_path / "none.osim")
    (tmp_path / "small.osim.gz").write_bytes(b"no gzip")
    with pytest.raises(SceneError, match="small.osim.gz: model cannot be read"):
        load_scene(tmp_path / "small.osim.gz")


def test_tags_with_colons_comments_and_packed_files_are_read(tmp_path):
    force = (
        '<HuntCrossleyForce name="f"><HuntCrossleyForce::ContactParametersSet '
        'name="contact_parameters"><objects><HuntCrossleyForce::ContactParameters><geometry>floor '
        "ball</geometry><stiffness>1e6</stiffness><dissipation>0.5</dissipation>"
        "</HuntCrossleyForce::ContactParameters></objects></HuntCrossleyForce::ContactParametersSet>"
        "</HuntCrossleyForce>"
    )
    shapes = (
        '<ContactHalfSpace name="floor"><socket_frame>/ground</socket_frame>'
        "<orientation>0 0 -1.5707963267948966</orientation></ContactHalfSpace><!-- a -- b & -->"
        '<ContactSphere name="ball"><socket_frame>/bodyset/a</socket_frame><location>0 0 0'
        "</location><radius>0.04</radius></ContactSphere>"
    )
    text = model([body("a")], [], ForceSet=force, ContactGeometrySet=shapes)
    (tmp_path / "ball.osim.gz").write_bytes(gzip.compress(text.encode()))
    scene = load_scene(tmp_path / "ball.osim.gz")
    (contact,) = scene.parts["contacts"]
    k = scene.system().k
    x = scene.with_(initial={"position": {"free_a_coord_4": 0.03}}).initial
    k.refresh(x.q, x.v)
    up = contact.force(k, x, scene.inputs.safe)[scene.robot.joint("free_a_coord_4").v]
    assert up == pytest.approx(
        4.0 / 3.0 * 0.04**0.5 * (0.5 * 1e6 ** (2 / 3)) ** 1.5 * 0.01**1.5, rel=1e-9
    )


def test_many_elements_of_one_name_take_linear_time(tmp_path):
    """20 s before: each looked at all offset frames, and at all names that were taken."""
    frames = "".join(
        f"<PhysicalOffsetFrame name='f{i}'><socket_parent>/bodyset/a</socket_parent>"
        "</PhysicalOffsetFrame>"
        for i in range(2000)
    )
    marker = "<Marker name='m'><socket_parent_frame>/bodyset/a</socket_parent_frame></Marker>"
    file = tmp_path / "many.osim"
    file.write_text(chain(components=frames, MarkerSet=marker * 3000))
    begin = time.process_time()
    assert len(import_model(file, "osim", {}).sections["sensors"]) == 3000
    assert time.process_time() - begin < 4.0
