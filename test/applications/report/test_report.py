"""`mbd-ros report` as a user meets it, on a fake part: results, page, bad input, headlines."""

import json
import re
from html.parser import HTMLParser

import pytest
from report_runs import numbers, pendulum, ran, report, use_fake

import mbd_ros.applications.report.store as hashes
from mbd_ros.applications.report import items


@pytest.fixture(autouse=True)
def fake(monkeypatch, tmp_path):
    use_fake(monkeypatch, tmp_path)


def refusing(text):
    raise AssertionError(f"not JSON as others read it: {text}")


def test_everything_is_in_the_folder(tmp_path, capsys):
    out = tmp_path / "out"
    assert report("-o", out) == 0
    said = capsys.readouterr()
    assert "12 items, 0 of them done before" in said.out
    assert said.err == ""  # no progress where nobody watches
    text = (out / "report.json").read_text(encoding="utf-8")
    loaded = json.loads(text, parse_constant=refusing)
    assert {"date", "duration", "git", "machine", "versions", "wrong"} <= loaded.keys()
    assert loaded["machine"]["cpu"] and loaded["versions"]["pin"]
    assert [item["outcome"]["third"] for item in loaded["items"]] == [i / 3 for i in range(12)]
    assert loaded["items"][0]["outcome"]["nan"] == "nan"
    assert {item["outcome"]["threads"] for item in loaded["items"]} == {"1"}
    assert (out / "thirds.png").read_bytes()[:4] == b"\x89PNG"
    assert sorted(ran(tmp_path)) == list(range(12))


def test_items_that_time_run_first_and_one_at_a_time(tmp_path):
    assert report("-o", tmp_path / "out", "--workers", 4) == 0
    assert ran(tmp_path)[:2] == [5, 6]
    assert "2 items time a run" in (tmp_path / "out/index.html").read_text(encoding="utf-8")


def test_a_second_run_does_nothing_and_says_the_same(tmp_path):
    out = tmp_path / "out"
    assert report("-o", out) == 0
    first = numbers(out)
    assert report("-o", out) == 0
    assert len(ran(tmp_path)) == 12
    assert numbers(out) == first


@pytest.mark.soak
def test_another_spec_or_program_reuses_nothing(tmp_path, monkeypatch):
    out, scene = tmp_path / "out", pendulum(tmp_path / "s.yaml")
    text, robot = scene.read_text(encoding="utf-8"), tmp_path / "r.urdf"
    shape = robot.read_text(encoding="utf-8")
    for count, change in enumerate(
        [
            lambda: None,
            lambda: scene.write_text(f"{text}# 2\n", encoding="utf-8"),
            lambda: robot.write_text(f"{shape}<!-- two -->\n", encoding="utf-8"),
            lambda: monkeypatch.setattr(hashes, "versions", lambda: {"numpy": "0"}),
        ],
        start=1,
    ):
        change()
        assert report(scene, "--quick", "-o", out) == 0
        assert len(ran(tmp_path)) == 4 * count


class Links(HTMLParser):
    """What a page refers to, and its tags."""

    def __init__(self):
        super().__init__()
        self.targets, self.tags = [], set()

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.targets += [v for k, v in attributes if k in ("href", "src", "srcset", "data")]


def test_the_page_needs_nothing_from_outside(tmp_path):
    assert report("--quick", "-o", tmp_path / "out") == 0
    page = (tmp_path / "out/index.html").read_text(encoding="utf-8")
    links = Links()
    links.feed(page)
    assert [t for t in links.targets if not t.startswith(("#", "data:"))] == []
    assert not links.tags & {"script", "iframe", "object", "embed"}
    assert not re.search(r"url\(|@import|https?://", page)
    assert {t[1:] for t in links.targets if t.startswith("#")} <= set(
        re.findall(r' id="(\w+)"', page)
    )


def test_a_package_that_is_missing_is_said_on_the_page(tmp_path, monkeypatch):
    (tmp_path / "lacking_part.py").write_text("import no_such_engine\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(items, "PARTS", {"peers": "lacking_part", "fake": "report_fake_part"})
    assert report("--quick", "-o", tmp_path / "out") == 0
    page = (tmp_path / "out/index.html").read_text(encoding="utf-8")
    assert "no_such_engine is not installed: pip install &#x27;mbd_ros[peers]&#x27;" in page


@pytest.mark.parametrize(
    "words",
    [
        ["absent.yaml"],
        ["--readme", "R.md", "--quick"],
        ["--readme", "R.md", "-o", "nowhere"],
        ["--scheduler", "local:0"],
        ["--scheduler", "tcp:/nobody"],
    ],
)
def test_bad_input(tmp_path, words, capsys):
    assert report("-o", tmp_path / "out", *words) == 2
    assert capsys.readouterr().err.startswith("mbd-ros report: ")


def test_headlines_go_between_the_marks_of_a_page(tmp_path):
    out, readme = tmp_path / "out", tmp_path / "README.md"
    marks = "<!-- report: begin -->", "<!-- report: end -->"
    readme.write_text(f"# before\n{marks[0]}\nold\n{marks[1]}\nafter\n", encoding="utf-8")
    assert report("-o", out) == 0
    for _ in range(2):
        assert report("--readme", readme, "-o", out) == 0
        text = readme.read_text(encoding="utf-8")
        assert text.startswith(f"# before\n{marks[0]}\nMade by `mbd-ros report` on 2")
        assert text.endswith(f"{marks[1]}\nafter\n")
        assert "| number-02 | 0.66666666666666663 | converged |" in text
        assert "old" not in text
        assert "![thirds](images/report.png)" in text
        assert (tmp_path / "images/report.png").read_bytes() == (out / "thirds.png").read_bytes()
