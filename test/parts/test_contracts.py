"""What every registered part must keep to, found through the registry."""

import inspect
from pathlib import Path

import numpy as np
import pytest
from places import ROOT
from standing_plan import standing

from mbd_ros.core.contracts import Actuator, Load, Part, Sensor
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.rows.constraint import Constraint, Level
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError
from mbd_ros.methods.control.contract import ControlledJoints, Controller
from mbd_ros.methods.estimation.process import Estimator, LinearProcess
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.contact_entries import with_shapes
from mbd_ros.scene.reading.learned_entries import with_files
from mbd_ros.scene.reading.path_entries import with_paths
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.code_permission import permitting
from mbd_ros.scene.schema.registry import METHODS, PARTS, resolve

LEG = (ROOT / "config/robots/prosthetic_leg.urdf").read_text(encoding="utf-8")
NAMES = [(section, name) for section, names in PARTS.items() for name in names]
CONTRACTS = {
    "actuators": Actuator,
    "constraints": Constraint,
    "contacts": Part,
    "controllers": Controller,
    "estimators": Estimator,
    "forces": Load,
    "muscles": Muscle,
    "integrators": Integrator,
    "sensors": Sensor,
    "stabilization": Stabilization,
}
OF_A_ROBOT = ("actuators", "constraints", "contacts", "forces", "muscles", "sensors")
FIRST = {**dict.fromkeys(OF_A_ROBOT, "robot"), "controllers": "joints", "estimators": "process"}
every_part = pytest.mark.parametrize(("section", "name"), NAMES)
every_part_of_a_robot = pytest.mark.parametrize(
    ("section", "name"), [pair for pair in NAMES if pair[0] in OF_A_ROBOT]
)


@pytest.fixture(scope="module")
def robot():
    return read_robot(LEG)


@pytest.fixture(params=[0.0, 0.4])
def moment(request, robot):
    """Data as a part finds it, and a state."""
    k, rng = Kinematics(robot), np.random.default_rng(0)
    x = State(request.param, *rng.normal(size=(2, robot.model.nv)))
    k.refresh(x.q, x.v)
    return k, x


def context(section, robot):
    """What a part is given besides its entry."""
    if section == "controllers":
        return (controlled(robot),)
    if section == "estimators":
        return (LinearProcess(*np.eye(2)[None].repeat(4, axis=0)),)
    return (robot,) if section in OF_A_ROBOT else ()


def controlled(robot):
    system = build_system(robot, Couplings(robot, {}), (), Loads(robot.model.nv))
    return ControlledJoints(system, [joint.name for joint in robot.joints])


def built(section, name, robot):
    part = resolve(section, name, "here")
    plans = dict.fromkeys(getattr(part, "files", ()), standing([j.name for j in robot.joints]))
    return called(section, part, {**part.example, **plans}, f"{section}.{name}", robot)


def called(section, part, entry, where, robot):
    """A part as a scene calls it, which builds the paths of its entry first."""
    if section in OF_A_ROBOT:
        entry = with_paths(part, entry, where, robot, {})
    if part.__name__ == "LearnedTorque":
        entry = with_files(part, entry, where, Path())
    if section == "contacts":
        entry = with_shapes(Site(None, Origin(), robot, {}), entry, where)
    return schema.call(part, dict(entry), where, *context(section, robot))


def with_states(part, x):
    """The state with internal states of the part inside their bounds."""
    lower, upper = ([np.clip(one[i], -1.0, 1.0) for one in part.internal] for i in (2, 3))
    return x._replace(z=np.random.default_rng(2).uniform(lower, upper))


def test_every_section_of_the_registry_has_a_contract():
    assert set(METHODS) == set(PARTS) == set(CONTRACTS)
    assert NAMES


@every_part
def test_part_lives_in_a_file_of_its_name_in_the_folder_of_its_section(section, name):
    part = resolve(section, name, "here")
    assert part.__module__ == f"mbd_ros.parts.{section}.{name}"
    assert part.__name__ in (
        "".join(word.capitalize() for word in name.split("_")),
        "NoStabilization",
    )
    assert issubclass(part, CONTRACTS[section])


@every_part
def test_constructor_takes_documented_keywords_only(section, name):
    part = resolve(section, name, "here")
    parameters = list(inspect.signature(part).parameters.values())
    if section in FIRST:
        assert parameters.pop(0).name == FIRST[section]
    assert all(p.kind is p.KEYWORD_ONLY for p in parameters)
    assert all(p.annotation is not p.empty for p in parameters)
    assert all(f"{p.name}: " in part.__doc__ for p in parameters)


@every_part
def test_example_builds_and_a_typo_in_it_is_named(section, name, robot):
    assert built(section, name, robot)
    part = resolve(section, name, "here")
    for key in (*part.example, "nosuch"):
        typo = {**part.example, f"{key}_": 1.0}
        with pytest.raises(SceneError, match=rf"here: unknown key '{key}_', accepted: "):
            called(section, part, typo, "here", robot)


@every_part
def test_a_value_of_a_wrong_kind_is_named(section, name, robot):
    part = resolve(section, name, "here")
    for key in part.example:
        wrong = {**part.example, key: [{"x": "y"}]}
        with pytest.raises(SceneError, match=rf"here\.{key}(\[0\])?: expected .*, got .*"):
            called(section, part, wrong, "here", robot)


