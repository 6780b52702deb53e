"""Symbols as C: every operation, long functions, vectors of numbers."""

import casadi as ca
import numpy as np
import pytest

from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.c_function import CodeError
from mbd_ros.compiled.code.emit import emit


def every_operation():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    one = [ca.sqrt, ca.sin, ca.cos, ca.tan, ca.exp, ca.log, ca.asinh, ca.sinh, ca.cosh, ca.tanh]
    one += [ca.floor, ca.ceil, ca.fabs, ca.sign, ca.erf, ca.log1p, ca.expm1, ca.atan]
    of_one = [f(x) for f in one] + [f(0.1 * x) for f in (ca.asin, ca.acos, ca.atanh)]
    of_two = [f(x, y) for f in (ca.fmin, ca.fmax, ca.atan2, ca.fmod, ca.hypot, ca.remainder)]
    of_two += [f(x, y) for f in (ca.plus, ca.minus, ca.times, ca.rdivide, ca.copysign, ca.power)]
    asked = [x < y, x <= y, ca.eq(x, y), ca.ne(x, y), ca.logic_and(x, y), ca.logic_or(x, y)]
    asked += [
        ca.logic_not(x),
        ca.if_else(x < y, x, y),
        ca.acosh(1.0 + x),
        x**1.7,
        1 / x,
        -x,
        x + x,
    ]
    return ca.Function("every", [x, y], [ca.vertcat(*of_one, *of_two, *asked)])


@pytest.mark.parametrize("real", ["double", 2, 4, 8])
def test_every_operation_is_that_of_casadi(real):
    function = every_operation()
    native = load(emit([function], real)).function("every")
    rng = np.random.default_rng(1)
    for x in (rng.uniform(0.1, 5.0, (2, 8)), np.ones((2, 8)), 1e7 * rng.uniform(0.2, 1.0, (2, 8))):
        lanes = 1 if real == "double" else real
        native.arguments[0].reshape(1, -1)[:] = x[0, :lanes]
        native.arguments[1].reshape(1, -1)[:] = x[1, :lanes]
        native()
        wanted = np.array(function.map(lanes)(x[:1, :lanes], x[1:, :lanes]))
        np.testing.assert_allclose(native.results[0].reshape(-1, lanes), wanted, rtol=1e-14)


def test_what_cannot_be_code_is_named(monkeypatch):
    x = ca.SX.sym("x")
    with pytest.raises(CodeError, match=r"inverse has an operation without a form in C"):
        emit([ca.Function("inverse", [x], [ca.erfinv(x)])])
    with pytest.raises(CodeError, match=r"open has symbols that are no argument: \['y'\]"):
        emit([ca.Function("open", [x], [x * ca.SX.sym("y")], {"allow_free": True})])
    with pytest.raises(CodeError, match=r"matrices is no function of scalar symbols"):
        emit([ca.Function("matrices", [m := ca.MX.sym("m")], [m])])
    monkeypatch.setattr("mbd_ros.compiled.code.emit.MOST", 40)
    with pytest.raises(CodeError, match=r"the equations are \d+ operations; at most 40 are comp"):
        emit([every_operation()])


@pytest.mark.parametrize("alone", [8000, 1300])
def test_long_functions_are_cut_and_give_the_same(monkeypatch, alone):
    """A recursion that keeps early values alive to its end: they wait in `work`."""
    monkeypatch.setattr("mbd_ros.compiled.code.emit.ALONE", alone)
    x = ca.SX.sym("x", 40)
    terms = [x[k] for k in range(40)]
    for k in range(1200):
        terms.append(ca.sin(terms[-1]) + terms[-40] * terms[k % 40])
    function = ca.Function("chain", [x], [ca.vertcat(*terms[-10:], x[3], 0.0, 2.5)])
    source = emit([function])
    native = load(source).function("chain")
    assert len(source.units) == (3 if alone == 1300 else 0)
    assert 40 < source.signatures["chain"].work < 200
    native.arguments[0][:] = np.random.default_rng(2).normal(0.0, 0.3, 40)
    native()
    wanted = np.array(function(native.arguments[0])).ravel()
    np.testing.assert_allclose(native.results[0], wanted, rtol=1e-11)


