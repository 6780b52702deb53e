"""Robot descriptions that cannot be trusted are refused, and the message says where and why."""

import itertools
import random

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.model.urdf import MAX_CHARACTERS, MAX_JOINTS, MAX_LINKS
from mbd_ros.errors import ModelError

LEG = (ROOT / "config/robots/prosthetic_leg.urdf").read_text(encoding="utf-8")
LINK = (
    '<link name="{0}"><inertial><origin xyz="0 0 -0.2"/><mass value="2"/>'
    '<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
HINGE = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>'
    '<origin xyz="0 0 1"/><axis xyz="0 1 0"/><limit effort="9" velocity="3"/></joint>'
)
ARM = (
    '<robot name="arm"><link name="world"/>'
    + HINGE.format("shoulder", "world", "upper")
    + LINK.format("upper")
    + HINGE.format("elbow", "upper", "fore")
    + LINK.format("fore")
    + "</robot>"
)


def refusal(text, **options):
    """Message with which a description is refused."""
    with pytest.raises(ModelError) as caught:
        read_robot(text, source="arm.urdf", **options)
    assert str(caught.value).startswith("arm.urdf: ")
    return str(caught.value)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_sound_text_is_accepted(base):
    assert [j.name for j in read_robot(ARM, base=base).joints] == ["shoulder", "elbow"]


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('value="2"', 'value="-1"', ("link 'upper'", "mass is -1 kg", "must not be negative")),
        ('value="2"', 'value="nan"', ("link 'upper'", "<mass value='nan'>", "finite")),
        ('value="2"', 'value="1e999"', ("link 'upper'", "'1e999'", "finite")),
        ('value="2"', 'value="1_000"', ("link 'upper'", "'1_000'", "finite")),
        ('value="2"', 'value="0x10"', ("link 'upper'", "'0x10'", "finite")),
        ('value="2"', 'value="1,5"', ("link 'upper'", "'1,5'", "finite")),
        ('value="2"', 'value="٢"', ("link 'upper'", "'٢'", "finite")),
        ('value="2"', 'value=""', ("link 'upper'", "<mass value=''>", "finite")),
        ('value="2"', 'value="1 2"', ("link 'upper'", "'1 2'", "a finite number")),
        ('<mass value="2"/>', "", ("link 'upper'", "<mass> lacks value")),
        ('ixx="0.02" ', "", ("link 'upper'", "<inertia> lacks ixx")),
        (' ixy="0" ixz="0"', "", ("link 'upper'", "<inertia> lacks ixy, ixz")),
        ('ixx="0.02"', 'ixx="inf"', ("link 'upper'", "<inertia ixx='inf'>")),
        ('ixx="0.02"', 'ixx="-0.02"', ("link 'upper'", "not positive definite", "-0.02 kg m^2")),
        ('ixx="0.02"', 'ixx="-0.001"', ("link 'upper'", "not positive definite", "rounding")),
        ('ixy="0"', 'ixy="0.1"', ("link 'upper'", "not positive definite")),
        ('ixx="0.02"', 'ixx="0.005"', ("'upper'", "triangle inequality", "0.005 + 0.03 < 0.04")),
        ('xyz="0 0 -0.2"', 'xyz="0 0"', ("link 'upper'", "<origin xyz='0 0'>", "3 finite")),
        ('xyz="0 0 1"', 'xyz="0 nan 1"', ("joint 'shoulder'", "<origin xyz='0 nan 1'>")),
        ('xyz="0 1 0"', 'xyz="0 0 0"', ("joint 'shoulder'", "axis is zero")),
        ('velocity="3"', 'velocity="fast"', ("joint 'shoulder'", "<limit velocity='fast'>")),
        ('velocity="3"', "", ("joint 'shoulder'", "needs <limit> with effort and velocity")),
        ('type="revolute"', 'type="planar"', ("'shoulder'", "type is 'planar'", "continuous")),
        ('parent link="world"', 'parent link="word"', ("'shoulder'", "parent link 'word'")),
        ('<child link="fore"/>', "", ("joint 'elbow'", "child link 'None'")),
        ('child link="fore"', 'child link="upper"', ("'upper' is the child of two joints",)),
        ('parent link="world"', 'parent link="fore"', ("cycle through 'upper'",)),
        ("</robot>", '<link name="lost"/></robot>', ("one root link, found world, lost",)),
        ('parent link="upper"', 'parent link="fore"', ("cycle through 'fore'",)),
        ('joint name="elbow"', 'joint name="shoulder"', ("<joint> name used twice: shoulder",)),
        ('link name="fore"', 'link name="upper"', ("<link> name used twice: upper",)),
        ('joint name="elbow"', "joint", ("a <joint> has no name",)),
        ("</robot>", "", ("not well-formed XML",)),
        ('<robot name="arm">', '<robot name="\ud800">', ("not well-formed XML",)),
        ('<robot name="arm">', '<robot name="\0">', ("not well-formed XML",)),
        ('<robot name="arm">', "<robot>", ("not contain a valid URDF",)),
        (
            "</robot>",
            "<x>" * 5000 + "</x>" * 5000 + "</robot>",
            ("elements are nested deeper than 256",),
        ),
    ],
)
def test_one_wrong_thing_is_named(old, new, parts):
    assert old in ARM
    message = refusal(ARM.replace(old, new, 1))
    assert all(part in message for part in parts), message


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "robot description is empty"),
        (" \n", "robot description is empty"),
        ("rubbish", "not well-formed XML"),
        ("<robot name='a'/>", "has no <link>"),
        ("<html/>", "root element is <html>, expected <robot>"),
        ("<!DOCTYPE robot>" + ARM, "DOCTYPE and ENTITY declarations are refused"),
        ("<!doctype robot>" + ARM, "DOCTYPE and ENTITY declarations are refused"),
        ('<!DOCTYPE r [<!ENTITY a "b">]>' + ARM, "DOCTYPE and ENTITY declarations are refused"),
        ('<! ENTITY a SYSTEM "/etc/passwd">' + ARM, "DOCTYPE and ENTITY"),
        (ARM + " " * MAX_CHARACTERS, f"accepted are {MAX_CHARACTERS}"),
        ("<robot name='a'>" + "<link name='b'/>" * 500_000, "not well-formed"),
        ("<robot name='a'>" + "<link name='b'/>" * 500_000 + "</robot>", f"are {MAX_LINKS}"),
    ],
)
def test_hostile_text_is_refused_at_once(text, part):
    assert part in refusal(text)


