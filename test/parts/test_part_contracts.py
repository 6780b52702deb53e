"""What every part keeps to in a scene, registered or of another package."""

import inspect
import sys
import typing
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import parts_of_pages
import pinocchio as pin
import pytest
from part_contracts import (
    NAMED,
    OF_A_ROBOT,
    OUTSIDE,
    arguments,
    kind_of,
    moments,
    part_in,
    parts_in_section,
    refreshed,
)
from standing_plan import standing

import mbd_ros as mbd
from mbd_ros.api import load_scene
from mbd_ros.core.contracts import Part
from mbd_ros.core.loads.inputs import Sampled
from mbd_ros.core.ranges import described
from mbd_ros.core.rows.constraint import Kind, Level
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError
from mbd_ros.methods.control.contract import EffortBox, Reference
from mbd_ros.scene.describe.check import part_lines
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.contact_entries import with_shapes
from mbd_ros.scene.reading.learned_entries import with_files
from mbd_ros.scene.reading.path_entries import with_paths
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.code_permission import permitting
from mbd_ros.scene.schema.registry import PARTS
from mbd_ros.scene.schema.schema import entries


def has_rows(section, name):
    return section == "constraints" or (section, name) == ("contacts", "rigid")


EVERY = [(section, name) for section in PARTS for name in PARTS[section]]
EVERY += [(section, name) for section in OUTSIDE for name in OUTSIDE[section]]
every_part = pytest.mark.parametrize(("section", "name"), EVERY)
every_load = pytest.mark.parametrize(
    ("section", "name"), [pair for pair in EVERY if pair[0] in ("actuators", "forces", "muscles")]
)
every_constraint = pytest.mark.parametrize(
    ("section", "name"), [pair for pair in EVERY if has_rows(*pair)]
)
every_part_with_symbols = pytest.mark.parametrize(
    ("section", "name"), [pair for pair in EVERY if pair[0] in OF_A_ROBOT]
)
IN_NUMBERS = {  # what bodies or the cheap margins of stops are bound to while building
    *("xyz", "point", "point_a", "point_b", "plane_point", "position", "normal", "direction"),
    *("rpy", "rpy_a", "rpy_b", "orientation", "lower", "upper"),
    *("pennation_angle", "maximum_pennation_angle", "passive_strain", "passive_zero_strain"),
}


scene_from = partial(mbd.scene_from, allow_code=True)


@pytest.fixture(scope="module", autouse=True)
def modules(tmp_path_factory):
    """The parts of the pages, in a folder on the path."""
    folder = tmp_path_factory.mktemp("outside")
    parts_of_pages.write(folder)
    sys.path.insert(0, str(folder))
    with permitting(True):
        yield folder
    sys.path.remove(str(folder))
    for name in parts_of_pages.MODULES:
        sys.modules.pop(name, None)


def scene_with(section, name, base="fixed"):
    """The leg with one part; methods, which are no parts of a list, beside a constraint."""
    entry = {"type": name, **arguments(section, name)}
    if section in OF_A_ROBOT:
        held = {"here": entry} if section in NAMED else [entry]
        return scene_from({"robot": {"base": base}, section: held}, urdf="prosthetic_leg")
    key = {"integrators": "integrator"}.get(section, section)
    return scene_from({key: entry}, urdf="prosthetic_leg")


class Symbol:
    """Stands for a number that is not known: it has neither a value nor a sign."""

    def _made(self, *other):
        return Symbol()

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = _made
    __truediv__ = __rtruediv__ = __pow__ = __neg__ = _made
    __lt__ = __le__ = __gt__ = __ge__ = _made

    def __bool__(self):
        raise TypeError("a symbol is neither true nor false")


def symbolic(hint):
    """A symbol for a number, three for a vector; None for tables, coefficients and words."""
    kind, length = described(hint).kind, described(hint).length
    if kind is float:
        return Symbol()
    if kind == Mapping[str, float]:
        return {"ankle": Symbol()}
    return [Symbol() for _ in range(length)] if length and kind == Sequence[float] else None


@every_part_with_symbols
def test_constructor_stores_and_derives_so_that_it_takes_symbols(section, name):
    part = kind_of(section, name)
    hints = typing.get_type_hints(part.__init__, include_extras=True)
    symbols = {key: symbolic(hint) for key, hint in hints.items() if key not in IN_NUMBERS}
    given = {key: symbol for key, symbol in symbols.items() if symbol is not None}
    without = ("prescribed_torque", "frame_anchor", "knife_edge", "loop_closure", "point_on_plane")
    assert bool(given) != (name in without)  # which have a table or places alone
    robot = scene_from(urdf="prosthetic_leg").robot
    entry = with_paths(part, arguments(section, name), name, robot, {})
    if section == "contacts":
        entry = with_shapes(Site(None, Origin(), robot, {}), entry, name)
    entry = with_files(part, entry, name, Path())
    assert isinstance(part(robot, **{**entry, **given}), Part)


