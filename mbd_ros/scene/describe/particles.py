"""The lines of `mbd-ros check` for a scene of particles."""

import time
from collections.abc import Iterator

import numpy as np

from mbd_ros.errors import SceneError
from mbd_ros.methods.particles.molecules import ElasticBond, Molecules
from mbd_ros.methods.particles.pairs import Pairs, PlainKernel
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.settle import SettledCluster
from mbd_ros.methods.particles.units import Units
from mbd_ros.scene.describe.check import line
from mbd_ros.scene.describe.stiffness_windows import Line
from mbd_ros.scene.particles.particle_scene import ParticleScene

_STEPS = 20
_STABLE = 2.0  # of Verlet's steps: dt times the frequency of an oscillation


def describe(scene: ParticleScene) -> Iterator[str]:
    """The lines, label then text.

    Raises:
        MbdError: The scene has no start from which it can move.
    """
    with np.errstate(all="ignore"):  # what is not finite is said
        for label, text in _lines(scene):
            yield line(label, text)


def _lines(scene: ParticleScene) -> Iterator[Line]:
    system, units = scene.system(), scene.units
    yield "scene", scene.name
    yield "units", f"{units.name}: {units.length}, {units.time}, energy {units.energy}"
    for kind in system.kinds:
        yield "molecules", _kind_text(kind)
    box = scene.particles.box
    if box is not None:
        yield "box", f"periodic, {' x '.join(f'{edge:g}' for edge in box)} {units.length}"
    if isinstance(system.pairs, Pairs):
        yield "pairs", _pair_text(system.pairs, units)
    rank = sum(cluster.rank * kind.count for kind in system.kinds for cluster in kind.clusters)
    yield "particles", f"{len(system.masses)}, degrees of freedom {system.nv - rank}"
    for kind in system.kinds:
        for cluster in kind.clusters:
            if cluster.rank < len(cluster.rows):
                text = f"{cluster.rank} of {len(cluster.rows)} rows of {kind.name}: redundant"
                yield "rank", f"{text}, multipliers of smallest norm"
    yield from _start_lines(scene, system)
    yield from _stiff_lines(scene, system)
    steps = scene.method.title
    if system.steps is not None:
        steps += ", native"
    yield "forward", f"{steps}, dt {scene.dt:g} {units.time}; {_solvers(system)}"
    yield "cost", f"step {_cost(scene) * 1e6:.3g} us"


def _stiff_lines(scene: ParticleScene, system: ParticleSystem) -> Iterator[Line]:
    """A warning where an elastic bond vibrates too fast for the step."""
    for kind in system.kinds:
        for bond in kind.terms:
            if isinstance(bond, ElasticBond):
                mobility = 1.0 / kind.masses[bond.i] + 1.0 / kind.masses[bond.j]
                longest = _STABLE / float(np.sqrt(bond.stiffness * mobility))
                if scene.dt >= longest:
                    ends = f"{kind.atoms[bond.i]} and {kind.atoms[bond.j]} of {kind.name}"
                    text = f"{ends} vibrate too fast: steps grow from dt {longest:.3g} on"
                    yield "warning", text


def _kind_text(kind: Molecules) -> str:
    rows = sum(len(cluster.rows) for cluster in kind.clusters)
    terms = f", elastic terms {len(kind.terms)}" if kind.terms else ""
    return (
        f"{kind.count} {kind.name} of {', '.join(kind.atoms)}; rows {rows} each in "
        f"{len(kind.clusters)} blocks{terms}"
    )


def _solvers(system: ParticleSystem) -> str:
    """How rows are solved."""
    clusters = [cluster for kind in system.kinds for cluster in kind.clusters]
    if not clusters:
        return "no rows"
    settled = [c for c in clusters if isinstance(c, SettledCluster)]
    largest = max((len(c.rows) for c in clusters if c not in settled), default=0)
    newton = f"blocks of at most {largest} by Newton side by side" if largest else ""
    ways = ", ".join(filter(None, ("rigid triangles by SETTLE" if settled else "", newton)))
    return f"{system.row_count} rows: {ways}"


def _pair_text(pairs: Pairs, units: Units) -> str:
    how = "native code" if not isinstance(pairs.kernel, PlainKernel) else "arrays"
    return f"between molecules up to {pairs.model.cutoff:g} {units.length}, {how}"


def _start_lines(scene: ParticleScene, system: ParticleSystem) -> Iterator[Line]:
    x, units = scene.initial, scene.units
    a, _ = system.accelerations(x.q, x.v)
    if not np.isfinite(a).all():
        name = system.names[int(np.flatnonzero(~np.isfinite(a))[0]) // 3]
        raise SceneError(f"{scene.name}: the acceleration of {name} at the start is not finite")
    kinetic, potential = system.kinetic(x.v), system.potential(x.q)
    text = f"kinetic {kinetic:.6g}, potential {potential:.6g} {units.energy}"
    yield "start", text


def _cost(scene: ParticleScene) -> float:
    """Time of a step [s], the least of some."""
    stepper, x, least = scene.stepper(), scene.initial, np.inf
    for _ in range(_STEPS):
        begin = time.perf_counter()
        x = stepper.step(x, None)
        least = min(least, time.perf_counter() - begin)
    return float(least)
