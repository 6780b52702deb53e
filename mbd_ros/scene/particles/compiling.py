"""What of a scene of particles runs in native code."""

from collections.abc import Callable
from typing import Any

from mbd_ros.core.particles.molecules import Molecules
from mbd_ros.core.particles.pairs import Pairs
from mbd_ros.core.particles.particle_system import ParticleSystem
from mbd_ros.core.particles.verlet_steps import KindSteps
from mbd_ros.errors import MbdError, SceneError


def compiled_system(system: ParticleSystem, force_unit: str) -> ParticleSystem:
    """The system with native forces of pairs, and native steps where a kind has them.

    Raises:
        MbdError: There is no compiler, or a package is missing.
    """
    pairs: Any = system.pairs
    if isinstance(pairs, Pairs):
        from mbd_ros.compiled.particles.pair_kernel import CompiledKernel

        pairs = pairs.with_kernel(CompiledKernel(pairs.model))
    return ParticleSystem(system.kinds, pairs, force_unit, _steps(system))


def system_for(system: ParticleSystem, force_unit: str, kind: str, where: str) -> ParticleSystem:
    """The system as the section `solver` asks for it.

    Args:
        system: The plain one.
        force_unit: For the names of multipliers.
        kind: plain, compiled or auto.
        where: File and key, for the messages.

    Raises:
        SceneError: It must be compiled and cannot be.
    """
    if kind == "plain":
        return system
    try:
        return compiled_system(system, force_unit)
    except (MbdError, ImportError) as error:
        if kind == "auto":
            return system
        raise SceneError(f"{where}: {error}") from error


def _steps(system: ParticleSystem) -> Callable[[Molecules, float, bool], KindSteps] | None:
    """What takes half steps of a kind; None where none is native."""
    if not any(len(kind.atoms) == 3 and len(kind.rows) == 3 for kind in system.kinds):
        return None
    from mbd_ros.compiled.particles.molecule_steps import CompiledTriangles, is_compiled

    def steps(kind: Molecules, tolerance: float, projects: bool) -> KindSteps:
        made_by = CompiledTriangles if is_compiled(kind) else KindSteps
        return made_by(kind, tolerance, projects)

    return steps