@every_part_with_symbols
def test_numbers_have_units_and_vectors_a_length(section, name):
    part = kind_of(section, name)
    hints = typing.get_type_hints(part.__init__, include_extras=True)
    texts = entries(part.__doc__)
    for key in list(inspect.signature(part).parameters)[1:]:
        kind, _, unit, length = described(hints[key])
        if "float" in str(kind):
            assert unit, f"{name}.{key}"
            assert f"[{unit}]" not in texts[key], "stands in the annotation"
        assert length == 3 or key not in ("point", "force", "torque") or kind != Sequence[float]


@pytest.mark.parametrize(("section", "name"), [pair for pair in EVERY if pair[0] in OF_A_ROBOT])
def test_part_has_a_name_which_check_says_with_its_units(section, name):
    scene = scene_with(section, name)
    part, ((_, line), *_) = part_in(scene), part_lines(scene)
    assert part.name and "." not in part.name and f" {part.name}, " in f" {line}"
    units = [channel.unit for channel in part.inputs]
    units += [row.unit for row in getattr(part, "rows", ())]
    assert all(units) and (units or section in ("forces", "contacts", "sensors"))
    assert all(c.lower <= c.safe <= c.upper and c.lower < c.upper for c in part.inputs)
    assert scene.inputs.names == tuple(
        ".".join(filter(None, (part.name, channel.name))) for channel in part.inputs
    )


@pytest.mark.parametrize("base", ["fixed", "floating"])
@every_load
def test_columns_are_the_slopes_of_the_force(section, name, base):
    """force(u) = force(0) + columns u within the bounds; shapes are those of the robot."""
    scene, rng = scene_with(section, name, base), np.random.default_rng(1)
    part, nv, n = part_in(scene), scene.robot.model.nv, len(scene.inputs.channels)
    lower, upper = (np.clip([c[i] for c in part.inputs], -9.0, 9.0) for i in (2, 3))
    for k, x in moments(scene):
        u, columns = rng.uniform(lower, upper), part.columns(k, x)
        assert part.force(k, x, u).shape == (nv,)
        assert np.isfinite(part.potential(k, x))
        if columns is not None:
            assert columns.shape == (nv, n)
            expected = part.force(k, x, np.zeros(n)) + columns @ u
            np.testing.assert_allclose(part.force(k, x, u), expected, rtol=1e-13, atol=1e-12)
    assert n > 0 or section != "actuators"


