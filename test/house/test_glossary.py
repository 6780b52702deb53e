"""The glossary: one term, one meaning, and a module in which it lives."""

import re

import pytest
from places import ROOT

ROW = re.compile(r"^\| (?!term )([^|]+?) \|(.*)\| ([^|]+?) \| `([\w/]+\.py)` \|$", re.MULTILINE)
PAGE = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
TERMS = [(term, definition, module) for term, _, definition, module in ROW.findall(PAGE)]


def test_every_line_of_a_table_is_read():
    lines = re.findall(r"^\| (?!term ).*", PAGE, re.MULTILINE)
    assert len(TERMS) == len(lines)
    assert len(TERMS) >= 60


def test_terms_are_unique():
    names = [term.lower() for term, _, _ in TERMS]
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize(("term", "definition", "module"), TERMS, ids=[t for t, _, _ in TERMS])
def test_every_term_is_defined_and_lives_in_a_module(term, definition, module):
    assert definition
    assert (ROOT / "mbd_ros" / module).is_file()
