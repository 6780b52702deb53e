"""Faults that may be named, as texts."""

from collections.abc import Sequence

from mbd_ros.core.dynamics.system import System
from mbd_ros.errors import MbdError
from mbd_ros.features.estimation.estimation import Estimation, made_ready
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.scene.built_scene import Scene

_FORM = "<name>: <part>.<argument>=<number>, .."


def hypothesis_systems(scene: Scene, found: Estimation, texts: Sequence[str]) -> dict[str, System]:
    """Name -> the mechanism with other numbers in it.

    Args:
        scene: As it is thought to be, as it is read.
        found: What is estimated of it.
        texts: Of the parameter `hypotheses`.

    Raises:
        ParameterError: A text of another form, or a number that the scene does not have.
    """
    systems = {}
    for text in texts:
        name, _, given = text.partition(":")
        if not name.strip() or not given.strip():
            raise ParameterError(f"hypotheses: '{text}', accepted: {_FORM}")
        try:
            changed = scene.with_(_numbers(text, given))
            systems[name.strip()] = made_ready(changed, found.task, found.disturbed).system()
        except MbdError as error:
            raise ParameterError(f"hypotheses: '{text}': {error}") from error
    return systems


def _numbers(text: str, given: str) -> dict[str, float]:
    numbers = {}
    for one in given.split(","):
        key, _, value = one.partition("=")
        try:
            numbers[key.strip()] = float(value)
        except ValueError as error:
            raise ParameterError(f"hypotheses: '{text}', accepted: {_FORM}") from error
    return numbers
