"""Robot descriptions: sound ones of random shape, and what becomes of them."""

import random
from functools import cache
from typing import NamedTuple

from fuzz.values import NUMBERS, WORDS, number, spoil_text

KINDS = ("revolute", "continuous", "prismatic", "fixed")


class Described(NamedTuple):
    text: str
    joints: tuple[str, ...]  # that move
    links: tuple[str, ...]


def robot(rng: random.Random, largest: int = 6) -> Described:
    """A robot that the reader takes: a chain with branches, every link with mass."""
    count = rng.randint(1, largest)
    links = tuple(f"l{i}" for i in range(count + 1))
    text, moving = ["<robot name='r'><link name='l0'/>"], []
    for i in range(1, count + 1):
        kind = rng.choice(KINDS[: 4 if moving else 3])
        parent = links[rng.choice((i - 1, rng.randrange(i)))]
        if kind != "fixed":
            moving.append(f"j{i}")
        text.append(_link(rng, links[i]) + _joint(rng, f"j{i}", kind, parent, links[i], moving))
    return Described("".join(text) + "</robot>", tuple(moving), links)


def _link(rng: random.Random, name: str) -> str:
    xyz = " ".join(str(round(rng.uniform(-0.3, 0.3), 3)) for _ in range(3))
    return (
        f"<link name='{name}'><inertial><origin xyz='{xyz}' rpy='0 0 0'/><mass value='1.5'/>"
        "<inertia ixx='.02' iyy='.02' izz='.01' ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )


def _joint(
    rng: random.Random, name: str, kind: str, parent: str, child: str, moving: list[str]
) -> str:
    axis = rng.choice(("1 0 0", "0 1 0", "0 0 1", "0.6 0 0.8"))
    mimic = ""
    if kind != "fixed" and len(moving) > 1 and rng.random() < 0.15:
        mimic = f"<mimic joint='{moving[0]}' multiplier='0.5' offset='0.1'/>"
    return (
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"<origin xyz='0 0.1 0.3' rpy='0 0 0'/><axis xyz='{axis}'/>"
        f"<limit lower='-2' upper='2' effort='30' velocity='10'/>{mimic}</joint>"
    )


@cache
def two_joints() -> str:
    """A description of the joints j1 and j2, none of which follows the other."""
    seed = 0
    while True:
        described = robot(random.Random(seed), 2)
        if described.joints == ("j1", "j2") and "<mimic" not in described.text:
            return described.text
        seed += 1


def mutated(rng: random.Random) -> Described:
    """A robot with a few faults."""
    sound = robot(rng)
    text = sound.text
    for _ in range(rng.randint(1, 3)):
        text = rng.choice((_value, _value, _value, _swap, _cut_element, _repeat, spoil_text))(
            rng, text
        )
    return Described(text, sound.joints, sound.links)


def _value(rng: random.Random, text: str) -> str:
    """Another value of one attribute."""
    ends = [i for i, c in enumerate(text) if c == "'"]
    if len(ends) < 2:
        return text
    k = 2 * rng.randrange(len(ends) // 2)
    first, last = ends[k] + 1, ends[k + 1]
    words = text[first:last].split() or [""]
    words[rng.randrange(len(words))] = (
        number(rng) if rng.random() < 0.8 else rng.choice((*WORDS, *map(str, NUMBERS)))
    )
    return text[:first] + " ".join(words).replace("'", "").replace("<", "") + text[last:]


def _elements(text: str) -> list[tuple[int, int]]:
    starts = [i for i, c in enumerate(text) if c == "<"]
    return [(i, text.find(">", i) + 1) for i in starts if text.find(">", i) > 0]


def _swap(rng: random.Random, text: str) -> str:
    """Another name in the place of one."""
    names = [word for word in ("l0", "l1", "l2", "j1", "j2", "j3") if f"'{word}'" in text]
    if not names:
        return text
    at = rng.choice(names)
    return text.replace(f"'{at}'", f"'{rng.choice((*names, 'world', 'x'))}'", 1)


def _cut_element(rng: random.Random, text: str) -> str:
    elements = [e for e in _elements(text) if text[e[1] - 2] == "/"]
    if not elements:
        return text
    first, last = rng.choice(elements)
    return text[:first] + text[last:]


def _repeat(rng: random.Random, text: str) -> str:
    elements = [e for e in _elements(text) if text[e[1] - 2] == "/"]
    if not elements:
        return text
    first, last = rng.choice(elements)
    return text[:last] + text[first:last] + text[last:]