@every_load
def test_rates_stand_where_their_states_do(section, name):
    """One finite rate a state, by name, at values inside their bounds; others have none."""
    scene = scene_with(section, name)
    part, u = part_in(scene), scene.inputs.safe
    names = tuple(".".join(filter(None, (part.name, one.name))) for one in part.internal)
    assert scene.internals.names == names and scene.internals.nz == len(part.internal)
    for k, x in moments(scene):
        if names:
            assert part.rates(k, x, u).shape == (len(names),)
        assert np.isfinite(scene.internals.rates(k, x, u)).all()
        assert all(one.lower < one.upper for one in part.internal)


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("name", [name for section, name in EVERY if section == "forces"])
def test_force_does_the_work_that_its_potential_loses(name, base):
    """Where a force at rest has a potential, their power is the same: -dE/dt = v . force."""
    scene = scene_with("forces", name, base)
    part, model = part_in(scene), scene.robot.model
    for k, x in moments(scene):
        still, v = x._replace(v=0.0 * x.v), x.v
        power = v @ part.force(*refreshed(k, still), scene.inputs.safe)
        ends = [
            part.potential(*refreshed(k, still._replace(q=pin.integrate(model, x.q, h * v))))
            for h in (-1e-5, 1e-5)
        ]
        if any(ends):
            assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(power, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("base", ["fixed", "floating"])
@every_constraint
def test_rows_are_the_derivatives_of_one_another(section, name, base):
    """J v + rate = dg/dt and drift = dg'/dt along motions without joint acceleration."""
    scene, h = scene_with(section, name, base), 1e-6
    part, model = part_in(scene), scene.robot.model

    def at(k, x, shift):
        q = pin.integrate(model, x.q, shift * x.v)
        k, x = refreshed(k, State(x.t + shift, q, x.v))
        rates = part.jacobian(k, x) @ x.v + part.rate(k, x)
        has_residual = part.level is Level.POSITION
        g = part.residual(k, x) if has_residual else np.zeros(len(part.rows))
        return np.array([g, rates, part.drift(k, x)])

    for k, x in moments(scene):
        before, now, after = (at(k, x, shift) for shift in (-h, 0.0, h))
        slopes = (after - before) / (2.0 * h)
        size = 1.0 + np.abs(now[1:])
        if part.level is Level.POSITION:
            with_g = slice(1) if part.law.kind is Kind.CONE else slice(None)  # tangents have none
            assert (np.abs(slopes[0] - now[1]) / size[0])[with_g].max() < 1e-7
        assert (np.abs(slopes[1] - now[2]) / size[1]).max() < 1e-7
        refreshed(k, x)
        jacobian, drift = part.accelerations(k, x)
        np.testing.assert_allclose(jacobian, part.jacobian(k, x), rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(drift, part.drift(k, x), rtol=1e-12, atol=1e-13)
        assert part.pushes(k, x).shape == jacobian.shape == (len(part.rows), model.nv)


@pytest.mark.parametrize("name", [name for section, name in EVERY if section == "controllers"])
def test_control_is_finite_of_the_right_shape_and_changes_nothing(name):
    motors = {"type": "ideal", "joints": ["hip_flexion", "knee", "ankle"]}
    scene = scene_from({"actuators": [motors]}, urdf="prosthetic_leg")
    joints, (_, x) = scene.controlled_joints(), next(moments(scene))
    kind, given = kind_of("controllers", name), arguments("controllers", name)
    given |= {key: standing(joints.names) for key in kind.files}
    part = schema.call(kind, given, name, joints)
    n, memory = len(joints), part.begin()
    ref, box = Reference(*np.ones((3, n))), EffortBox(np.full(n, -1e6), np.full(n, 1e6))
    before = [values.copy() for values in (x.q, x.v, *ref, memory, *box)]
    first, second = (part.effort(x, ref, memory, box) for _ in range(2))
    assert first.effort.shape == first.s.shape == first.equivalent.shape == (n,)
    assert first.memory_rate.shape == memory.shape
    assert first.active.shape == (len(part.limit_names),) and first.active.dtype == bool
    assert all(np.isfinite(values).all() for values in first)
    assert first.effort.any() and first.effort is not second.effort
    for now, values in zip((x.q, x.v, *ref, memory, *box), before, strict=True):
        assert np.array_equal(now, values)


def varied(section, name):
    """Every number of a part, a little larger; for lengths of bars and the like near enough."""
    hints = typing.get_type_hints(kind_of(section, name).__init__, include_extras=True)
    for key, given in arguments(section, name).items():
        kind, within, *_ = described(hints[key])
        if isinstance(given, float) and kind is not int:
            other = 1.01 * given + 1e-3
            yield key, min(other, within.high) if within else other


@every_part
def test_other_numbers_are_those_of_a_scene_built_anew(section, name):
    """The same bits in every number that the part has, and in the motion."""
    if section in ("controllers", "estimators"):
        return  # belong to nodes and tasks, where a gain builds them anew
    scene = scene_with(section, name)
    called = part_in(scene).name if section in OF_A_ROBOT else next(iter(scene.entries))
    called = {"integrators": "integrator"}.get(section, called)
    for key, number in varied(section, name):
        changed = scene.with_({f"{called}.{key}": number})
        anew = scene_from(changed.entries)
        assert changed.entries != scene.entries
        assert ran(changed) == ran(anew)


def ran(scene):
    """What a short motion leads to, and every constant of the parts."""
    u = np.full(len(scene.inputs.channels), 0.3)
    sources = {part.name: Sampled(lambda t: u, 1.0) for part in scene.actuators}
    motion = list(scene.simulation(dt=1e-3, sources=sources).run(scene.initial, 0.003))
    parts = [part for key in OF_A_ROBOT for part in parts_in_section(scene, key)]
    forces = [part.force(*next(moments(scene)), u).tobytes() for part in scene.forces]
    names = [part.name for part in parts]
    armature = scene.robot.model.armature.tobytes()
    return [x.q.tobytes() + x.v.tobytes() for x in motion], forces, names, armature, scene.inputs


def test_check_finds_the_parts_of_others_once_code_is_allowed(modules, tmp_path, capsys):
    of_a_robot = [key for key in OF_A_ROBOT if key in OUTSIDE]
    lists = {key: [{"type": t, **a} for t, a in OUTSIDE[key].items()] for key in of_a_robot}
    robot = {"urdf": "package://mbd_ros/config/robots/prosthetic_leg.urdf"}
    path = tmp_path / "scene.yaml"
    path.write_text(str({"robot": robot, **lists}).replace("'", '"'), encoding="utf-8")
    names = [name for key in of_a_robot for name in OUTSIDE[key]]
    with pytest.raises(SceneError, match="code of others") as caught:
        load_scene(path)
    assert all(name in str(caught.value) for name in names)
    said = load_scene(path, allow_code=True).check()
    for name in names:
        module = name.partition(":")[0]
        assert name in said and str(modules / f"{module}.py") in said
