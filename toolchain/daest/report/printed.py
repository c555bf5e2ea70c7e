"""Results as the text that the command of their kind prints: `print(fit)` is what `daest identify` says."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Mapping
from typing import Any

from daest.model.comparison import Comparison
from daest.model.diagnosis import Diagnosis, Improvement
from daest.model.estimates import FilterResult
from daest.model.experiment import DataCheck
from daest.model.fit import FitResult
from daest.model.linear import LinearDAE
from daest.model.noise import NoiseReport
from daest.model.shown import TEXTS
from daest.report.documents import check as check_document
from daest.report.documents import compare as compare_document
from daest.report.documents import diagnose as diagnose_document
from daest.report.documents import filter as filter_document
from daest.report.documents import fit as fit_document
from daest.report.documents import linearize as linearize_document
from daest.report.documents import noise as noise_document
from daest.report.texts import check as check_text
from daest.report.texts import compare as compare_text
from daest.report.texts import diagnose as diagnose_text
from daest.report.texts import filter as filter_text
from daest.report.texts import identify as identify_text
from daest.report.texts import improve as improve_text
from daest.report.texts import linearize as linearize_text
from daest.report.texts import noise as noise_text
from daest.systems.linear.standard_form import standard_form
from daest.systems.linear.transfer import transfer_functions

WIDTH = 100  # columns where the output is no terminal
UNRESTRICTED: Mapping[str, list[str]] = {"effects": [], "places": []}


def _diagnosed(found: Diagnosis) -> dict[str, Any]:
    return {**diagnose_document.document(found), "outputs": _units(found), "searched": UNRESTRICTED}


def _improved(found: Improvement) -> dict[str, Any]:
    outputs = _units(found.last)
    document = diagnose_document.improvement_document(found)
    final = {**document["final"], "outputs": outputs}
    return {**document, "final": final, "outputs": outputs, "searched": UNRESTRICTED, "folder": ""}


def _units(found: Diagnosis) -> dict[str, str]:
    """Units of the outputs by name."""
    return {noise.name: noise.unit for noise in found.baseline.noises if noise.kind == "measurement"}


def _linear(dae: LinearDAE) -> Mapping[str, Any]:
    standard = standard_form(dae)
    return linearize_document.document(dae, standard, transfer_functions(dae, standard), [], {})


def _printed(document: Callable[[Any], Mapping[str, Any]], text: Callable[..., str]) -> Callable[[Any], str]:
    return lambda value: text(document(value), width=_width()).rstrip("\n")


def _width() -> int:
    is_terminal = sys.stdout is not None and sys.stdout.isatty()
    return shutil.get_terminal_size().columns if is_terminal else WIDTH


TEXTS.update(
    {
        FitResult: _printed(fit_document.document, identify_text.text),
        NoiseReport: _printed(noise_document.document, noise_text.text),
        FilterResult: _printed(filter_document.document, filter_text.text),
        Comparison: _printed(compare_document.document, compare_text.text),
        DataCheck: _printed(lambda check: check_document.document([check]), check_text.text),
        Diagnosis: _printed(_diagnosed, diagnose_text.text),
        Improvement: _printed(_improved, improve_text.text),
        LinearDAE: _printed(_linear, linearize_text.text),
    }
)
