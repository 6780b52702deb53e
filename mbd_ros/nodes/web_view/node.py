"""Node `web_view`: a page that shows robots as their topics tell of them, and leads them."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.exceptions import InvalidTopicNameException
from rclpy.parameter import Parameter as ParameterParameter
from rclpy.validate_topic_name import validate_topic_name
from std_srvs.srv import SetBool, Trigger

from mbd_ros.core.state import Array
from mbd_ros.nodes.shell.parameters import ALLOW_CODE, Parameter, ParameterError
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.nodes.web_view.robot_topics import Leading, RobotTopics, within
from mbd_ros.scene.reader import load_scene
from mbd_ros.view.live import REAL_TIME_FACTOR, LivePage, Wish
from mbd_ros.view.live_robot import LiveRobot
from mbd_ros.view.server import PageServer
from msg_adapters.diagnostics import ERROR, OK, STALE, WARN, read_diagnostics

FASTEST = 30.0  # Hz, to browsers
PARAMETERS = (
    Parameter("scene", str, "Scene: a file, or the name of an embedded one."),
    ALLOW_CODE,
    Parameter(
        "namespaces",
        list[str],
        "Namespaces of the robots, one each; empty for one robot in that of the node.",
        (),
    ),
    Parameter(
        "scenes", list[str], "Scene of each robot, if they differ; empty: all have `scene`.", ()
    ),
    Parameter(
        "offsets",
        list[float],
        "x, y and z of the world of each robot on the page [m]; empty: robots of one scene stand "
        "side by side, others where their scenes place them.",
        (),
        low=-1e6,
        high=1e6,
    ),
    Parameter(
        "host",
        str,
        "Address to listen on; another one than this machine's asks for a token.",
        "127.0.0.1",
    ),
    Parameter(
        "port",
        int,
        "Port to listen on; the next one that is free where it is taken.",
        8080,
        low=1,
        high=65535,
    ),
    Parameter(
        "token",
        str,
        "What a browser must know; empty: nothing on this machine's address, and on another one "
        "what the node makes up and logs.",
        "",
    ),
    Parameter(
        "origins",
        list[str],
        "Addresses under which a proxy shows the page, such as https://robots.example.",
        (),
    ),
    Parameter(
        "rate",
        float,
        "Frames that browsers get a second at most [Hz].",
        FASTEST,
        low=0.1,
        high=FASTEST,
    ),
    Parameter("window", float, "Time that curves show [s].", 10.0, low=0.1, high=600.0),
    Parameter(
        "simulator", str, "Node whose buttons the page has, in each namespace.", "simulator"
    ),
    Parameter(
        "controller",
        str,
        "Node that is led by targets, in each namespace; empty: whichever hears a reference.",
        "",
    ),
    Parameter(
        "constraint_forces",
        str,
        "Topic of multipliers, in each namespace.",
        "simulator/constraint_forces",
    ),
    Parameter(
        "torques",
        str,
        "Topic of computed torques, in each namespace.",
        "inverse_dynamics/joint_torques",
    ),
    Parameter("markers", str, "Topic of markers, in each namespace.", "markers"),
)
_TRIGGERS = ("reset", "step")
_PAUSES = {"pause": True, "run": False}
_SILENT = 1.0  # s without joint states that are reported
_REPORTS = 50  # nodes whose diagnostics are shown
_LONGEST = 300  # characters of each
_REACHED = "real-time factor reached"  # in diagnostics of simulators
_LEVELS = {OK: "ok", WARN: "WARN", ERROR: "ERROR", STALE: "STALE"}


class WebViewNode(Shell):
    """Shows robots in browsers, at most 30 times a second, and hands on what people ask for."""

    NAME = "web_view"
    PARAMETERS = PARAMETERS
    _page: LivePage

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._description = RobotDescription(self, self.build, self.replace)
        self._robots: list[_Robot] = []
        self._reports: dict[str, str] = {}
        self._reached: dict[str, str] = {}
        self._frames = self._departures = 0

    def build(self, description: str | None) -> None:
        """Read the scenes and what is drawn of them."""
        values = self.parameters
        spaces = values.namespaces or ("",)
        _check_spaces(spaces)
        names = values.scenes or (values.scene,) * len(spaces)
        if len(names) != len(spaces):
            raise ParameterError(
                f"parameter 'scenes' has {len(names)} entries; accepted: one for each of the "
                f"{len(spaces)} namespaces, or none"
            )
        if len(values.offsets) not in (0, 3 * len(spaces)):
            raise ParameterError(
                f"parameter 'offsets' has {len(values.offsets)} numbers; accepted: x, y and z for "
                f"each of {len(spaces)} robots, or none"
            )
        scenes = {}
        for name in names:
            if name not in scenes:
                own = description if name == values.scene else None
                scenes[name] = load_scene(name, own)
        kept = max(2, round(values.window * values.rate))
        self._views = [
            LiveRobot(space, scenes[name], kept) for space, name in zip(spaces, names, strict=True)
        ]
        self._spaces = spaces

    def configure_core(self) -> None:
        """Build, open the page, and listen."""
        self._description.build()
        values = self.parameters
        label = Path(self._views[0].scene.name).name
        server = PageServer(values.host, values.port, label, values.token, values.origins)
        self.keep(server, PageServer.close)
        self._page = LivePage(server, self._views, label, self._offsets())
        self._departures = 0
        self._robots = [
            self._robot(space, view) for space, view in zip(self._spaces, self._views, strict=True)
        ]
        self.subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        is_given = bool(values.token)
        page = server.address if is_given else server.address_with_token
        self.get_logger().info(f"page: {page}")

    def replace(self, description: str) -> None:
        """Keep the robot; a page that shows another one is made by the next configuration."""
        load_scene(self.parameters.scene, description)  # says what is wrong with it
        self._description.urdf = description
        raise ParameterError("a page keeps its robot; clean up and configure to change it")

    def prepare(self, values: Any) -> None:
        """Listen for the robot of another scene."""
        self._description.follow(values)

    def activate_core(self) -> None:
        """Draw from now on."""
        self.every(1.0 / self.parameters.rate, self._draw)
        self.every(1.0, self._look)

    def deactivate_core(self) -> None:
        """Let everything go."""
        for robot in self._robots:
            robot.leading.let_go()

    def health(self) -> tuple[int, str, dict[str, str]]:
        """Whether the robots are heard, and how much is drawn."""
        silent = [line for line in map(_state, self._robots) if line]
        frames, self._frames = self._frames, 0
        details = {
            "page": self._page.server.address,
            "token": "asked for" if self._page.server.token else "none, this machine alone",
            "browsers": str(self._page.server.browsers),
            "frames in the last second": str(frames),
            "not drawn": "; ".join(line for robot in self._views for line in robot.remarks)
            or "none",
        }
        for robot in self._robots:
            title = f" of {robot.view.title}" if robot.view.title else ""
            details[f"messages heard a second{title}"] = f"{robot.topics.rate:.0f}"
        return (STALE if silent else OK), "; ".join(silent) or "shown", details

    def _robot(self, space: str, view: LiveRobot) -> _Robot:
        values, name = self.parameters, partial(within, space)
        tell = self._answer_of(view)
        topics = RobotTopics(self, space, view.scene, view.frames, values)
        view.measure(topics.loads)
        return _Robot(
            view,
            topics,
            SimulatorClient(self._ask_of, name(values.simulator), tell),
            Leading(self, name, view.scene, values, tell),
        )

    def _ask_of(self, kind: type, service: str) -> Any:
        """A client that ends with this configuration."""
        client = self.create_client(kind, service)
        self.keep(client, self.destroy_client)
        return client

    def _answer_of(self, view: LiveRobot) -> Callable[[str], None]:
        before = f"{view.title}: " if view.title else ""
        return lambda line: self._page.answer(f"{before}{line}")

    def _offsets(self) -> Array | None:
        given = self.parameters.offsets
        return np.array(given).reshape(-1, 3) if given else None

    def _draw(self) -> None:
        """A frame: what was heard, and what people did."""
        self._do_wishes()
        page = self._page
        if not page.server.browsers:
            self._let_go(None)
            return
        self._frames += page.draw([robot.topics.sample() for robot in self._robots])
        pulled = page.pulled()
        self._let_go(None if pulled is None else pulled.robot)
        if pulled is not None:
            robot = self._robots[pulled.robot]
            robot.leading.pull(pulled, robot.topics.k)
        reached = page.reached([robot.topics.q for robot in self._robots])
        if reached is not None:
            self._robots[reached[0]].leading.lead(reached[1])
        for robot in self._robots:
            robot.leading.tend()

    def _do_wishes(self) -> None:
        while (wish := self._page.take_wish()) is not None:
            self._robots[wish.robot].simulator.do(wish)

    def _let_go(self, kept_client: int | None) -> None:
        for number, robot in enumerate(self._robots):
            if number != kept_client:
                robot.leading.let_go()

    def _look(self) -> None:
        """Once a second: how robots and nodes are."""
        if self._departures != self._page.server.departures:
            self._departures = self._page.server.departures
            gc.collect()  # what a browser leaves are cycles, too few for a collection by itself
        for robot in self._robots:
            robot.topics.measure_rate()
        if self._page.server.browsers:
            lines = [_state(robot) or self._stream(robot) for robot in self._robots]
            self._page.report(lines, list(self._reports.values()))

    def _stream(self, robot: _Robot) -> str:
        """How fast a robot is heard, and how fast its simulation says that it is."""
        heard = f"{_title(robot)}{robot.topics.rate:.0f} messages heard a second"
        reached = self._reached.get(self.resolve_service_name(robot.simulator.name))
        return f"{heard}, real-time factor {reached}" if reached else heard

    def _on_diagnostics(self, msg: Any) -> None:
        for health in read_diagnostics(msg):
            if health.name in self._reports or len(self._reports) < _REPORTS:
                level = _LEVELS.get(health.level, str(health.level))
                self._reports[health.name] = f"{health.name}: {level} {health.message}"[:_LONGEST]
                self._reached[health.name] = health.values.get(_REACHED, "")[:_LONGEST]


class _Robot(NamedTuple):
    """One robot of the page."""

    view: LiveRobot
    topics: RobotTopics
    simulator: SimulatorClient
    leading: Leading


class SimulatorClient:
    """Calls the services of one simulator for the buttons of a page, and tells the answers.

    Args:
        ask_of: Makes a client of a service of that type and name.
        name: Of the simulator, relative or absolute.
        tell: Is told the answers.
    """

    def __init__(
        self, ask_of: Callable[[type, str], Any], name: str, tell: Callable[[str], None]
    ) -> None:
        self.name = name
        self._tell = tell
        self._clients = {what: ask_of(Trigger, f"{name}/{what}") for what in _TRIGGERS}
        self._pause = ask_of(SetBool, f"{name}/pause")
        self._parameters = ask_of(SetParameters, f"{name}/set_parameters")
        self._waiting: dict[Any, Any] = {}

    def do(self, wish: Wish) -> None:
        """Ask for what somebody wished for."""
        if wish.what in _PAUSES:
            self._ask(self._pause, SetBool.Request(data=_PAUSES[wish.what]), wish.what)
        elif wish.what == REAL_TIME_FACTOR:
            changed = ParameterParameter("real_time_factor", value=wish.value).to_parameter_msg()
            request = SetParameters.Request(parameters=[changed])
            self._ask(self._parameters, request, f"{wish.what} {wish.value:g}")
        else:
            self._ask(self._clients[wish.what], Trigger.Request(), wish.what)

    def _ask(self, client: Any, request: Any, what: str) -> None:
        """Ask; an older question to the same service is answered no more."""
        if client in self._waiting:
            client.remove_pending_request(self._waiting.pop(client))
        if not client.service_is_ready():
            self._tell(f"{what}: no {self.name} there")
            return
        self._tell(f"{what}: asked")
        self._waiting[client] = future = client.call_async(request)
        future.add_done_callback(partial(self._answered, client, what))

    def _answered(self, client: Any, what: str, future: Any) -> None:
        if self._waiting.get(client) is not future:
            return
        del self._waiting[client]
        answer = future.result()
        if hasattr(answer, "results"):
            refused = [result.reason for result in answer.results if not result.successful]
            self._tell(f"{what}: {refused[0] if refused else 'done'}")
        else:
            self._tell(f"{what}: {answer.message}")


def _check_spaces(spaces: Sequence[str]) -> None:
    if len(set(spaces)) != len(spaces):
        raise ParameterError("parameter 'namespaces' repeats one; accepted: each once")
    for space in spaces:
        try:
            validate_topic_name(within(space, "x"))
        except InvalidTopicNameException as error:
            raise ParameterError(
                f"parameter 'namespaces': '{space}' is no namespace: {error}"
            ) from error


def _state(robot: _Robot) -> str:
    """Return what is wrong with the stream of a robot; empty if nothing is."""
    age = robot.topics.age
    if age <= _SILENT:
        return ""
    since = "yet" if age == float("inf") else f"for {age:.1f} s"
    return f"{_title(robot)}no joint states {since}"


def _title(robot: _Robot) -> str:
    return f"{robot.view.title}: " if robot.view.title else ""
