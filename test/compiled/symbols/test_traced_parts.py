"""Every registered part, asked with symbols: the numbers of the part, or why there are none."""

from functools import partial

import numpy as np
import pytest
from part_contracts import NAMED, OF_A_ROBOT, arguments, moments, part_in
from symbolic_numbers import Symbols

from mbd_ros.compiled.symbols.trace import trace
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contracts import Load, Measures, Now, Sensor
from mbd_ros.core.rows.constraint import Constraint, Level
from mbd_ros.scene.from_python import scene_from
from mbd_ros.scene.schema.registry import PARTS

EXACT = 1e-13  # of the largest entry, or of 1 where that is a difference of larger ones
REFUSED = {  # part -> why
    ("contacts", "compliant"): "a number that depends on the state",
    ("forces", "learned_torque"): "needs the value of a number",
    ("forces", "switching_force"): "a number that depends on the state",
}
SMOOTHED = {
    "dry_friction": {"smoothed": True},
    "joint_stop": {"smoothed": True, "restitution": 0.0},
    "prescribed_motion": {"smoothed": True},
    "rope": {"smoothed": True, "restitution": 0.0},
}
ALL = [(section, name) for section in OF_A_ROBOT for name in PARTS[section]]
IN_NUMBERS = {("sensors", "pose")}  # a rotation has its vector by branches
TRACED = [pair for pair in ALL if pair not in REFUSED and pair not in IN_NUMBERS]


def other(value, factor):
    """The numbers of an argument, all times one factor; whole ones and words stay."""
    if isinstance(value, dict):
        return {key: other(one, factor) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [other(one, factor) for one in value]
    return factor * value if isinstance(value, float) else value


def scene_with(section, name, base, rng, **more):
    """The leg, free or not, with one part of random numbers."""
    given = arguments(section, name).items()
    entry = {key: other(value, rng.uniform(0.7, 1.0)) for key, value in given}
    one = {"type": name, **entry, **more}
    parts = {section: {"here": one} if section in NAMED else [one]}
    return scene_from({"robot": {"base": base}, **parts}, urdf="prosthetic_leg")


def methods_of(part, nv):
    """What an equation of motion, or an estimate, asks of a part."""
    if isinstance(part, Sensor):
        now = Now(np.zeros(nv), np.zeros(0), np.ones((nv, 6)))
        yield partial(part.measure, now=now)
        if part.level < Measures.FORCE:
            yield part.jacobian
    if isinstance(part, Constraint):
        yield from (part.jacobian, part.drift, part.rate, part.pushes)
        yield lambda k, x: np.vstack([part.accelerations(k, x)[0].T, part.accelerations(k, x)[1]])
        if part.level is Level.POSITION:
            yield part.residual


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize(("section", "name"), TRACED)
def test_a_part_of_symbols_has_the_numbers_of_the_part(section, name, base):
    for seed in range(2):
        rng = np.random.default_rng([11, seed])
        scene = scene_with(section, name, base, rng)
        part = part_in(scene)
        nu = len(scene.inputs.channels)
        symbols, u = Symbols(scene.robot, scene.internals.nz, nu), rng.normal(size=nu)
        asked = [(method, ()) for method in methods_of(part, scene.robot.model.nv)]
        if isinstance(part, Load):
            asked = [(part.force, (symbols.u,)), (part.potential, ())]
            asked += [(part.rates, (symbols.u,))] if part.internal else []
        with tracing(part):
            expressions = [method(symbols.k, symbols.x, *given) for method, given in asked]
        for k, x in moments(scene, 3):
            for expression, (method, given) in zip(expressions, asked, strict=True):
                expected = np.asarray(method(k, x, *[u for _ in given]), dtype=float)
                found = symbols.number(expression, x, u).reshape(expected.shape)
                size = max(1.0, np.abs(expected).max(initial=0.0))
                assert np.abs(found - expected).max(initial=0.0) <= EXACT * size, method


@pytest.mark.parametrize("pair", REFUSED)
def test_a_part_without_a_form_is_named_with_its_reason(pair):
    scene = scene_with(*pair, "floating", np.random.default_rng(4))
    name = scene.parts[pair[0]][0].name
    system = scene.system()
    mode = None if system.event_rows else ()
    with pytest.raises(Untraceable, match=f"{name}.*{REFUSED[pair]}"):
        trace(system, mode=mode).function("accelerate")


@pytest.mark.parametrize("name", SMOOTHED)
def test_rows_that_are_smoothed_are_named_with_their_reason(name):
    scene = scene_with("constraints", name, "fixed", np.random.default_rng(4), **SMOOTHED[name])
    with pytest.raises(Untraceable, match=f"{scene.constraints[0].name}.*smoothed"):
        trace(scene.system()).function("accelerate")
