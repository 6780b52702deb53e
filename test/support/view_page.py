"""Cases that several tests share: view page."""

import io
import time

import numpy as np
from deadline import DEADLINE
from PIL import Image

from mbd_ros.api import load_scene

NOTICE = 190  # px


EVIL = "<img src=x onerror=alert(1)>"


URDF = f"""
<robot name="arm">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="arm"><visual><origin xyz="0.5 0 0"/><geometry><box size="1 0.3 0.3"/></geometry>
    <material name="red"><color rgba="1 0 0 1"/></material></visual>
    <inertial><origin xyz="0.5 0 0"/><mass value="2"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
  <joint name="{EVIL.replace("<", "&lt;").replace(">", "&gt;")}" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
</robot>"""


def pixels(tab):
    """What is beside the panel and below a notice of the page, shape (height, width, 3)."""
    image = np.asarray(Image.open(io.BytesIO(tab.screenshot())).convert("RGB")).astype(int)
    return image[NOTICE:, :896] if image.shape[1] > 896 else image[NOTICE:340]


def red(image):
    return (image[..., 0] > 110) & (image[..., 1] < 90) & (image[..., 2] < 90)


def orange(image):
    """Where arrows are."""
    return image[..., 0] - image[..., 2] > 30


def settled(tab, condition):
    """The first picture that meets a condition, or the last one."""
    from playwright.sync_api import Error

    end = time.monotonic() + DEADLINE
    while True:
        try:
            image = pixels(tab)
        except Error:  # Chromium is too busy to draw one
            if time.monotonic() > end:
                raise
            continue
        if condition(image) or time.monotonic() > end:
            return image
        tab.wait_for_timeout(150)


def evil_arm(tmp_path, base="fixed"):
    """An arm whose joint and scene are named as if they were HTML."""
    file = tmp_path / "arm.urdf"
    file.write_text(URDF, encoding="utf-8")
    scene = tmp_path / f"{EVIL}.yaml"
    scene.write_text(f"robot: {{urdf: arm.urdf, base: {base}}}\n", encoding="utf-8")
    return load_scene(scene)
