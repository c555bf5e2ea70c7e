"""The standard form of a model of any size: dense with bases for all of it, or sparse with what is needed."""

from __future__ import annotations

from dataclasses import replace

from daest.errors import ModelError, NumericalError
from daest.model.linear import LinearDAE, SparseForm, StandardForm
from daest.numerics.modular_pencil import SingularPencil
from daest.numerics.threads import one_thread
from daest.systems.linear.exact_structure import exact_structure
from daest.systems.linear.sparse_form import sparse_form
from daest.systems.linear.split import decides, dependent_equations, disagreement, null_vector, split

SPARSE_LIMIT = 500
"""From this many equations on the sparse form is made."""

LOST = (
    "exact arithmetic gives index {exact.index} and {exact.n_dynamic} modes; in floating point it is index "
    "{form.index} and {form.n_dynamic} modes: numbers of very different size have lost their digits"
)

DENSE_LIMIT = 4000
"""Up to this many equations the dense staircase decides where the structure does not tell the index: some
three minutes and 2 GB."""


def standard_form(dae: LinearDAE, tolerance: float | None = None) -> StandardForm | SparseForm:
    """`split` for small models, `sparse_form` for large ones where values do not contradict the structure.

    Raises what `split` raises, and ModelError `model-too-large` where only dense algebra could decide.
    """
    if dae.n < SPARSE_LIMIT:
        return split(dae, tolerance)
    try:
        with one_thread():  # many small solutions: a second thread only waits
            return _checked(dae, sparse_form(dae, tolerance), tolerance)
    except NumericalError as error:
        if error.code != "system-jacobian-singular":
            raise
        return _dense_form(dae, tolerance, error)


def _checked(dae: LinearDAE, form: SparseForm, tolerance: float | None) -> SparseForm:
    """The form with what exact arithmetic says; of an index that rounding errors have raised, the maps that
    are nothing but such errors are taken away."""
    try:
        exact = exact_structure(dae) if tolerance is None else None
    except SingularPencil as error:
        raise dependent_equations(dae) from error
    if exact is None:
        return form
    if form.n_dynamic == exact.n_dynamic and form.index > exact.index and decides(dae, exact):
        form = replace(form, maps=form.maps[: exact.index], index=exact.index)
    if (form.index, form.n_dynamic) == (exact.index, exact.n_dynamic):
        return replace(form, exact=exact)
    return replace(form, doubts=disagreement(exact, form) or (LOST.format(exact=exact, form=form),))


def _dense_form(dae: LinearDAE, tolerance: float | None, reason: NumericalError) -> StandardForm:
    if dae.n <= DENSE_LIMIT:
        return split(dae, tolerance)
    if null_vector(dae) is not None:
        raise dependent_equations(dae) from reason
    raise ModelError(
        "model-too-large",
        f"the index of this model cannot be told from its structure, and the dense way would take some "
        f"{80e-9 * dae.n**2:.0f} GB and {3.0 * (dae.n / DENSE_LIMIT) ** 3:.0f} minutes for {dae.n} equations",
        remedy=f"split the model, or write its constraints with fewer equations; {reason.what}",
    ) from reason
