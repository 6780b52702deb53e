"""What of others is in the project, and under which licences."""

import csv
import re

import pytest
from places import RECORDINGS, ROOT

LICENCES = {
    "arm26": "Creative Commons Attribution 3.0",
    "gait10dof": "Creative Commons Attribution 3.0",
    "panda": "BSD 3-Clause License",
    "psyonic_hand": "MIT License",
    "ur10": "BSD 3-Clause License",
}
MOST_BYTES = 4_000_000
PAGE = (ROOT / "docs/licences.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| ([\w.-]+) \| (\d[\w.]*) \| ([^|]*\w[^|]*) \|", re.MULTILINE)
PIN = re.compile(r"^([\w.-]+)==([\w.]+)", re.MULTILINE)
PINS = {
    path.name: PIN.findall(path.read_text(encoding="utf-8"))
    for path in (ROOT / "requirements").glob("*.txt")
}


def test_recordings_are_small_and_all_described():
    folders = {path.name for path in RECORDINGS.iterdir() if path.is_dir()}
    assert folders == set(LICENCES)
    assert sum(p.stat().st_size for p in RECORDINGS.rglob("*") if p.is_file()) <= MOST_BYTES
    text = (RECORDINGS / "README.md").read_text(encoding="utf-8")
    assert all(f"({name}/README.md)" in text for name in folders)


@pytest.mark.parametrize("name", LICENCES)
def test_every_recording_has_source_licence_and_credits(name):
    text = (RECORDINGS / name / "README.md").read_text(encoding="utf-8")
    assert re.search(r"^- Source: https://github\.com/[\w-]+/[\w-]+, ", text, re.MULTILINE)
    assert re.search(r"^- Licence: \[[^\]]+\]\(LICENSE\)", text, re.MULTILINE)
    assert re.search(r"^- Credits: \w", text, re.MULTILINE)
    licence = (RECORDINGS / name / "LICENSE").read_text(encoding="utf-8")
    assert licence.startswith(LICENCES[name])
    assert len(licence) > 1000


@pytest.mark.parametrize("file", PINS)
def test_every_pinned_package_is_on_the_page(file):
    """`make licences` after a change of a pin; what is no longer pinned is not on the page."""
    (section,) = (text for text in PAGE.split("\n## ") if f"`requirements/{file}`:" in text)
    assert PINS[file]
    assert [(name, version) for name, version, _ in ROW.findall(section)] == PINS[file]


def test_licences_that_were_looked_up_are_those_of_pinned_packages():
    with (ROOT / "docs/site/licences.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    pinned = {name for pins in PINS.values() for name, _ in pins}
    assert [row for row in rows if row["package"] not in pinned] == []
    for row in rows:
        assert f"| {row['licence']} | {row['looked up in']} |" in PAGE
