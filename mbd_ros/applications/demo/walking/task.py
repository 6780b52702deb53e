"""What is simulated: the swing of a leg by muscles, and the markers that a laboratory sees."""

from typing import NamedTuple

import numpy as np

from mbd_ros.api import Scene, load_scene
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.scene.variants import with_sections

SCENE = "muscle_leg"
DURATION, STEP = 0.42, 0.005  # s: of a swing in walking; of the cameras
NOISE = 0.001  # m, standard deviation of each component of a marker
SEED = 20
BODY_MASS = 75.16  # kg, of the person whose leg this is: gait2354, docs/models.md
JOINTS = ("hip", "knee", "ankle")
_LEAST = 0.01  # excitation
_START = {  # rad, rad/s: as the toes leave the ground, chosen here
    "position": {"hip": -0.2, "knee": -0.75, "ankle": -0.35},
    "velocity": {"hip": 3.0, "knee": -5.0, "ankle": 1.0},
}


class Burst(NamedTuple):
    """A muscle that is excited for a time, chosen here so that the leg swings as in walking."""

    muscle: str
    begin: float
    end: float
    excitation: float


BURSTS = (
    Burst("iliopsoas", 0.0, 0.15, 0.40),  # pulls the thigh forward
    Burst("rectus_femoris", 0.0, 0.12, 0.06),  # keeps the heel from rising too far
    Burst("tibialis_anterior", 0.0, 0.30, 0.12),  # lifts the toes
    Burst("hamstrings", 0.27, 0.42, 0.20),  # brake the shank
    Burst("gluteus_maximus", 0.35, 0.42, 0.04),  # brakes the thigh
)
MARKERS = {  # places on the surface of the links, chosen here
    "thigh_front": ("femur", [0.07, 0.0, -0.15]),
    "thigh_side": ("femur", [0.0, -0.08, -0.25]),
    "knee_side": ("femur", [0.0, -0.06, -0.39]),
    "shank_front": ("tibia", [0.05, 0.0, -0.12]),
    "shank_side": ("tibia", [0.0, -0.05, -0.25]),
    "ankle_side": ("tibia", [0.0, -0.05, -0.41]),
    "heel": ("calcaneus", [-0.02, 0.0, 0.03]),
    "midfoot": ("calcaneus", [0.12, 0.0, 0.07]),
    "toe": ("toes", [0.04, 0.0, 0.02]),
}


def marked_leg() -> Scene:
    """The leg with markers, as the toes leave the ground."""
    sensors = {
        name: {"type": "marker", "frame": frame, "xyz": xyz, "noise": NOISE}
        for name, (frame, xyz) in MARKERS.items()
    }
    return with_sections(load_scene(SCENE), sensors=sensors, initial=_START)


def excitations(scene: Scene) -> Result:
    """Excitations of all muscles, each held until the next row."""
    time = np.arange(round(DURATION / STEP) + 1) * STEP
    columns = [Column("time", time, "s")]
    bursts = {burst.muscle: burst for burst in BURSTS}
    for muscle in scene.muscles:
        values = np.full(len(time), _LEAST)
        if burst := bursts.get(muscle.name):
            inside = (time >= burst.begin - 1e-9) & (time < burst.end - 1e-9)
            values[inside] = burst.excitation
        columns.append(Column(f"{muscle.name}.excitation", values))
    return Result({MAIN: Table(columns)})


def recorded(swing: Result) -> Result:
    """Markers of a simulated swing with the noise of cameras: what a laboratory has."""
    samples, random = swing[MAIN], np.random.default_rng(SEED)
    columns = [samples.column("time")]
    for name in MARKERS:
        for axis in "xyz":
            seen = samples[f"{name}.position_{axis}"]
            noisy = seen + random.normal(0.0, NOISE, len(seen))
            columns.append(Column(f"{name}.{axis}", noisy, "m"))
    return Result({MAIN: Table(columns)})
