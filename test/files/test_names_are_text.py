"""Names of scenes, robots, links and joints are text in every page, whatever they look like."""

import html
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import pytest

from mbd_ros.api import load_scene
from mbd_ros.applications.demo.page import Content, Table
from mbd_ros.applications.demo.page import page as demo_page
from mbd_ros.cli import main
from mbd_ros.files.table import read_result

NAMES = ("<img src=x onerror=alert(1)>", "<_script><img src=x onerror=alert(2)>", "$\\frac{1$ _a_")

SCRIPTS_OF_VISER = 2


class Elements(HTMLParser):
    """Elements that run or load something, and the text of a page."""

    def __init__(self, page):
        super().__init__()
        self.scripts, self.text, self.others = 0, [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.scripts += tag == "script"
        given = dict(attributes)
        if any(name.startswith("on") for name in given) or given.get("src") == "x":
            self.others.append((tag, given))

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(params=NAMES, ids=("image", "script", "formula"))
def scene(request, tmp_path, monkeypatch):
    """A scene whose robot, link, joint and file have one name; `_` stands for a slash in files."""
    monkeypatch.chdir(tmp_path)
    name = request.param.replace("_script", "/script")
    robot, link, joint = map(quoteattr, (name, f"link {name}", name))
    (tmp_path / "arm.urdf").write_text(
        f"""<robot name={robot}><link name="base"/><link name={link}><inertial>
        <origin xyz="0.5 0 0"/><mass value="2"/>
        <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
        <joint name={joint} type="revolute"><parent link="base"/><child link={link}/>
        <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
        </robot>""",
        encoding="utf-8",
    )
    path = tmp_path / f"{request.param.replace(chr(92), '')}.yaml"
    initial = json.dumps({"position": {name: 0.5}})
    path.write_text(f"robot: {{urdf: arm.urdf}}\ninitial: {initial}\n", encoding="utf-8")
    assert main(["simulate", str(path), "-t", "0.1", "-o", "swing.csv"]) == 0
    return path, name


def refuse_elements(page, name, scripts=0):
    found = Elements(page)
    assert (found.others, found.scripts) == ([], scripts)
    assert name in "".join(found.text)


def test_a_picture_is_drawn_and_a_drawing_holds_text(scene):
    name = scene[1]
    for target in ("swing.png", "swing.svg"):
        assert main(["plot", "swing.csv", "-o", target]) == 0
    comments = re.findall("<!-- (.*?) -->", Path("swing.svg").read_text(encoding="utf-8"))
    assert name in {html.unescape(text).strip() for text in comments}
    tags = {e.tag.rpartition("}")[2] for e in ElementTree.parse("swing.svg").iter()}
    assert not tags & {"script", "img", "foreignObject"}


@pytest.mark.parametrize("scene", [NAMES[1]], indirect=True, ids=("script",))
def test_a_report(scene, tmp_path):
    path = scene[0]
    words = ["report", str(path), "--only", "left_out", "-o", "report"]
    subprocess.run([sys.executable, "-m", "mbd_ros", *words], check=True, capture_output=True)
    refuse_elements((tmp_path / "report/index.html").read_text(encoding="utf-8"), path.stem)


def test_a_page_of_a_motion(scene, tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    path = scene[0]
    assert main(["view", str(path), "swing.csv", "-o", "motion.html"]) == 0
    shown = (tmp_path / "motion.html").read_text(encoding="utf-8")
    refuse_elements(shown, path.name, scripts=SCRIPTS_OF_VISER)


def test_tables_and_scenes_in_a_notebook(scene):
    path, name = scene
    refuse_elements(read_result("swing.csv")._repr_html_(), name)
    refuse_elements(load_scene(path)._repr_html_(), name)


@pytest.mark.parametrize("name", NAMES)
def test_a_demo(name):
    table = Table(name, (name, "value"), ((name, "1"),))
    moving, pictures = ("", name), {name: b"png"}
    content = Content(name, name, (name,), (name,), moving, pictures, (table,), {name: name})
    made = demo_page(content)
    refuse_elements(made, name)
