"""A page that shows robots as they move; who has their samples draws it, at his own pace."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.view.drag_targets import Reach
from mbd_ros.view.follower import Follower
from mbd_ros.view.ground import Ground
from mbd_ros.view.live_curves import LiveSample
from mbd_ros.view.live_panel import LivePanel, Wish
from mbd_ros.view.live_robot import LiveRobot
from mbd_ros.view.pull import Pull, Pulled
from mbd_ros.view.server import PageServer

_PLOTTED = 6  # frames for one of curves and texts
_APART = 1.5  # sizes between robots that would stand in each other


class LivePage:
    """Robots in browsers; one thread draws, callbacks of the page only leave wishes.

    Args:
        server: The server.
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
