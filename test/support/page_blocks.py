"""Blocks of code in the pages, and what to do with each.

A block whose first line is a comment with a file name is that file. Blocks of `bash` and of
`python` run, in order, where the files are. All other blocks show something.
"""

import re
from typing import NamedTuple

from places import ROOT

INDEX = ROOT / "docs/index.md"
GROUPS = ("Tutorials", "How-to guides", "Explanation")
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"(?:# |<!-- )([\w.-]+\.\w+)(?: -->)?\n")


class Block(NamedTuple):
    """A block of a page.

    Attributes:
        kind: Its language, empty without one.
        text: Its lines.
        file: Name of the file that it is, empty for none.
    """

    kind: str
    text: str
    file: str


def task_pages():
    """The README and the pages of the groups whose commands run."""
    index = INDEX.read_text(encoding="utf-8")
    _, *pieces = re.split(r"^## (.+)$", index, flags=re.MULTILINE)
    texts = dict(zip(pieces[::2], pieces[1::2], strict=True))
    names = [name for group in GROUPS for name in re.findall(r"\]\((\w+\.md)\)", texts[group])]
    return [ROOT / "README.md", *(ROOT / "docs" / name for name in dict.fromkeys(names))]


def blocks(page):
    """The blocks of a page, in order."""
    for kind, text in _BLOCK.findall(page.read_text(encoding="utf-8")):
        named = _FILE.match(text)
        file = named[1] if named else ""
        yield Block(kind, text[named.end() :] if file.endswith(".csv") else text, file)


def commands(block):
    """The lines of a block as a shell reads them: without comments, continued lines joined."""
    joined = block.text.replace("\\\n", " ")
    lines = (re.sub(r"(^|\s)#.*", "", line).strip() for line in joined.splitlines())
    return [line for line in lines if line]
