"""What of others is in the project, and under which licences."""

import re

import pytest
from places import RECORDINGS

LICENCES = {
    "arm26": "Creative Commons Attribution 3.0",
    "gait10dof": "Creative Commons Attribution 3.0",
    "panda": "BSD 3-Clause License",
    "psyonic_hand": "MIT License",
    "ur10": "BSD 3-Clause License",
}
MOST_BYTES = 4_000_000


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
