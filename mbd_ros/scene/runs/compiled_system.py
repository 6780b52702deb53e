"""The system of a scene with exact derivatives."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.compiling import Tell, attempted
from mbd_ros.scene.runs.symbolic_parts import traced

if TYPE_CHECKING:
    from mbd_ros.compiled.runs.compiled_system import CompiledSystem


def _silent(line: str) -> None:
    """Nobody is told."""


def compiled_system(
    scene: Scene,
    parameters: Mapping[str, float] | None = None,
    *,
    solver: Mapping[str, str] | None = None,
    tell: Tell = _silent,
) -> "CompiledSystem":
    """The system of a scene with exact `derivatives`, in native code.

    Those by parameters are in the order in which they are given.

    Args:
        scene: The scene.
        parameters: Values by name, as `Scene.with_` takes them.
        solver: Entry that replaces that of the scene; of it, the tier counts.
        tell: Is told what takes time.

    Raises:
        ModelError: It cannot be compiled; says why.
        SceneError: Names a parameter that no part has.
    """
    given = dict(parameters or {})
    changed = scene.with_(given) if given else scene
    system = changed.system((), solver)

    def take() -> "CompiledSystem":
        from mbd_ros.compiled.runs import implicit_method

        implicit_method.refuse_bounds(system)
        form, p = traced(changed, system, list(given)), np.array(list(given.values()))
        return implicit_method.compiled_system(system, form, p, tell)

    return attempted(take)
