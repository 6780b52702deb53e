"""Operations of the equations of a scene, and which of them its parts add."""

from collections.abc import Sequence

from mbd_ros.applications.report.items import Outcome
from mbd_ros.errors import MbdError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.compiling import attempted
from mbd_ros.scene.runs.symbolic_parts import traced

_PARTS = {"operations_loads": ("forces", "actuators"), "operations_rows": ("constraints",)}


def operations(scene: Scene) -> Outcome:
    """Operations of one evaluation of the accelerations as they are compiled.

    Parts are counted by leaving them out: what a scene does not name adds none.

    Args:
        scene: The scene.

    Returns:
        `operations`, of them `operations_loads` and `operations_rows`; or `uncounted`, why not.
    """
    try:
        whole = _count(scene, ())
    except MbdError as error:
        return {"uncounted": str(error)[:160]}
    found: Outcome = {"operations": whole}
    for key, sections in _PARTS.items():
        try:
            found[key] = whole - _count(scene, sections)
        except MbdError:  # others need these parts
            continue
    return found


def _count(scene: Scene, without: Sequence[str]) -> int:
    """Values that accelerations without some sections take.

    Raises:
        MbdError: There are no such equations.
    """

    def take() -> int:
        rest = scene.without(without) if without else scene
        return int(traced(rest).function("accelerate").n_instructions())

    return attempted(take)
