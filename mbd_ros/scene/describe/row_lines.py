"""Lines of `mbd-ros check` about rows that give way: exact or smoothed, and what that costs."""

from collections.abc import Iterator

from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.describe.part_lines import line, type_name

SMOOTHED_ORDER = 2  # across a kink of the accelerations, of any method


def row_lines(scene: Scene, layout: RowLayout) -> Iterator[str]:
    """A line for exact rows and one for smoothed ones, where there are any.

    Methods at the velocity level solve for both alike.

    Source: E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 1993,
    II.6, on the order of steps across discontinuities.

    Args:
        scene: The scene.
        layout: Its rows, some of which give way.
    """
    method = scene.method
    name, order = type_name(method), method.order
    if method.at_velocity_level:
        names = listed([block.part.name for block in layout.yielding])
        yield line("stepped", f"{names}; solved for once a step of {name}, impacts included")
        return
    exact, smoothed = (
        [block.part.name for block in layout.yielding if block.smoothed is is_smoothed]
        for is_smoothed in (False, True)
    )
    if exact:
        text = "steps end where rows begin and cease to act"
        yield line("exact", f"{listed(exact)}; {text}, {name} keeps its order {order}")
    if smoothed:
        where = "in steps in which a row begins or ceases to act"
        cost = f"{name} has order {SMOOTHED_ORDER} in place of {order} {where}"
        if order <= SMOOTHED_ORDER:
            cost = f"{name} has order {order} all the same"
        yield line("smoothed", f"{listed(smoothed)}; solved for in every evaluation, {cost}")
