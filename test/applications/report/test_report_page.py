"""The page of a report in a browser without network, and what keeps together on it."""

import re
import sys

import pytest
from deadline import DEADLINE

from mbd_ros.applications.report.compose import plain, scene_pages
from mbd_ros.applications.report.items import Section, Table
from mbd_ros.applications.report.page import page, section_lines
from mbd_ros.applications.report.subjects import Subject
from mbd_ros.jobs.workers.opening import Remaining, watched
from mbd_ros.jobs.workers.task import Result, Task
from mbd_ros.scene.schema.locate import find_scene

FACTS = {
    "date": "2026-01-02T03:04:05+00:00",
    "quick": False,
    "scenes": [],
    "wrong": [],
    "machine": {"cpu": "a <cpu>", "cores": 2},
    "git": {},
    "changed": [],
    "work": 5400.0,
    "duration": 61.0,
    "versions": {"numpy": "2"},
    "timed": 0,
    "cpus": [],
    "pages": {"<arm>": "scenes/arm.html"},
}
PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010806000000"
    "1f15c4890000000d49444154789c6360606060000000050001a5f645400000000049454e44ae426082"
)
WORDS = ["converged 1e-9", "stopped: no step", "bounded", "WRONG: off by 3"]
SECTION = Section(
    "A & B",
    ["Plain <b>text</b>."],
    [
        Table("arm: front", ["error", "state"], [[f"1e-{i}", w] for i, w in enumerate(WORDS)]),
        Table("leg: front", [f"column {i}" for i in range(30)], [["long cell " * 5] * 30]),
    ],
    {"front_leg": None, "front_arm": None, "other": None},
    (),
    {"arm, 1e-6": "integrator: {type: rk4}", "any": "dt: 1.0e-3"},
)
PAGE = page(FACTS, {"ab": SECTION}, dict.fromkeys(SECTION.figures, PIXEL))


def test_texts_are_texts():
    assert "Plain &lt;b&gt;text&lt;/b&gt;." in PAGE
    assert "a &lt;cpu&gt;" in PAGE
    assert "<h2>A &amp; B</h2>" in PAGE


def test_what_is_about_one_subject_stands_together():
    found = re.findall(r'<h3>(.*?)</h3>|alt="(.*?)"', PAGE)
    assert ["".join(pair) for pair in found] == [
        *("arm: front", "front arm", "arm, 1e-6", "leg: front", "front leg", "other", "any")
    ]


def test_states_are_marked_and_numbers_aligned():
    for state in ("converged", "stopped", "bounded", "wrong"):
        assert f'<td class="{state}">' in PAGE
    assert '<td class="number">1e-3</td>' in PAGE
    assert '<th scope="col" class="number">error</th><th scope="col">state</th>' in PAGE


def html(*tables, **parts):
    return "".join(
        section_lines("k", Section("S", (), tables, **parts), dict.fromkeys("ab", PIXEL))
    )


def test_a_subject_that_begins_like_another_keeps_what_is_its_own():
    tables = [Table(f"{name}: front", ["n"], [["1"]]) for name in ("arm", "arm_coupled")]
    shown = html(*tables, snippets={"arm_coupled, 1e-6": "dt: 1", "arm, 1e-6": "dt: 2"})
    places = [shown.index(text) for text in ("arm: front", "dt: 2", "arm_coupled: front", "dt: 1")]
    assert places == sorted(places)


def test_a_first_column_stays_in_sight_unless_it_is_text():
    assert '<th scope="row">arm_<wbr>coupled</th>' in html(Table("t", ["n"], [["arm_coupled"]]))
    reasons = html(Table("t", ["reason"], [["short"], ["a reason that is a long sentence " * 2]]))
    assert "<td>short</td>" in reasons and 'scope="row"' not in reasons


def test_pictures_pan_only_where_they_are_wide():
    """A picture of 1200 x 2400 is wide and tall, one of 930 x 930 scales."""
    for size, look in (((1200, 2400), ' class="wide tall"'), ((1200, 800), ' class="wide"')):
        assert f"<figure{look}>" in picture(*size)
    assert "<figure><img" in picture(930, 930)


def picture(wide, high):
    png = PIXEL[:16] + wide.to_bytes(4, "big") + high.to_bytes(4, "big") + PIXEL[24:]
    section = Section("S", (), figures={"map": None})
    return "".join(section_lines("k", section, {"map": png}))


def test_numbers_that_json_has_not_become_texts():
    assert plain({"a": [float("nan"), (1, float("-inf"))]}) == {"a": ["nan", [1, "-inf"]]}


def test_the_time_left_learns_from_what_was_done():
    """Half of what was expected was needed, and what is alone is not shared among workers."""
    tasks = [Task("a", "", {}, 100.0, alone=True), Task("b", "", {}, 100.0)]
    remaining = Remaining([*tasks, *tasks], 2)
    assert remaining.seconds == 300.0
    remaining.count(tasks[0], Result(seconds=50.0))
    assert remaining.seconds == pytest.approx(200.0 * 55 / 105)


def test_progress_is_shown_on_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    tasks = [Task("a/b", "", {}, 60.0)] * 2
    assert len(list(watched(((t, Result(seconds=60.0)) for t in tasks), tasks, 1))) == 2
    said = capsys.readouterr().err
    assert "50 %, 1 of 2, about 60 s left, last a/b" in said
    assert said.endswith("\r\x1b[K")


@pytest.mark.parametrize("width", [1280, 360])
def test_a_browser_without_network_has_nothing_to_say(browser, tmp_path, width):
    (tmp_path / "index.html").write_text(PAGE, encoding="utf-8")
    context = browser.new_context(viewport={"width": width, "height": 800}, offline=True)
    context.set_default_timeout(1e3 * DEADLINE)
    view, said, asked = context.new_page(), [], []
    view.on("console", lambda message: said.append(message.text))
    view.on("pageerror", lambda error: said.append(str(error)))
    view.on("request", lambda request: asked.append(request.url))
    view.goto(f"file://{tmp_path}/index.html")
    assert view.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert view.evaluate("[...document.images].every(i => i.complete && i.naturalWidth)")
    context.close()
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


def test_a_report_links_to_pages_of_the_scenes_that_run(tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    broken = tmp_path / "broken.yaml"
    broken.write_text("robot: {urdf: missing.urdf}\n", encoding="utf-8")
    arm, made = str(find_scene("controlled_arm")), {}
    subjects = [Subject("my_arm", arm, (0.1,)), Subject("broken", str(broken), (0.1,))]
    (said,) = scene_pages(subjects, tmp_path, made)
    assert said.startswith("no page of broken: ") and "missing.urdf" in said
    assert made == {"my_arm": "scenes/my_arm.html"}
    text = (tmp_path / made["my_arm"]).read_text(encoding="utf-8")
    assert "<title>my_arm</title>" in text and "default-src 'none'" in text
    linked = page({**FACTS, "pages": made}, {"ab": SECTION}, dict.fromkeys(SECTION.figures, PIXEL))
    assert '<a href="scenes/my_arm.html">my_arm</a>' in linked and "<script" not in linked
    assert '<a href="scenes/arm.html">&lt;arm&gt;</a>' in PAGE
