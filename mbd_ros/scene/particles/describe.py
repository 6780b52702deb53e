"""The lines of `mbd-ros check` for a scene of particles."""

import time
from collections.abc import Iterator

import numpy as np

from mbd_ros.core.particles.molecules import Molecules
from mbd_ros.core.particles.particle_system import ParticleSystem
from mbd_ros.errors import SceneError
from mbd_ros.scene.part_lines import line
from mbd_ros.scene.particles.particle_scene import ParticleScene

_STEPS = 20


def describe(scene: ParticleScene) -> Iterator[str]:
    """The lines, label then text.

    Raises:
        MbdError: The scene has no start from which it can move.
    """
    system, units = scene.system(), scene.units
    yield line("scene", scene.name)
    yield line("units", f"{units.name}: {units.length}, {units.time}, energy {units.energy}")
    for kind in system.kinds:
        yield line("molecules", _kind_text(kind))
    box = scene.particles.box
    if box is not None:
        yield line("box", f"periodic, {' x '.join(f'{edge:g}' for edge in box)} {units.length}")
    rank = sum(cluster.rank * kind.count for kind in system.kinds for cluster in kind.clusters)
    yield line("particles", f"{len(system.names)}, degrees of freedom {system.nv - rank}")
    for kind in system.kinds:
        for cluster in kind.clusters:
            if cluster.rank < len(cluster.rows):
                text = f"{cluster.rank} of {len(cluster.rows)} rows of {kind.name}: redundant"
                yield line("rank", f"{text}, multipliers of smallest norm")
    yield from _start_lines(scene, system)
    steps = scene.method.title
    yield line("forward", f"{steps}, dt {scene.dt:g} {units.time}; {_solvers(system)}")
    yield line("cost", f"step {_cost(scene) * 1e6:.3g} us")


def _kind_text(kind: Molecules) -> str:
    rows = sum(len(cluster.rows) for cluster in kind.clusters)
    terms = f", elastic terms {len(kind.terms)}" if kind.terms else ""
    return (
        f"{kind.count} {kind.name} of {', '.join(kind.atoms)}; rows {rows} each in "
        f"{len(kind.clusters)} blocks{terms}"
    )


def _solvers(system: ParticleSystem) -> str:
    largest = max((len(c.rows) for kind in system.kinds for c in kind.clusters), default=0)
    if not largest:
        return "no rows"
    return f"{len(system.rows)} rows in blocks of at most {largest}, Newton side by side"


def _start_lines(scene: ParticleScene, system: ParticleSystem) -> Iterator[str]:
    x, units = scene.initial, scene.units
    with np.errstate(all="ignore"):
        a, _ = system.accelerations(x.q, x.v)
    if not np.isfinite(a).all():
        name = system.names[int(np.flatnonzero(~np.isfinite(a))[0]) // 3]
        raise SceneError(f"{scene.name}: the acceleration of {name} at the start is not finite")
    kinetic, potential = system.kinetic(x.v), system.potential(x.q)
    text = f"kinetic {kinetic:.6g}, potential {potential:.6g} {units.energy}"
    yield line("start", text)


def _cost(scene: ParticleScene) -> float:
    """Time of a step [s], the least of some."""
    stepper, x, least = scene.stepper(), scene.initial, np.inf
    for _ in range(_STEPS):
        begin = time.perf_counter()
        x = stepper.step(x, None)
        least = min(least, time.perf_counter() - begin)
    return float(least)
