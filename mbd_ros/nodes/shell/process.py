"""The process of a node: starts it, drives its callbacks, ends it on a signal or a crash."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from mbd_ros.errors import BAD_INPUT
from mbd_ros.nodes.shell.parameters import PARAMETERS, Parameter
from mbd_ros.nodes.shell.params_file import meaning, parameter_files
from mbd_ros.nodes.shell.serialized import LARGEST
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.regular_file import check_regular

_HELP = ("-h", "--help")
_REFUSALS = (
    rclpy_implementation.RCLError,
    rclpy_implementation.UnknownROSArgsError,
    ParameterException,
)
_PROFILES = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "RMW_FASTRTPS_USE_QOS_FROM_XML",
)
_M_MMAP_THRESHOLD = -3  # of malloc.h: what is larger goes back to the system when it is freed
PATIENCE = 0.1  # [s] that a signal waits at most: an executor does not wake up for one


def run(node_class: type[Shell], argv: Sequence[str] | None = None) -> int:
    """Main of a node.

    Args:
        argv: Command line with program name; default `sys.argv`.

    Returns:
        Exit code 0 after SIGINT or SIGTERM, and after the text for --help.

    Raises:
        SystemExit: An unknown argument, a command line or parameter file that rcl refuses.
        Exception: Whatever a callback raised that is not an MbdError.
    """
    arguments = list(sys.argv if argv is None else argv)
    _check_parameter_files(node_class.NAME, arguments)
    with _refused(node_class.NAME):
        wants_help = asks_for_help(arguments, node_class.NAME)
    if wants_help:
        sys.stdout.write(usage(node_class.NAME, node_class.PARAMETERS + PARAMETERS))
        return 0
    stop = _StopSignal()
    np.seterr(over="ignore", invalid="ignore")  # results are checked; nobody reads such warnings
    try:
        _run(node_class, arguments, stop)
    finally:
        stop.ignore()
        gc.unfreeze()  # what configuring froze would outlive the libraries that count it
    return 0


def _run(node_class: type[Shell], arguments: list[str], stop: _StopSignal) -> None:
    _free_messages()
    with _refused(node_class.NAME):
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = node_class(arguments)
    with _closing(node), _driven(node) as executor:
        node.try_start()
        while not stop.name:
            node.raise_crash()
            node.drive(executor, PATIENCE)


def _check_parameter_files(name: str, arguments: Sequence[str]) -> None:
    """End the process where rcl would wait for a parameter file for ever."""
    for file in parameter_files(arguments):
        try:
            check_regular(file)
        except OSError as error:
            sys.stderr.write(f"{name}: --params-file {file}: cannot be read ({error.strerror})\n")
            raise SystemExit(BAD_INPUT) from error


def _free_messages() -> None:
    """Let Fast DDS free the memory of messages, unless the user has profiles of his own.

    What is larger than a node reads then goes back to the system at once.
    """
    if not any(name in os.environ for name in _PROFILES):
        os.environ[_PROFILES[0]] = str(Path(__file__).with_name("message_memory.xml"))
        os.environ[_PROFILES[-1]] = "1"
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):  # glibc
        libc.mallopt(_M_MMAP_THRESHOLD, LARGEST)


@contextmanager
def _refused(name: str) -> Iterator[None]:
    """End the process with the reason for which ROS refuses a command line."""
    try:
        yield
    except _REFUSALS as error:
        rclpy.try_shutdown()
        unknown = isinstance(error, rclpy_implementation.UnknownROSArgsError)
        what = f"unknown after --ros-args: {error}" if unknown else error
        raise SystemExit(f"{name}: {what}") from error


@contextmanager
def _closing(node: Shell) -> Iterator[None]:
    try:
        yield
    finally:
        try:
            node.close(sys.exc_info()[1])
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


@contextmanager
def _driven(node: Shell) -> Iterator[Executor]:
    events = node.parameters.executor != "single_threaded"
    executor = EventsExecutor() if events else SingleThreadedExecutor()
    executor.add_node(node)
    try:
        yield executor
    finally:
        executor.remove_node(node)


def asks_for_help(arguments: Sequence[str], name: str) -> bool:
    """Whether somebody wants to read the usage.

    Args:
        arguments: Command line with program name.

    Raises:
        SystemExit: 2 after naming a word that is neither ROS's nor a wish for help.
        RCLError: A command line or parameter file that rcl refuses.
    """
    words = remove_ros_args(list(arguments))[1:]
    if any(word in _HELP for word in words):
        return True
    if words:
        sys.stderr.write(
            f"{name}: unknown argument '{words[0]}'; accepted: --help, and after --ros-args what "
            f"ROS takes: -p scene:=SCENE, --params-file FILE, -r FROM:=TO\n"
        )
        raise SystemExit(BAD_INPUT)
    return False


def usage(name: str, parameters: Sequence[Parameter]) -> str:
    """Text for --help: how to start the node, and every parameter with its default."""
    lines = [
        f"usage: ros2 run mbd_ros {name} --ros-args -p scene:=SCENE [-p NAME:=VALUE] "
        "[--params-file FILE] [-r FROM:=TO]",
        "",
        "parameters:",
    ]
    for parameter in parameters:
        default = parameter.default
        shown = list(default) if isinstance(default, tuple) else default
        given = "required" if default is None else f"default {str(shown).replace('True', 'true')}"
        lines.append(f"  {parameter.name} ({given.replace('False', 'false')})")
        lines += textwrap.wrap(
            meaning(parameter), 92, initial_indent=" " * 6, subsequent_indent=" " * 6
        )
    return "\n".join(lines) + "\n"


class _StopSignal:
    """Remembers SIGINT and SIGTERM; launch and terminals send two, the second is no news."""

    def __init__(self) -> None:
        self.name = ""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._remember)

    def ignore(self) -> None:
        """From now on no signal matters: the interpreter would take it for the default and die."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        self.name = signal.Signals(number).name
