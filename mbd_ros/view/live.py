"""A live page that shows robots as they move; who has their samples draws it, at his own pace.

Texts of others are values of fields of the panel, which are never read as HTML.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SolveError, printable
from mbd_ros.view.curves import ALL, MOST, LiveSample, Plot
from mbd_ros.view.curves import LIVE_QUANTITIES as QUANTITIES
from mbd_ros.view.drawing import Ground, Stage
from mbd_ros.view.frames import joint_indices
from mbd_ros.view.live_robot import LiveRobot, Pull, Pulled, Reach
from mbd_ros.view.page import Follower
from mbd_ros.view.server import PageServer

_NOBODY = "nobody"
_PLOTTED = 6  # frames for one of curves and texts
_APART = 1.5  # sizes between robots that would stand in each other
_WAITING = 20  # wishes that are kept
_SHOWN = {"forces": True, "moments": False, "cones": True, "paths": True, "frames": False}
_ARROWS = ("forces", "moments")
COMMANDS = ("pause", "run", "step", "reset")
REAL_TIME_FACTOR = "real-time factor"


class LivePage:
    """Robots in browsers; one thread draws, callbacks of the page only leave wishes.

    Args:
        robots: At least one; those of one scene stand side by side.
        title: Of the page, where robots have none.
        offsets: Where the world of each robot is on the page [m], shape (robots, 3), if not so.
    """

    def __init__(
        self,
        server: PageServer,
        robots: Sequence[LiveRobot],
        title: str,
        offsets: Array | None = None,
    ) -> None:
        self.server, self.robots, self._frame = server, list(robots), 0
        viser = server.viser
        places = _offsets(robots) if offsets is None else offsets
        for robot, offset in zip(robots, places, strict=True):
            robot.offset = offset
        low = np.min([robot.low + robot.offset for robot in robots], axis=0)
        high = np.max([robot.high + robot.offset for robot in robots], axis=0)
        Ground(viser, robots[0].up).surround(low, high)
        for number, robot in enumerate(robots):
            robot.show(viser, f"/{number}")
        self._panel = LivePanel(viser.gui, robots, title)
        for number, robot in enumerate(robots):
            for solid, node in robot.stage.solids:
                choose = self._panel.chooser(number, solid.joint)
                if choose is not None:  # what is not clicked on hides nothing that is
                    node.on_click(choose)
        self._pull, self._follower = Pull(self.robots, viser), Follower(viser)
        self._reach: Reach | None = None
        self._refused: tuple[LiveRobot, int] | None = None
        self._samples: list[LiveSample | None] = [None] * len(robots)
        self._remarks = [line for robot in robots for line in robot.remarks]

    def take_wish(self) -> Wish | None:
        """The oldest wish that was not taken yet."""
        return self._panel.wishes.popleft() if self._panel.wishes else None

    def draw(self, samples: Sequence[LiveSample | None]) -> bool:
        """Draw the robots.

        Args:
            samples: Of each robot; None to leave it as it is.

        Returns:
            Whether anything was drawn anew.
        """
        panel, is_changed = self._panel, self._panel.changed()
        with self.server.viser.atomic():
            for number, (robot, sample) in enumerate(zip(self.robots, samples, strict=True)):
                if sample is not None:
                    self._samples[number] = sample
                    robot.curves.add(sample)
                newest = self._samples[number]
                if is_changed:
                    panel.apply_to(robot.stage)
                if newest is not None and (is_changed or sample is not None):
                    robot.draw(newest, panel.arrows, panel.scale)
            followed = panel.followed
            place = None if followed is None else self.robots[panel.robot].place_of(followed)
            self._follower.follow((panel.robot, followed), place)
        if self._frame % _PLOTTED == 0:
            panel.plot()
        self._frame += 1
        return is_changed or any(sample is not None for sample in samples)

    def pulled(self) -> Pulled | None:
        """The force of the mouse; None while nobody pulls."""
        self._pull.strength = self._panel.strength
        self._pull.need_shift(not self._panel.pulls_without_shift)
        return self._pull.now()

    def reached(self, states: Sequence[Array]) -> tuple[int, Array] | None:
        """A posture that somebody asked a robot for by its target.

        Args:
            states: Configuration of each robot.

        Returns:
            Number of the robot, and the configuration, shape (nq,); None without a new one.
        """
        try:
            self._choose_target(states)
            posture = None if self._reach is None else self._reach.posture()
        except (ModelError, SolveError) as error:
            self.answer(f"target: {error}")
            return None
        if posture is None or self._reach is None:
            return None
        return self.robots.index(self._reach.robot), posture

    def answer(self, line: str) -> None:
        """Say what became of a wish."""
        self._panel.say("answer", [line])

    def report(self, state: Sequence[str], reports: Sequence[str]) -> None:
        """Say how robots and nodes are."""
        faults = [robot.fault for robot in self.robots if robot.fault]
        self._panel.say("state", [*state, *faults, *self._remarks])
        self._panel.say("reports", reports)

    def _choose_target(self, states: Sequence[Array]) -> None:
        """Have the handle that is asked for, or none."""
        panel, reach = self._panel, self._reach
        joint = panel.joint if panel.reaches else None
        robot = self.robots[panel.robot]
        if reach is not None and (reach.joint != joint or reach.robot is not robot):
            reach.remove()
            self._reach = None
        if joint is None or self._reach is not None or self._refused == (robot, joint):
            return
        self._refused = robot, joint  # said once, if it is
        self._reach = Reach(robot, joint, self.server.viser, states[panel.robot])
        self._refused = None


def _offsets(robots: Sequence[LiveRobot]) -> list[Array]:
    """Robots of one scene side by side, others where their scenes place them."""
    count: dict[str, int] = {}
    offsets = []
    for robot in robots:
        before = count.get(robot.scene.name, 0)
        count[robot.scene.name] = before + 1
        offsets.append(robot.up[:, 1] * before * _APART * robot.size)
    return offsets


class LivePanel:
    """Buttons, what is shown, curves, values, the mouse, and reports; one robot at a time.

    Args:
        gui: The `viser.GuiApi`.
        robots: The robots of the page.
        title: Of the page.

    Attributes:
        wishes: What is to be done, the oldest first.
    """

    def __init__(self, gui: Any, robots: Sequence[LiveRobot], title: str) -> None:
        self._gui, self._robots = gui, robots
        self.wishes: deque[Wish] = deque(maxlen=_WAITING)
        self._known = [joint_indices(robot.scene.robot) for robot in robots]
        self._texts: dict[str, str] = {}
        self._seen: tuple[Any, ...] = ()
        self._titles = [printable(robot.title) or title for robot in robots]
        self._robot_dropdown = gui.add_dropdown(
            "robot", self._titles, initial_value=self._titles[0], visible=len(robots) > 1
        )
        self._fields = {"state": gui.add_text("state", "", multiline=True, disabled=True)}
        self._simulator_of()
        self._view_of()
        self._plot_of()
        self._mouse_of()
        with gui.add_folder("diagnostics", expand_by_default=False):
            field = gui.add_text("reports", "", multiline=True, disabled=True)
            self._fields["reports"] = field
        self._robot_dropdown.on_update(self._on_robot)

    def _simulator_of(self) -> None:
        gui = self._gui
        with gui.add_folder("simulator"):
            buttons = gui.add_button_group("time", COMMANDS)
            buttons.on_click(lambda _: self._ask(buttons.value))
            factor = gui.add_number(REAL_TIME_FACTOR, 1.0, min=0.0, max=1000.0, step=0.05)
            factor.on_update(lambda _: self._ask(REAL_TIME_FACTOR, float(factor.value)))
            self._fields["answer"] = gui.add_text("answer", "", multiline=True, disabled=True)

    def _view_of(self) -> None:
        gui = self._gui
        with gui.add_folder("view", expand_by_default=False):
            self._shown = {name: gui.add_checkbox(name, on) for name, on in _SHOWN.items()}
            self._scale = gui.add_slider("scale of arrows", 0.1, 10.0, 0.1, 1.0)
            followed = [_NOBODY, *self._known[0]]
            self._followed = gui.add_dropdown("follow", followed, initial_value=_NOBODY)

    def _plot_of(self) -> None:
        gui = self._gui
        with gui.add_folder("curves"):
            joints = [ALL, *self._known[0]]
            self._joint = gui.add_dropdown("joint", joints, initial_value=ALL)
            self._quantity = gui.add_dropdown("quantity", QUANTITIES, initial_value="position")
            self._fields["values"] = gui.add_text("values", "", multiline=True, disabled=True)
            self._plot = Plot(gui, gui.add_folder("plot"))

    def _mouse_of(self) -> None:
        gui = self._gui
        with gui.add_folder("mouse"):
            self._pulls = gui.add_checkbox("pull without shift", False)
            self._strength = gui.add_slider("strength", 0.1, 10.0, 0.1, 1.0)
            self._reaches = gui.add_checkbox("target of the joint", False)

    def _ask(self, what: str, value: float = 0.0) -> None:
        if what in (*COMMANDS, REAL_TIME_FACTOR):
            self.wishes.append(Wish(self.robot, what, value))

    def _on_robot(self, _: Any) -> None:
        known = self._known[self.robot]
        self._followed.options = [_NOBODY, *known]
        self._joint.options = [ALL, *known]

    def chooser(self, number: int, joint: int) -> Callable[[Any], None] | None:
        """Return the reaction to a click on a solid: it chooses a robot and a joint or free body.

        None for a solid that nothing moves.
        """
        name = next((n for n, at in self._known[number].items() if at == joint), None)
        if name is None:
            return None

        def choose(_: Any) -> None:
            self._robot_dropdown.value = self._titles[number]
            self._on_robot(None)
            self._joint.value = name

        return choose

    @property
    def robot(self) -> int:
        """Which robot is chosen."""
        chosen = self._robot_dropdown.value
        return self._titles.index(chosen) if chosen in self._titles else 0

    @property
    def joint(self) -> int | None:
        """Index in the model of the chosen joint or free body; None for all."""
        return self._known[self.robot].get(self._joint.value)

    @property
    def followed(self) -> int | None:
        """Index in the model of the joint that cameras follow; None without one."""
        return self._known[self.robot].get(self._followed.value)

    @property
    def arrows(self) -> list[str]:
        """Which arrows are shown."""
        return [name for name in _ARROWS if self._shown[name].value]

    @property
    def scale(self) -> float:
        """Factor of the length of arrows."""
        return float(self._scale.value)

    @property
    def pulls_without_shift(self) -> bool:
        """Whether any drag on a link pulls."""
        return bool(self._pulls.value)

    @property
    def strength(self) -> float:
        """Factor of the force of the mouse."""
        return float(self._strength.value)

    @property
    def reaches(self) -> bool:
        """Whether the chosen joint has a target."""
        return bool(self._reaches.value)

    def changed(self) -> bool:
        """Whether something is to be drawn in another way than at the last call."""
        seen = (*(one.value for one in self._shown.values()), self.scale)
        before, self._seen = self._seen, seen
        return seen != before

    def apply_to(self, stage: Stage) -> None:
        """Let a stage show what is chosen."""
        shown = {name: bool(one.value) for name, one in self._shown.items()}
        stage.shows_cones, stage.shows_paths = shown["cones"], shown["paths"]
        stage.show_axes(shown["frames"])

    def say(self, where: str, lines: Sequence[str]) -> None:
        """Show lines in `state`, `answer`, `values` or `reports`."""
        text = printable("\n".join(lines))
        if self._texts.get(where) != text:
            self._texts[where] = self._fields[where].value = text

    def plot(self) -> None:
        """Bring curves and values of the chosen joint up to date."""
        curves, joint = self._robots[self.robot].curves, self._joint.value
        lines = curves.values(joint)
        self.say("values", lines or ["click on a link, or choose a joint"])
        asked = self._quantity.value
        quantity = asked if asked in QUANTITIES else QUANTITIES[0]
        choice = self.robot, joint, quantity
        self._plot.show(choice, curves.of(joint, quantity).first(MOST))


class Wish(NamedTuple):
    """A request that a visitor made on a page.

    Attributes:
        robot: Which of the robots.
        what: One of `COMMANDS`, or `REAL_TIME_FACTOR`.
        value: That factor; 0 otherwise.
    """

    robot: int
    what: str
    value: float = 0.0
