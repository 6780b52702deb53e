"""Input of CalculiX and Abaqus: one step over the whole motion, loads as amplitudes over time.

CalculiX goes through the times of a static step with large displacements only, and takes one
amplitude a node and direction: gravity and inertia are the field of the mass centre, the part by
rotation is left out. Source: G. Dhondt, CalculiX CrunchiX USER'S MANUAL version 2.20, sections
*AMPLITUDE, *STATIC, *STEP.
"""

from collections.abc import Iterator

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.features.loads.fem.calculix import OUTPUT, SOLID, model_lines, references_of
from mbd_ros.features.loads.fem.centre_field import centre_field, load_over_time
from mbd_ros.features.loads.fem.model import Body

_PAIRS = 4  # of time and value a line


def amplitude_lines(body: Body) -> Iterator[str]:
    """The lines of an input file."""
    stamps, L = body.history.stamps, body.units.per_metre
    times = (stamps - stamps[0]) * NANOSECOND
    yield from model_lines(body)
    references, forces, fields = references_of(body), list[str](), list[str]()
    for one in body.loaded:
        force, moment = load_over_time(body, one)
        moving, turning = references[one.name]
        first = 1 if turning != moving else 4
        for node, start, values in ((moving, 1, force), (turning, first, moment * L)):
            for axis, curve in enumerate(values.T):
                if curve.any():
                    name = f"LOAD_{len(forces)}"
                    yield from _amplitude(name, times, curve)
                    forces.append(f"*CLOAD,AMPLITUDE={name}\n{node},{start + axis},1.")
    for axis, curve in enumerate(centre_field(body).T * L):
        if curve.any():
            yield from _amplitude(f"FIELD_{axis}", times, curve)
            direction = ",".join("1." if i == axis else "0." for i in range(3))
            fields.append(f"*DLOAD,AMPLITUDE=FIELD_{axis}\n{SOLID},GRAV,1.,{direction}")
    yield f"** from t = {stamps[0] * NANOSECOND:.9g} s on"
    yield f"*STEP,NLGEOM,INC={2 * len(times) + 100}"
    yield "*STATIC,DIRECT"
    yield f"{times[-1] / max(len(times) - 1, 1):.12g},{times[-1]:.12g}"
    yield from (*forces, *fields, *OUTPUT, "*END STEP")


def _amplitude(name: str, times: Array, values: Array) -> Iterator[str]:
    yield f"*AMPLITUDE,NAME={name}"
    pairs = [f"{t:.12g},{v:.12g}" for t, v in zip(times.tolist(), values.tolist(), strict=True)]
    for i in range(0, len(pairs), _PAIRS):
        yield ",".join(pairs[i : i + _PAIRS])
