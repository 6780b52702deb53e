"""The table of equations: every function that it names exists where the table says."""

import ast
import re

import pytest
from places import ROOT

PAGE = (ROOT / "docs/equations.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| (?!feature )([^|]+?) \|(.*)\| `([\w/]+\.py)` \| ([^|]+) \|$", re.MULTILINE)
LINES = [
    (feature, module, name)
    for feature, _, module, names in ROW.findall(PAGE)
    for name in re.findall(r"`([\w.]+)`", names)
]


def test_every_line_of_a_table_is_read():
    lines = re.findall(r"^\| (?!feature ).*", PAGE, re.MULTILINE)
    assert len(ROW.findall(PAGE)) == len(lines)
    assert len(lines) == len({line.split("|")[1] for line in lines})


@pytest.mark.parametrize(("feature", "module", "name"), LINES)
def test_the_function_of_an_equation_exists(feature, module, name):
    tree = ast.parse((ROOT / "mbd_ros" / module).read_text(encoding="utf-8"))
    for part in name.split("."):
        (tree,) = (
            node
            for node in tree.body
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == part
        )
    assert ast.get_docstring(tree) or "." in name  # methods may inherit theirs
