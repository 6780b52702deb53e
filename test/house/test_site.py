"""The site that `make docs` builds: whole, without a warning, dead link or need of a network."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from urllib.parse import unquote

import pytest
from places import ROOT

from mbd_ros.features.tools.completion import all_words
from mbd_ros.nodes.table import NODES
from mbd_ros.scene.schema.registry import PARTS
from mbd_ros.scene.schema.sections import TASKS

SOURCES = ROOT / "build/docs_source"
LOADING = {"script": "src", "img": "src", "iframe": "src", "link": "href", "source": "src"}


class Read(HTMLParser):
    """Names, links and what a page loads."""

    def __init__(self, page):
        super().__init__()
        self.ids, self.links, self.loads, self.tags = set(), [], [], set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.add(tag)
        self.ids.add(given.get("id"))
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in LOADING and given.get(LOADING[tag]):
            self.loads.append(given[LOADING[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("furo", reason="not installed: pip install -r requirements/docs.txt")
    pytest.importorskip("myst_parser")
    out = tmp_path_factory.mktemp("site")
    words = [sys.executable, "docs/site/build.py", str(out)]
    built = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    assert built.stderr == ""
    return {page.name: Read(page) for page in out.glob("*.html")}


def test_every_page_and_every_reference_is_there(site):
    pages = {page.stem for page in ROOT.glob("docs/*.md")} | {"CHANGELOG", "CONTRIBUTING"}
    made = {f"{what}_reference" for what in ("command", "node", "python", "robot", "scene")}
    assert {f"{name}.html" for name in pages | made} <= site.keys()


def test_the_site_opens_with_the_four_kinds(site):
    """They are the captions of its navigation, in this order."""
    text = (SOURCES / "index.md").read_text(encoding="utf-8")
    captions = re.findall(r"^:caption: (.+)$", text, re.MULTILINE)
    assert captions == ["Tutorials", "How-to guides", "Reference", "Explanation"]


@pytest.mark.parametrize("words", ["backlash", "four bar", "GRF", "sliding mode", "Baumgarte"])
def test_the_search_finds_terms_of_the_field(site, words):
    texts = {page: page.read_text(encoding="utf-8").lower() for page in SOURCES.glob("*.md")}
    assert any(words.lower().replace(" ", joint) in t for t in texts.values() for joint in " -")


def test_no_link_is_dead(site):
    dead = []
    for name, page in site.items():
        for link in page.links:
            file, _, anchor = unquote(link).partition("#")
            if re.match(r"\w+:", file):
                continue
            target = site.get(file or name)
            if target is None or (anchor and anchor not in target.ids):
                dead.append((name, link))
    assert dead == []


def test_nothing_is_loaded_from_elsewhere(site):
    assert {url for page in site.values() for url in page.loads if "//" in url} == set()


def test_references_are_complete(site):
    """Every part, command and node has a heading; equations came through as MathML."""
    parts = {name for kind, names in PARTS.items() if kind != "controllers" for name in names}
    assert {name.replace("_", "-") for name in parts} <= site["scene_reference.html"].ids
    tasks = {f"task-{section.key}" for section in TASKS}
    assert tasks <= site["scene_reference.html"].ids
    assert {name.replace("_", "-") for name in NODES} <= site["node_reference.html"].ids
    assert "math" in site["theory.html"].tags
    assert set(all_words()) <= site["command_reference.html"].ids
    interface = {
        "mbd_ros.api.load_scene",
        "mbd_ros.api.Scene.simulate",
        "mbd_ros.core.contracts.Load",
    }
    assert interface <= site["python_reference.html"].ids


OF_SCENES = {"force_plate"}  # topics that a scene names
TOPIC = re.compile(r"^\| `([^`]+)` \| [\w/]+ \| (?:in|out|service) \|$", re.MULTILINE)


def test_every_topic_of_a_running_node_is_explained(site):
    """What nodes have in ROS, against the tables that people write, where `<name>` is any word."""
    made = (ROOT / "build/docs_source/node_reference.md").read_text(encoding="utf-8")
    text = (ROOT / "docs/nodes.md").read_text(encoding="utf-8")
    words = re.findall(r"`([\w~/<>]+)`", text)
    known = re.compile("|".join(re.sub("<[^>]*>", "[^/]+", word) for word in words))
    topics = set(TOPIC.findall(made))
    assert {"~/joint_torques", "~/reset", "joint_states"} <= topics
    assert {topic for topic in topics - OF_SCENES if not known.fullmatch(topic)} == set()
