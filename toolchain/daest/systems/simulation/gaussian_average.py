"""Expectation of smoothed steps over a Gaussian state: what a Gaussian filter needs of sharp friction.

Where tanh(a) is sharper than the state is known, its slope at the estimate tells nothing about the slope over
the distribution. For a of variance s², E erf(√π a / 2) = erf(√π b / 2) with b = a / √(1 + π s² / 2), and
tanh(a) is close to erf(√π a / 2): b put into tanh where s is small and into erf where it is large gives
E tanh(a) within 0.015; E sign(a) = erf(a / √2 s) is exact. The slope of the expectation is the expectation of
the slope (statistical linearisation: Gelb, Applied Optimal Estimation, section 6.2).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

CERTAIN = 1e-30  # variance of an argument that counts as none


def averaged(expression: ca.SX, x: ca.SX, cov: ca.SX) -> ca.SX:
    """The expression with every tanh(a) and sign(a) replaced by its expectation for x with the covariance
    `cov` (n, n), the variance of a being that of its linearisation in x. Products of several steps are
    averaged factor by factor."""
    if not ca.depends_on(expression, x):
        return expression
    inputs = ca.symvar(expression)
    function = ca.Function("expression", inputs, [expression])
    work: list[Any] = [ca.SX(0)] * function.sz_w()
    values: list[Any] = [ca.SX(0)] * expression.nnz()
    for k in range(function.n_instructions()):
        operation, source = function.instruction_id(k), function.instruction_input(k)
        target = function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[target[0]] = inputs[source[0]]
        elif operation == ca.OP_CONST:
            work[target[0]] = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            values[target[1]] = work[source[0]]
        elif operation == ca.OP_TANH:
            work[target[0]] = _expected_tanh(work[source[0]], x, cov)
        elif operation == ca.OP_SIGN:
            work[target[0]] = _expected_sign(work[source[0]], x, cov)
        elif len(source) == 1:
            work[target[0]] = ca.SX.unary(operation, work[source[0]])
        else:
            work[target[0]] = ca.SX.binary(operation, work[source[0]], work[source[1]])
    return ca.SX(expression.sparsity(), ca.vertcat(*values))


def _variance(argument: ca.SX, x: ca.SX, cov: ca.SX) -> ca.SX | None:
    """Of the argument, linearised in x; None where x does not move it."""
    slope = ca.jacobian(argument, x)
    return ca.densify(slope @ cov @ slope.T) if slope.nnz() else None


def _expected_sign(argument: ca.SX, x: ca.SX, cov: ca.SX) -> ca.SX:
    variance = _variance(argument, x, cov)
    if variance is None:
        return ca.sign(argument)
    certain = variance < CERTAIN
    smooth = ca.erf(argument / ca.sqrt(2 * ca.if_else(certain, 1.0, variance)))
    return ca.if_else(certain, ca.sign(argument), smooth)


def _expected_tanh(argument: ca.SX, x: ca.SX, cov: ca.SX) -> ca.SX:
    variance = _variance(argument, x, cov)
    if variance is None:
        return ca.tanh(argument)
    wide = np.pi / 2 * variance
    b = argument / ca.sqrt(1 + wide)
    return (ca.tanh(b) + wide * ca.erf(np.sqrt(np.pi) / 2 * b)) / (1 + wide)
