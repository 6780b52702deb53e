"""Methods of integration as native runs know them."""

from typing import Any

from mbd_ros.compiled.runs.native_types import Held, Method, OptionsOfC, adams_of, tableau_of
from mbd_ros.core.integration.adams_steps import starter
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.names import type_name
from mbd_ros.errors import ModelError

NATIVE = "rk4, adams, dopri5, dop853, rattle, semi_implicit_euler with explicit damping"


def method_options(method: Integrator, dt: float) -> Held:
    """The method with steps of dt [s], or with that first guess.

    Raises:
        ModelError: Native runs do not know it.
    """
    if not method.native:
        name = type_name(type(method))
        raise ModelError(f"integrator {name} is not compiled; accepted: {NATIVE}")
    kind = Method[method.native.upper()]
    options, tables = OptionsOfC(method=kind, dt=dt), []
    given: Any = method
    if kind == Method.RUNGE_KUTTA:
        tables.append(tableau_of(given.tableau))
        tolerance = getattr(given, "tolerance", None)
        options.is_adaptive, options.tolerance = tolerance is not None, tolerance or 0.0
    elif kind == Method.ADAMS:
        tables += [tableau_of(starter(given.order)), adams_of(given.order, dt)]
        options.adams = tables[1].value
    elif kind == Method.RATTLE:
        options.closed = given.tolerance
    if tables:
        options.tableau = tables[0].value
    return Held(options, tuple(array for table in tables for array in table.arrays))
