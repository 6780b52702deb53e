"""Cases that several tests share: phase guards."""

from mechanisms import joint, link, urdf

import mbd_ros as mbd

G, MASS = 9.81, 2.0


SLIDER = urdf(link("world"), link("mass", MASS), joint("slide", "prismatic", "world", "mass"))


GROUND = {
    "name": "sole",
    "type": "rigid",
    "between": [{"frame": "mass", "points": [[0.0, 0.0, 0.0]]}, {"half_space": [0, 0, 1]}],
    "friction": 0.5,
}


METHOD = {"type": "dop853", "tolerance": 1.0e-11}


def slider(phases, height=0.0, speed=0.0, **more):
    """A mass on a vertical rail, with a contact that phases name."""
    initial = {"position": {"slide": height}, "velocity": {"slide": speed}}
    entries = {"contacts": [GROUND], "phases": phases, "initial": initial, "integrator": METHOD}
    return mbd.scene_from({**entries, "dt": 0.01, **more}, urdf=SLIDER)
