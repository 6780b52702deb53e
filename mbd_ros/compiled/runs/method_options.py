"""Methods of integration as native runs know them."""

from typing import Any

from numpy.typing import NDArray

from mbd_ros.compiled.runs.native_types import (
    Held,
    Method,
    OptionsOfC,
    adams_of,
    tableau_of,
)
from mbd_ros.core.integration.adams_steps import starter
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.names import type_name
from mbd_ros.errors import ModelError
from mbd_ros.integrators.adams import Adams
from mbd_ros.integrators.dop853 import Dop853
from mbd_ros.integrators.dopri5 import Dopri5
from mbd_ros.integrators.rattle import Rattle
from mbd_ros.integrators.rk4 import Rk4
from mbd_ros.integrators.semi_implicit_euler import SemiImplicitEuler

NATIVE = "rk4, adams, dopri5, dop853, rattle, semi_implicit_euler with explicit damping"


def is_native(method: Integrator) -> bool:
    """Whether native runs know a method."""
    if isinstance(method, SemiImplicitEuler):
        return method.damping == "explicit"
    return isinstance(method, Rk4 | Adams | Dopri5 | Dop853 | Rattle)


def method_options(method: Integrator, dt: float) -> Held:
    """The method with steps of dt [s], or with that first guess.

    Raises:
        ModelError: Native runs do not know it.
    """
    options = OptionsOfC(dt=dt)
    arrays: tuple[NDArray[Any], ...] = ()
    if isinstance(method, Rk4 | Dopri5 | Dop853):
        table = tableau_of(method.tableau)
        tolerance = getattr(method, "tolerance", None)
        options.method, options.tableau, arrays = Method.RUNGE_KUTTA, table.value, table.arrays
        options.is_adaptive, options.tolerance = tolerance is not None, tolerance or 0.0
    elif isinstance(method, Adams):
        table, weights = tableau_of(starter(method.order)), adams_of(method.order, dt)
        options.method, options.tableau, options.adams = Method.ADAMS, table.value, weights.value
        arrays = (*table.arrays, *weights.arrays)
    elif isinstance(method, Rattle):
        options.method, options.closed = Method.RATTLE, method.tolerance
    elif is_native(method):
        options.method = Method.SEMI_IMPLICIT_EULER
    else:
        raise ModelError(
            f"integrator {type_name(type(method))} is not compiled; accepted: {NATIVE}"
        )
    return Held(options, arrays)