def test_link_that_moves_without_any_mass_is_named():
    tip = HINGE.format("wrist", "fore", "hand") + '<link name="hand"/></robot>'
    said = "link 'hand' moves, but neither it nor the links that it carries have mass"
    assert read_robot(ARM.replace("</robot>", tip)).inertia_warnings == (said,)
    carried = tip.replace("</robot>", "") + HINGE.format("slide", "hand", "nail")
    carried += LINK.format("nail") + "</robot>"
    assert len(read_robot(ARM.replace("</robot>", carried)).joints) == 4


@pytest.mark.parametrize(
    ("mass", "moments", "doubt"),
    [
        (0, (0, 0, 0), "mass is 0 kg"),
        (0, (0, 0.35, 0), "inertia without mass"),
        (0.3, (0, 0, 0), "a point mass, all moments of inertia are 0"),
        (0.3, (0.02, 0.02, 0), "smallest principal moment 0 kg m^2"),
        (0.3, (1e-4, 1e-4, -1e-8), "smallest principal moment -1e-08 kg m^2"),
        (3.0, (1e-7, 1e-7, -1e-8), "smallest principal moment -1e-08 kg m^2"),
        (4.8, (0.066, 0.086, 0.0125), "misses the triangle inequality"),
        (2.0, (0.01, 0.02, 0.0301), "misses the triangle inequality"),
        (2.0, (0.01, 0.02, 0.03), ""),
    ],
)
def test_published_inertias_that_no_body_has_are_said_and_used(mass, moments, doubt):
    text = LINK.format("upper").replace('value="2"', f'value="{mass}"')
    for old, axis, moment in zip(("0.02", "0.03", "0.04"), "xyz", moments, strict=True):
        text = text.replace(f'i{axis}{axis}="{old}"', f'i{axis}{axis}="{moment!r}"')
    robot = read_robot(ARM.replace(LINK.format("upper"), text))
    assert [d.startswith("link 'upper': ") and doubt in d for d in robot.inertia_warnings] == [
        True
    ] * bool(doubt)
    inertia = robot.model.inertias[1]
    assert inertia.mass == mass
    assert inertia.inertia.diagonal() == pytest.approx(moments, rel=1e-14, abs=1e-20)
    assert np.isfinite(pin.rnea(robot.model, robot.model.createData(), *np.ones((3, 2)))).all()


def test_longest_accepted_chain_builds():
    """Pinocchio's reader is recursive: what is accepted must not end the process."""
    links = [f"l{i}" for i in range(MAX_LINKS)]
    pairs = list(enumerate(itertools.pairwise(links)))
    hinges = [HINGE.format(f"j{b}", a, b) for i, (a, b) in pairs]
    fixed = [h if i < MAX_JOINTS else _fixed(h) for i, h in enumerate(hinges)]
    bodies = "".join(LINK.format(link) for link in links[1:])
    text = f'<robot name="chain"><link name="l0"/>{bodies}{"".join(fixed)}</robot>'
    assert read_robot(text).model.nv == MAX_JOINTS
    with pytest.raises(ModelError, match=f"has 999 moving joints, accepted are {MAX_JOINTS}"):
        read_robot(text.replace("".join(fixed), "".join(hinges)))


def _fixed(hinge):
    return hinge.replace('"revolute"', '"fixed"').replace("'revolute'", "'fixed'")


def test_every_mass_of_the_text_is_in_the_model():
    """The reader below drops an <inertial> it cannot read with no more than a line on stderr."""
    model = read_robot(LEG).model
    masses = [float(part.split('"')[1]) for part in LEG.split("<mass value=")[1:]]
    assert pin.computeTotalMass(model) == pytest.approx(sum(masses), rel=1e-12)


def mutated(text, dice):
    """The text with one to three small damages."""
    for _ in range(dice.randint(1, 3)):
        i = dice.randrange(len(text))
        j = min(len(text), i + dice.choice((1, 1, 2, 5, 40)))
        new = dice.choice(("", "", "<", '"', "nan", "-", "0", "</joint>", text[i:j] * 2, "\0"))
        text = text[:i] + new + text[j:]
    return text


def test_random_damage_never_raises_anything_else():
    """300 mutations: a ModelError, or a robot in which no mass was lost."""
    dice, refused = random.Random(3), 0
    for _ in range(300):
        text = mutated(ARM, dice)
        try:
            robot = read_robot(text, source="arm.urdf")
        except ModelError as error:
            refused += str(error).startswith("arm.urdf: ")
        else:
            assert pin.computeTotalMass(robot.model) > 0
            heavy = sum(i.mass > 0 for i in robot.model.inertias)
            assert heavy == len(robot.joints) or robot.inertia_warnings, text
    assert 100 < refused < 300
