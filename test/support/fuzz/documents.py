"""Trees of values and of XML elements, and what becomes of them."""

import json
import random
from collections.abc import Iterator
from math import nan
from typing import Any
from xml.etree import ElementTree

from fuzz.values import NUMBERS, WORDS, anything, near, number, spoil_text

# Keys whose numbers are work: a task that asks for 1e9 samples is sound, and lasts.
WORK = frozenset(
    {
        *("samples", "chains", "warmup", "steps", "iterations", "intervals", "degree", "starts"),
        *("evaluations", "cycles", "points", "doublings", "duration", "dt", "longest", "lag"),
        *("interval", "accuracy", "tolerance", "count"),
    }
)
KEYS = ("type", "name", "position", "*", "__class__", "weight", "file")


def tree(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """A scene or task with other values and keys; as text where it is no JSON."""
    try:
        values = json.loads(data)
    except ValueError:
        return spoil_text(rng, data.decode(errors="replace")).encode("utf-8", "surrogatepass")
    for _ in range(1 if mild else rng.randint(1, 3)):
        change_value(rng, values, mild)
    text = json.dumps(values, ensure_ascii=rng.random() < 0.5)
    if not mild and rng.random() < 0.1:
        text = rng.choice((spoil_text(rng, text), nested(text), text + "\n" + text))
    return text.encode("utf-8", "surrogatepass")


def nested(text: str) -> str:
    """The same, deeper than a reader that calls itself can follow."""
    return "[" * 100_000 + text


def change_value(rng: random.Random, values: Any, mild: bool) -> None:
    """Another value, a key less, more or renamed, somewhere in a tree."""
    every = list(places(values))
    if mild:
        every = [(inner, key) for inner, key in every if isinstance(inner[key], float)]
    if not every:
        return
    inner, key = rng.choice(every)
    draw = rng.random()
    if mild:
        inner[key] = near(rng, inner[key])
    elif _works(inner, key):  # it stays: its default may be more work
        inner[key] = _little(rng)
    elif draw < 0.6:
        inner[key] = anything(rng)
    elif draw < 0.75:
        del inner[key]
    elif isinstance(inner, dict):
        new = rng.choice((*KEYS, *inner, str(anything(rng))))
        inner[new] = _little(rng) if draw < 0.9 or new in WORK else inner.pop(key)
    else:
        inner.extend([inner[key]] * rng.choice((1, 2, 30)))


def _little(rng: random.Random) -> Any:
    """A value that asks for little work; a new list each time, since mutations change lists."""
    return rng.choice((0, -1, 1, 2, 1.5, None, "", "x", [], {}, [1, 2], [2, 1], True, nan))


def _works(inner: Any, key: Any) -> bool:
    return key in WORK or (isinstance(inner, list) and isinstance(inner[key], int))


def places(values: Any) -> Iterator[tuple[Any, Any]]:
    """Mappings and lists of a tree, each with every key."""
    if not isinstance(values, dict | list):
        return
    pairs = values.items() if isinstance(values, dict) else enumerate(values)
    for key, inner in list(pairs):
        yield values, key
        yield from places(inner)


def xml(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """A document with other numbers, names and elements."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError):
        return spoil_text(rng, data.decode(errors="replace")).encode("utf-8", "surrogatepass")
    for _ in range(1 if mild else rng.randint(1, 3)):
        (_other_number if mild else rng.choice(_OF_ELEMENTS))(rng, root)
    text = ElementTree.tostring(root, encoding="unicode")
    if not mild and rng.random() < 0.15:
        text = rng.choice((spoil_text, _strange))(rng, text)
    return text.encode("utf-8", "surrogatepass")


def _other_number(rng: random.Random, root: ElementTree.Element) -> None:
    """A number a little larger or smaller, in a text or an attribute."""
    _change_word(rng, root, lambda word: repr(near(rng, float(word))), "0123456789")


def _value(rng: random.Random, root: ElementTree.Element) -> None:
    words = (number(rng), rng.choice(WORDS), str(rng.choice(NUMBERS)), "nan", "1 2")
    _change_word(rng, root, lambda word: rng.choice(words), "")


def _change_word(rng: random.Random, root: ElementTree.Element, change: Any, last: str) -> None:
    """Change a word of a text or attribute that ends with one of some characters."""
    spots = [
        (element, key, words, i)
        for element in root.iter()
        for key, text in ((None, element.text or ""), *element.items())
        for words in [text.split()]
        for i, word in enumerate(words)
        if not last or ("." in word and word[-1] in last and _is_number(word))
    ]
    if not spots:
        return
    element, key, words, i = rng.choice(spots)
    words[i] = change(words[i])
    if key is None:
        element.text = _printable(" ".join(words))
    else:
        element.set(key, _printable(" ".join(words)))


def _is_number(word: str) -> bool:
    return word.lstrip("-").replace(".", "", 1).isdigit()


def _printable(text: str) -> str:
    """Without what no XML can hold; `spoil_text` puts it there."""
    return "".join(c for c in text if c >= " " and not "\ud800" <= c <= "\udfff")


def _pair(rng: random.Random, root: ElementTree.Element) -> Any:
    return rng.choice(
        [(parent, child) for parent in root.iter() for child in parent] or [(root, None)]
    )


def _delete(rng: random.Random, root: ElementTree.Element) -> None:
    parent, child = _pair(rng, root)
    if child is not None:
        parent.remove(child)


def _repeat(rng: random.Random, root: ElementTree.Element) -> None:
    parent, child = _pair(rng, root)
    if child is not None:
        parent.append(child)


def _move(rng: random.Random, root: ElementTree.Element) -> None:
    parent, child = _pair(rng, root)
    if child is None:
        return
    inside = set(child.iter())
    parent.remove(child)
    others = [element for element in root.iter() if element not in inside]
    rng.choice(others).append(child)


def _swap(rng: random.Random, root: ElementTree.Element) -> None:
    """The text or attribute of one element in another."""
    one, other = rng.choice(list(root.iter())), rng.choice(list(root.iter()))
    one.text = other.text
    if other.attrib:
        key = rng.choice(list(other.attrib))
        one.set(key, other.attrib[key])


def _rename(rng: random.Random, root: ElementTree.Element) -> None:
    every = list(root.iter())
    rng.choice(every).tag = rng.choice((rng.choice(every).tag, "x", "Body", "joint", "objects"))


def _lose(rng: random.Random, root: ElementTree.Element) -> None:
    """An attribute less, or no text."""
    element = rng.choice(list(root.iter()))
    if element.attrib:
        del element.attrib[rng.choice(list(element.attrib))]
    else:
        element.text = None


_OF_ELEMENTS = (
    _value,
    _value,
    _value,
    _other_number,
    _delete,
    _repeat,
    _move,
    _swap,
    _rename,
    _lose,
)


def _strange(rng: random.Random, text: str) -> str:
    return rng.choice(
        (
            "",
            "<a/>",
            '<!DOCTYPE x [<!ENTITY a "b">]>' + text,
            '<!DOCTYPE x SYSTEM "/dev/zero">' + text,
            '<?xml version="1.0" encoding="utf-16"?>' + text,
            "<!--" * 2000 + text,
            text + text,
            "<a>" * 20_000 + text,
            text.replace("<", "&lt;", 1),
            "\ufeff" + text,
        )
    )
