"""Forces of contacts, each on a topic of its own, and what diagnostics say of contacts."""

import re

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile

from mbd_ros.core.dynamics.output_values import Showing, in_link
from mbd_ros.core.geometry.contact_outputs import OPEN, SLIP, STICK
from mbd_ros.core.model.robot import Robot
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.wrench import write_wrench

_WORDS = {OPEN: "open", SLIP: "slip", STICK: "stick"}
_MOST = 8  # contacts that a report names


class ContactTopics:
    """Publishes a WrenchStamped a contact: on the first of its bodies that moves.

    It stands about the origin and in the axes of that link, as its frame_id says, so that a
    listener needs no more than tf to place it, and inverse dynamics takes a recording of it as an
    external wrench of the link.

    Args:
        node: The publishing node.
        robot: The robot of the scene.
    """

    def __init__(self, node: Shell, live: LiveSimulation, robot: Robot, qos: QoSProfile) -> None:
        self._live = live
        self._robot = robot
        self._topics = []
        arrows = live.showing.arrows
        for name in contacts_of(live.showing):
            mine = [i for i, one in enumerate(arrows) if one.name.rpartition(".")[0] == name]
            moving = [i for i in mine if robot.carrier(arrows[i].frame).moves] or mine
            publisher = node.publish_to(WrenchStamped, topic_of(name), qos)
            self._topics.append((publisher, moving[0], arrows[moving[0]].frame, WrenchStamped()))

    def publish(self, stamp: int) -> None:
        """Show the newest state to who listens, stamped [ns]."""
        heard = [topic for topic in self._topics if topic[0].get_subscription_count()]
        if not heard:
            return
        wrenches, k = self._live.wrenches(), self._live.simulation.system.k
        for publisher, number, frame, message in heard:
            whole = in_link(k, self._robot, wrenches[number])
            publisher.publish(write_wrench(message, stamp, frame, whole))


def contacts_of(showing: Showing) -> list[str]:
    """Names of the contacts: of the parts that show a cone, an arrow, a gap and a state."""
    drawn = {arrow.name.rpartition(".")[0] for arrow in showing.arrows}
    numbers = {number.name for number in showing.numbers}
    names = (cone.rpartition(".")[0] for cone in showing.cones)
    return [one for one in names if one in drawn and {f"{one}.gap", f"{one}.state"} <= numbers]


def topic_of(contact: str) -> str:
    """The topic of a contact; what no topic can be called becomes `_`."""
    words = re.sub(r"[^A-Za-z0-9_/]", "_", contact).split("/")
    return "~/contacts/" + "/".join(f"_{word}" if word[:1].isdigit() else word for word in words)


def contact_details(live: LiveSimulation) -> dict[str, str]:
    """State and gap of the contacts at the newest state, for diagnostics.

    With a time-stepping method also the worst residuals of all steps since it was asked last.
    """
    columns = (output.name for output in live.showing.numbers)
    shown = dict(zip(columns, live.now.shown.tolist(), strict=True))
    if not contacts_of(live.showing):
        return {}
    gaps = {name: shown[f"{name}.gap"] for name in contacts_of(live.showing)}
    states = {name: shown[f"{name}.state"] for name in gaps}
    first = sorted(gaps, key=lambda name: states[name] == OPEN)  # stable: those that press
    texts = [f"{name} {_WORDS[states[name]]}, gap {gaps[name]:.3g} m" for name in first[:_MOST]]
    deepest = min(gaps, key=lambda name: gaps[name])
    more = f"; and {len(first) - _MOST} more" if len(first) > _MOST else ""
    return {
        "contacts": "; ".join(texts) + more,
        "smallest gap": f"{gaps[deepest]:.3g} m, {deepest}",
        **_residuals(live),
    }


def _residuals(live: LiveSimulation) -> dict[str, str]:
    residuals = live.simulation.take_residuals()
    if residuals is None:
        return {}
    from mbd_ros.features.simulation.checks import UNITS  # only where a method has residuals

    largest = sorted(residuals._asdict().items(), key=lambda item: -item[1])
    texts = [f"{name} {value:.2g} {UNITS[name]}" for name, value in largest]
    return {"worst contact residual": texts[0], "contact residuals": ", ".join(texts)}
