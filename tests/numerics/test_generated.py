"""C text of functions without what CasADi's loader asks of them."""

import ctypes

import casadi as ca
import numpy as np

from daest.numerics.compiler import build_shared, pointer
from daest.numerics.generated import generated


def functions():
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    rate = ca.Function("rate", [x, p], [ca.vertcat(ca.tanh(p[0] * x[1]), x[2] * x[0], ca.sin(x[0]) / p[1])])
    return rate, ca.Function("slopes", [x, p], [ca.densify(ca.jacobian(rate(x, p), x))])


def test_generated_functions_compute_what_casadi_does():
    library = ctypes.CDLL(str(build_shared(generated(functions()), "generated", ("-O1",))))
    x, p = np.array([0.3, -0.7, 1.9]), np.array([2.0, 0.5])
    for function in functions():
        made = np.zeros(function.numel_out(0))
        arguments = (ctypes.c_void_p * 8)(*(pointer(one).value for one in (x, p)))
        results = (ctypes.c_void_p * 8)(pointer(made).value)
        work = np.zeros(function.sz_w() + 1)
        assert getattr(library, function.name())(arguments, results, None, pointer(work), 0) == 0
        assert np.allclose(made, np.array(function(x, p)).ravel(order="F"), rtol=1e-14)


def test_nothing_else_is_generated():
    text, generator = generated(functions()), ca.CodeGenerator("model.c")
    for function in functions():
        generator.add(function)
    assert "rate_sparsity_in" in generator.dump() and "rate_work(" in generator.dump()
    assert not any(f"rate_{word}" in text for word in ("checkout", "sparsity_in", "work", "n_in"))
