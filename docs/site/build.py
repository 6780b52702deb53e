"""Build the site: `make docs`, or `python docs/site/build.py FOLDER [BUILDER]`.

The pages of `docs/` and those that are generated from the package go into one folder.
`docs/index.md` gives their order: a heading is a group, each link below it a page. A warning, a
page without a group or a dead link ends the build with an error.
"""

import re
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import command_reference
import node_reference
import python_reference
import robot_reference
import scene_reference
from sphinx.cmd.build import main as sphinx_build

SITE = Path(__file__).parent
DOCS = SITE.parent
ROOT = DOCS.parent
SOURCE = ROOT / "build/docs_source"
GENERATED = {
    "scene_reference": scene_reference,
    "node_reference": node_reference,
    "command_reference": command_reference,
    "python_reference": python_reference,
    "robot_reference": robot_reference,
}
GROUP_OF_GENERATED = "Reference"
OF_PROJECT = ("CONTRIBUTING", "CHANGELOG")
_HEADING = re.compile(r"^## (.+)$", re.MULTILINE)
_PAGE = re.compile(r"\]\((\w+)\.md\)")
_NAMED_BY_FILE = re.compile(r"\[(?:docs/)?\w+\.md\]\((?=\w+\.md)")
_GENERATED_PAGE = re.compile(r"`(\w+_reference)\.md`")
_OF_SOURCES = re.compile(r"\[([^\]]+)\]\(\.\./(?!CONTRIBUTING|CHANGELOG)[^)]+\)")


def main(arguments: list[str]) -> int:
    """Assemble the pages and build them.

    Args:
        arguments: Folder of the result, and the builder of Sphinx: html (default) or linkcheck.
    """
    out = Path(arguments[0])
    builder = (arguments[1:] or ["html"])[0]
    assemble(SOURCE)
    options = ["-b", builder, "-c", str(SITE), "-W", "--keep-going", "-q", "-j", "2"]
    doctrees = ROOT / "build/docs_doctrees"
    return int(sphinx_build([*options, "-d", str(doctrees), str(SOURCE), str(out)]))


def assemble(folder: Path) -> None:
    """Write all pages into a folder, and delete its former contents.

    Args:
        folder: Folder of the pages, flat, with the pictures of `docs/images` in `images/`.
    """
    texts = {page.stem: page.read_text(encoding="utf-8") for page in DOCS.glob("*.md")}
    for name in OF_PROJECT:
        texts[name] = (ROOT / f"{name}.md").read_text(encoding="utf-8")
    texts |= {name: module.page() for name, module in GENERATED.items()}
    texts = {name: at_one_level(text) for name, text in texts.items()}
    texts["index"] += navigation(texts["index"])
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS / "images", folder / "images")
    for name, text in texts.items():
        (folder / f"{name}.md").write_text(text, encoding="utf-8")


def at_one_level(text: str) -> str:
    """Return a page as the flat folder of all pages needs it.

    Links start from there. Links that show the name of a page show its title, links to source
    files become text, and the names of generated pages become links.
    """
    text = text.replace("](docs/", "](").replace("](../CO", "](CO").replace("](../CH", "](CH")
    text = _GENERATED_PAGE.sub(r"[](\1.md)", _NAMED_BY_FILE.sub("[](", text))
    return _OF_SOURCES.sub(r"\1", text)


def navigation(index: str) -> str:
    """Return tables of contents for the sidebar, one for each group of the index."""
    lines = []
    for title, pages in groups(index).items():
        entries = "\n".join(pages)
        lines.append(f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{entries}\n```\n")
    return "".join(lines)


def groups(index: str) -> Mapping[str, list[str]]:
    """Return pages by the heading under which the index lists them, with the generated ones."""
    _, *pieces = _HEADING.split(index)
    titles, texts = pieces[::2], pieces[1::2]
    pages = {title: _PAGE.findall(text) for title, text in zip(titles, texts, strict=True)}
    listed = pages[GROUP_OF_GENERATED]
    listed += [name for name in GENERATED if name not in listed]
    return pages


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
