"""Derivatives of CasADi functions by complex steps: exact, and without CasADi's own."""

import casadi as ca
import numpy as np

_STEP = 1e-40
_RULES = {
    ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply, ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative, ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_SQRT: np.sqrt,
    ca.OP_TANH: np.tanh, ca.OP_POW: np.power, ca.OP_EXP: np.exp, ca.OP_ASSIGN: lambda x: x,
    ca.OP_SQ: lambda x: x * x, ca.OP_TWICE: lambda x: 2.0 * x, ca.OP_INV: lambda x: 1.0 / x,
    ca.OP_LT: lambda x, y: (x.real < y.real) + 0.0,
    ca.OP_LE: lambda x, y: (x.real <= y.real) + 0.0,
    ca.OP_NOT: lambda x: (x.real == 0.0) + 0.0,
    ca.OP_IF_ELSE_ZERO: lambda x, y: np.where(x.real != 0.0, y, 0.0),
    ca.OP_FMIN: lambda x, y: np.where(x.real <= y.real, x, y),
    ca.OP_FMAX: lambda x, y: np.where(x.real >= y.real, x, y),
    ca.OP_FABS: lambda x: np.where(x.real < 0.0, -x, x),
    ca.OP_COPYSIGN: lambda x, y: np.where((x.real < 0.0) == (y.real < 0.0), x, -x),
}  # fmt: skip


def evaluated(function, *arguments):
    """The results at complex arguments, one column a direction."""
    count = max(np.shape(one)[1] for one in arguments)
    work = {}
    results = [np.zeros((function.size1_out(i), count), complex) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation, given = function.instruction_id(k), function.instruction_input(k)
        to = function.instruction_output(k)
        if operation == ca.OP_CONST:
            work[to[0]] = np.full(count, function.instruction_constant(k), complex)
        elif operation == ca.OP_INPUT:
            work[to[0]] = arguments[given[0]][given[1]] + np.zeros(count, complex)
        elif operation == ca.OP_OUTPUT:
            results[to[0]][to[1]] = work[given[0]]
        else:
            work[to[0]] = _RULES[operation](*(work[i] for i in given))
    return results


def slopes(function, which, *arguments):
    """Slopes of all results by one argument, stacked."""
    n = len(arguments[which])
    columns = [np.array(one, complex).reshape(-1, 1) for one in arguments]
    if not n:
        return np.zeros((sum(function.size1_out(i) for i in range(function.n_out())), 0))
    columns[which] = columns[which] + 1j * _STEP * np.eye(n)
    return np.concatenate(evaluated(function, *columns)).imag / _STEP