def test_results_that_are_sparse_are_written_as_dense_columns():
    x = ca.SX.sym("x", 3)
    native = load(emit([ca.Function("sparse", [x], [ca.diag(x), x[1], ca.SX(0, 1)])]))
    native = native.function("sparse")
    native.arguments[0][:] = 1.0, 2.0, 3.0
    native.results[0][:] = 7.0
    native()
    assert (native.results[0].reshape(3, 3) == np.diag([1.0, 2.0, 3.0])).all()
    assert native.results[1] == 2.0 and native.results[2].size == 0


@pytest.mark.parametrize("real", ["double", 8])
def test_sines_and_cosines_are_right_to_the_last_place(real):
    """Beside the functions of long double, whose own error is a thousandth of a place."""
    angle = ca.SX.sym("angle", 64)
    turned = ca.Function("turned", [angle], [ca.sin(angle), ca.cos(angle)])
    source = emit([turned], real)
    native = load(source).function("turned")
    rng = np.random.default_rng(3)
    quarters = np.pi / 2 * rng.integers(-600_000, 600_000, 64 * 8)
    angles = [quarters, rng.normal(0.0, 1.0, 64 * 8), rng.uniform(-1e6, 1e6, 64 * 8)]
    angles += [10.0 ** rng.uniform(-300.0, 300.0, 64 * 8)]
    for values in angles:
        argument = native.arguments[0]
        argument[:] = values[: argument.size].reshape(argument.shape)
        native()
        wanted = (f(argument.astype(np.longdouble)) for f in (np.sin, np.cos))
        for result, exact in zip(native.results, wanted, strict=True):
            places = (result.reshape(argument.shape) - exact) / np.spacing(np.abs(result))
            assert np.abs(places).max() < 0.9
    native.arguments[0].flat[:3] = np.inf, np.nan, 0.0
    native()
    assert np.isnan(native.results[0].flat[:2]).all() and native.results[1].flat[2] == 1.0


def test_numbers_that_share_a_divisor_cost_one_division():
    x, y = ca.SX.sym("x", 5), ca.SX.sym("y", 2)
    shared = ca.Function("shared", [x, y], [ca.vertcat(x / y[0], 1 / y[0], x[0] / y[1])])
    source = emit([shared])
    assert source.text.count(" / t") + source.text.count(" / i") == 2
    native = load(source).function("shared")
    native.arguments[0][:], native.arguments[1][:] = (3.0, -2.0, 0.0, 7.0, 1e300), (0.7, 0.0)
    native()
    wanted = np.array(shared(*native.arguments)).ravel()
    np.testing.assert_allclose(native.results[0], wanted, rtol=3e-16)


@pytest.mark.parametrize("lanes", [2, 8])
def test_exponentials_of_vectors_are_right_to_about_the_last_place(lanes):
    x = ca.SX.sym("x", 64)
    functions = [ca.exp, ca.log, ca.tanh]
    native = load(emit([ca.Function("grown", [x], [f(x) for f in functions])], lanes))
    native = native.function("grown")
    argument = native.arguments[0]
    rng = np.random.default_rng(4)
    shape = argument.shape
    large, small = rng.uniform(-740.0, 705.0, shape), 10.0 ** rng.uniform(-320.0, 300.0, shape)
    for values in (rng.normal(0.0, 1.0, shape), large, small, 1.0 + 0.1 * rng.normal(size=shape)):
        argument[:] = values
        native()
        for result, f in zip(native.results, (np.exp, np.log, np.tanh), strict=True):
            with np.errstate(invalid="ignore", over="ignore"):
                exact = f(argument.astype(np.longdouble))
                places = (result.reshape(shape) - exact) / np.spacing(np.abs(result)).clip(5e-324)
            met = np.isfinite(result.reshape(shape))
            assert np.abs(places[met]).max() < (3.0 if f is np.tanh else 1.2)
            assert (np.isnan(exact) == np.isnan(result.reshape(shape))).all()
    argument.flat[:4] = np.inf, -np.inf, np.nan, 0.0
    native()
    exp, log, tanh = (result.flat[:4] for result in native.results)
    assert exp[0] == np.inf and exp[1] == 0.0 and np.isnan(exp[2]) and exp[3] == 1.0
    assert log[0] == np.inf and np.isnan(log[1:3]).all() and log[3] == -np.inf
    assert tanh[0] == 1.0 and tanh[1] == -1.0 and np.isnan(tanh[2]) and tanh[3] == 0.0
