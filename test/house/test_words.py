"""Names are nouns and verbs of the field; docstrings begin with a sentence."""

import ast
import re
from functools import cache

import pytest
from places import ROOT

# Pronouns and participles say what a value is in a sentence, not what it is.
VAGUE = """acting asked found given giving held kept one own said told whole""".split()  # noqa: SIM905
# Keys and options of files and commands keep their names: those of Python follow them.
KEYS = {"held": ("identification", "phase_entries"), "given": ("learn",)}
LONG = 3  # lines after which a reader has lost the place where a name was made
FILES = sorted(p for part in ("mbd_ros", "msg_adapters") for p in (ROOT / part).rglob("*.py"))
VAGUE_START = re.compile(r"Of\b|As `|What\b")
FUNCTIONS = ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda


@cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def is_vague(name):
    return name.strip("_") in VAGUE


def vague_names(tree):
    """Yield the line and the name of each vague function, argument, attribute and variable."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) if is_vague(name):
                yield node.lineno, name
            case ast.arg(arg=name) | ast.Attribute(attr=name) if is_vague(name):
                yield node.lineno, name
        if isinstance(node, FUNCTIONS):
            yield from long_lived(node)


def long_lived(scope):
    """Yield the first line and the name of each vague variable of a scope that lives long."""
    lines = {}
    for node in ast.walk(scope):
        if isinstance(node, ast.Name) and is_vague(node.id):
            lines.setdefault(node.id, []).append(node.lineno)
    for name, places in lines.items():
        if max(places) - min(places) > LONG:
            yield min(places), name


def vague_docstrings(tree):
    """Yield the line of each docstring that begins with a fragment."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            text = ast.get_docstring(node) or ""
            if VAGUE_START.match(text):
                yield getattr(node, "lineno", 1), text.partition("\n")[0]


@pytest.mark.parametrize("kind", [vague_names, vague_docstrings])
def test_the_package_speaks_the_language_of_the_field(kind):
    vague = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in FILES
        for line, text in kind(parsed(path))
        if not any(part in KEYS.get(text, ()) for part in (*path.parts, path.stem))
    ]
    assert vague == []


def test_no_file_is_named_by_a_pronoun_or_participle():
    assert [path for path in FILES if set(path.stem.split("_")) & set(VAGUE)] == []


def test_vague_names_are_noticed():
    text = (
        "def f(one):\n    found = one\n\n\n\n    self.kept = found\n    given = 1\n    g(given)\n"
    )
    names = [name for _, name in vague_names(ast.parse(text))]
    assert sorted(names) == ["found", "kept", "one"] or sorted(names) == [
        "found",
        "kept",
        "one",
        "one",
    ]
    tree = ast.parse('def f():\n    """What it gives."""\n\n\ndef g():\n    """Offer it."""\n')
    assert [line for line, _ in vague_docstrings(tree)] == [1]