@every_part_of_a_robot
def test_unknown_names_are_answered_with_those_that_exist(section, name, robot):
    part = resolve(section, name, "here")
    for key, value in part.example.items():
        if key in ("joint", "joints", "parent"):
            wrong = {**part.example, key: "nose" if isinstance(value, str) else ["nose"]}
            with pytest.raises(SceneError, match="here: no joint 'nose'; the robot has hip_flex"):
                called(section, part, wrong, "here", robot)
        elif key in ("frame", "frame_a", "frame_b", "plane_frame"):
            wrong = {**part.example, key: "nose"}
            with pytest.raises(SceneError, match="here: no frame 'nose'; the links are"):
                called(section, part, wrong, "here", robot)


@pytest.mark.parametrize("name", PARTS["forces"])
def test_force_is_fresh_finite_and_changes_nothing(name, robot, moment):
    part, (k, x) = built("forces", name, robot), moment
    x, u = with_states(part, x), np.linspace(0.5, 1.0, len(part.inputs))
    check_value(lambda: part.force(k, x, u), (robot.model.nv,), x)
    assert x.t == 0.0 or part.force(k, x, u).any()
    assert np.isfinite(part.potential(k, x))


@pytest.mark.parametrize("name", PARTS["actuators"])
def test_torque_is_fresh_finite_and_changes_nothing(name, robot, moment):
    part, (k, x) = built("actuators", name, robot), moment
    x = with_states(part, x)
    u = np.linspace(0.5, 1.0, len(part.inputs))
    check_value(lambda: part.force(k, x, u), (robot.model.nv,), x)
    assert part.force(k, x, u).any()
    driven = [robot.joint(joint).v for joint in part.joints]
    assert not np.delete(part.force(k, x, u), driven).any()
    assert (part.armature() >= 0.0).all()
    assert part.command(np.ones(len(part.joints)), x).shape == (len(part.inputs),)
    assert all(one.unit and one.lower < one.safe < one.upper for one in part.inputs)
    if part.internal:
        check_value(lambda: part.rates(k, x, u), (len(part.internal),), x)
        assert all(one.lower < one.upper for one in part.internal)
    columns = part.columns(k, x)
    assert columns is None or columns.shape == (robot.model.nv, len(part.inputs))


@pytest.mark.parametrize("name", PARTS["constraints"])
def test_rows_are_finite_consistent_in_size_and_named(name, robot, moment):
    part, (k, x) = built("constraints", name, robot), moment
    m, before = len(part.rows), (x.q.copy(), x.v.copy())
    assert part.drift(k, x).shape == part.rate(k, x).shape == (m,)
    assert part.jacobian(k, x).shape == (m, robot.model.nv)
    assert part.slips or np.array_equal(part.pushes(k, x), part.jacobian(k, x))
    values = [part.drift, part.jacobian]
    if part.level is Level.POSITION:
        assert part.residual(k, x).shape == (m,)
        values.append(part.residual)
    assert all(np.isfinite(value(k, x)).all() for value in values)
    assert part.jacobian(k, x).any()
    assert len({row.name for row in part.rows}) == m
    assert all(row.name and row.unit in ("N", "N·m") for row in part.rows)
    for wrench in part.wrenches(k, x, np.ones(m)):
        assert robot.frame(wrench.frame) >= 0
        assert np.isfinite([*wrench.point, *wrench.force, *wrench.torque]).all()
    assert np.all(np.less(np.broadcast_to(part.law.lower, m), part.law.upper))
    assert np.array_equal(x.q, before[0])
    assert np.array_equal(x.v, before[1])


def check_value(call, shape, x):
    before = x.q.copy(), x.v.copy()
    first, second = call(), call()
    assert first.shape == shape
    assert np.isfinite(first).all()
    assert np.array_equal(first, second)
    assert first is not second
    first[:] = 7.0
    assert np.array_equal(call(), second)
    assert np.array_equal(x.q, before[0])
    assert np.array_equal(x.v, before[1])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "joint_sprong",
            "here: unknown type 'joint_sprong', accepted: applied_wrench, cable, gear",
        ),
        ("", "here: unknown type ''"),
        (":Spring", "here: unknown type ':Spring'"),
        ("my_parts:", "here: unknown type 'my_parts:'"),
        (".my_parts:Spring", "here: unknown type '.my_parts:Spring'"),
        ("my/parts:Spring", "here: unknown type 'my/parts:Spring'"),
        ("no_such_module:Spring", "type 'no_such_module:Spring': No module named"),
        ("json:Spring", "type 'json:Spring': module 'json' has no attribute 'Spring'"),
        ("os:system", "type 'os:system' is not a class with a method 'force'"),
        ("builtins:int", "type 'builtins:int' is not a class with a method 'force'"),
        ("math:pi", "type 'math:pi' is not a class with a method 'force'"),
    ],
)
def test_type_that_is_no_part_is_named_with_those_that_exist(name, message):
    with permitting(True), pytest.raises(SceneError) as caught:
        resolve("forces", name, "here")
    assert message in str(caught.value)
