"""Inverse dynamics of many motions, a result each: `mbd-ros inverse SCENE MOTION MOTION ..`."""

from collections.abc import Mapping
from typing import Any

from mbd_ros.features.inverse_dynamics.job import inverse_to
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.batch import Batch, Outcome, do_batch, do_one, task_of
from mbd_ros.motion.external_loads import refuse_unused
from mbd_ros.motion.stance import stance_of
from mbd_ros.scene.reader import load_scene


def inverse_batch(batch: Batch, say: Say) -> None:
    """Do all motions; the options are `parts`, `bounds`, `power` and those of the stance."""

    def check() -> None:
        refuse_unused(load_scene(batch.scene), batch.wrenches)

    do_batch(batch, _inverse, one, say, check)


def one(argument: Mapping[str, Any]) -> Outcome:
    """One motion, in a worker."""
    return do_one(argument, _inverse)


def _inverse(batch: Batch, say: Say) -> None:
    kinds = {name: batch.options[name] for name in ("parts", "bounds", "power")}
    stance = stance_of(*(batch.options[name] for name in ("stance", "stance_gap", "stance_speed")))
    task = task_of(batch)._replace(**kinds, stance=stance)
    inverse_to(load_scene(batch.scene), task, batch.out, say)
