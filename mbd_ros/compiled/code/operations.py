"""What each operation of CasADi is in C, for numbers and for vectors of them."""

import casadi as ca

from mbd_ros.compiled.code.instructions import CodeError, Value

_FORMS = {
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "R(1.0) / {0}",
    ca.OP_ASSIGN: "{0}",
    ca.OP_LIFT: "{0}",
}
_CALLS = {  # of functions that the headers define
    ca.OP_ACOS: "acos",
    ca.OP_ACOSH: "acosh",
    ca.OP_AND: "and",
    ca.OP_ASIN: "asin",
    ca.OP_ASINH: "asinh",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_ATANH: "atanh",
    ca.OP_CEIL: "ceil",
    ca.OP_CONSTPOW: "pow",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_COS: "cos",
    ca.OP_COSH: "cosh",
    ca.OP_EQ: "equal",
    ca.OP_ERF: "erf",
    ca.OP_EXP: "exp",
    ca.OP_EXPM1: "expm1",
    ca.OP_FABS: "fabs",
    ca.OP_FLOOR: "floor",
    ca.OP_FMAX: "fmax",
    ca.OP_FMIN: "fmin",
    ca.OP_FMOD: "fmod",
    ca.OP_HYPOT: "hypot",
    ca.OP_IF_ELSE_ZERO: "where",
    ca.OP_LE: "at_most",
    ca.OP_LOG: "log",
    ca.OP_LOG1P: "log1p",
    ca.OP_LT: "less",
    ca.OP_NE: "differs",
    ca.OP_NOT: "not",
    ca.OP_OR: "or",
    ca.OP_POW: "pow",
    ca.OP_REMAINDER: "remainder",
    ca.OP_SIGN: "sign",
    ca.OP_SIN: "sin",
    ca.OP_SINH: "sinh",
    ca.OP_SQRT: "sqrt",
    ca.OP_TAN: "tan",
    ca.OP_TANH: "tanh",
}


def expression(value: Value, operands: list[str], function: str) -> str:
    """The C expression of a computed value.

    Args:
        value: The value.
        operands: What stands for those that it is computed from.
        function: Whose value it is, for the error.

    Raises:
        CodeError: C has no such operation.
    """
    form = _FORMS.get(value.code)
    if form is not None:
        return form.format(*operands)
    call = _CALLS.get(value.code)
    if call is None:
        raise CodeError(f"{function} has an operation without a form in C: CasADi's {value.code}")
    return f"real_{call}({', '.join(operands)})"
