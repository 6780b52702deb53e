"""Small recordings of motion capture, as they come and with flipped bytes."""

import random
import struct

import numpy as np

CORNERS = np.array([[0.5, 0.9, 0.0], [0.1, 0.9, 0.0], [0.1, 0.3, 0.0], [0.5, 0.3, 0.0]])  # m
TURN = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])  # of a plate, about z
DEPTH = np.array([0.01, -0.02, -0.04])  # from the transducer to the surface, in axes of the plate
CALIBRATION = np.eye(6) + 0.1 * np.random.default_rng(1).standard_normal((6, 6))
CALIBRATION[:3, 3:] *= 1e-3  # from N·mm to N
SPACING = np.array([0.12, 0.2])  # m, of the sensors of a plate of type 3 from its middle


def channels_of(kind, force, moment, spacing):
    """What a plate sends for a force and its moment about the middle of its sensors."""
    if kind == 4:
        return np.linalg.solve(CALIBRATION, np.vstack([force.T, moment.T]))
    if kind != 3:
        return np.vstack([force.T, moment.T])
    (x, y, z), (a, b) = force.T, spacing
    mx, my, mz = (m / (4.0 * d) for m, d in zip(moment.T, (b, a, b), strict=True))
    pairs = [x / 2.0 - 2.0 * mz, x / 2.0 + 2.0 * mz, y / 2.0, y / 2.0]
    signs = ((1, -1), (1, 1), (-1, 1), (-1, -1))
    return np.vstack([*pairs, *(z / 4.0 + s * mx + t * my for s, t in signs)])


def recording(ezc3d, path, wrenches=(), kind=2, unit="mm", first=50):
    """Two markers at 100 Hz, and at 200 Hz plates whose channels follow from their wrenches."""
    origin = np.array([*SPACING, DEPTH[2]]) if kind == 3 else DEPTH
    depth = DEPTH * [0.0, 0.0, 1.0] if kind == 3 else DEPTH
    scale = {"mm": 1000.0, "m": 1.0}[unit]
    rng, whole = np.random.default_rng(6), ezc3d.c3d()
    positions = rng.standard_normal((3, 2, 4))
    positions[:, 1, 2] = np.nan
    points = whole["parameters"]["POINT"]
    points["LABELS"]["value"], points["UNITS"]["value"] = ["R.Knee Med", "Heel"], [unit]
    points["RATE"]["value"] = [100.0]
    whole["data"]["points"] = np.concatenate([scale * positions, np.ones((1, 2, 4))])
    whole["header"]["points"]["first_frame"] = first
    channels, corners = [], []
    for k, (force, torque) in enumerate(wrenches):
        places = CORNERS @ TURN.T + [0.7 * k, 0.0, 0.0]
        x, y = places[0] - places[1], places[0] - places[3]
        R = np.column_stack([x, y, np.cross(x, y)]) / np.linalg.norm(
            [x, y, np.cross(x, y)], axis=1
        )
        centre = places.mean(axis=0)
        at_centre = (torque - np.cross(centre, force)) @ R
        F = force @ R
        moment = scale * (at_centre + np.cross(depth, F))
        channels += [*channels_of(kind, F, moment, scale * SPACING)]
        corners.append(scale * places.T)
    if wrenches:
        n, plates = len(wrenches), whole["parameters"]["FORCE_PLATFORM"]
        plates["USED"]["value"], plates["TYPE"]["value"] = [n], [kind] * n
        plates["CORNERS"]["value"] = np.stack(corners, axis=2)
        plates["ORIGIN"]["value"] = np.repeat(scale * origin[:, None], n, axis=1)
        each = len(channels) // n
        plates["CHANNEL"]["value"] = np.arange(1, each * n + 1).reshape(n, each).T
        if kind == 4:
            plates["CAL_MATRIX"]["value"] = np.repeat(CALIBRATION[:, :, None], n, axis=2)
        whole.add_parameter("FORCE_PLATFORM", "UNITS", ["N"])
        analog = whole["parameters"]["ANALOG"]
        analog["RATE"]["value"] = [200.0]
        analog["LABELS"]["value"] = [f"c{i}" for i in range(each * n)]
        analog["UNITS"]["value"] = ["V"] * (each * n)
        whole["data"]["analogs"] = np.array(channels)[None]
    whole.write(str(path))
    return positions


def flipped(seeds, number):
    """A file with one to six places of its header or parameters changed, cut or widened."""
    rng = random.Random(f"c3d {number}")
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        at = rng.choice((rng.randrange(24), rng.randrange(512, len(data) - 512)))
        new = rng.choice(
            (
                rng.randbytes(1),
                bytes([rng.choice((0, 1, 127, 128, 255))]),
                struct.pack("<H", rng.choice((0, 1, 255, 32767, 32768, 65535))),
                struct.pack("<f", rng.choice((0.0, -1.0, 1e9, 1e-9, np.nan, np.inf, 1e30))),
            )
        )
        data[at : at + rng.choice((len(new), len(new), len(new), 0))] = new
    return bytes(data)
