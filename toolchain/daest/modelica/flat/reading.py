"""What the steps of one compilation share: the flat source, its texts, scopes and annotations."""

from __future__ import annotations

import casadi as ca

from daest.errors import Place
from daest.modelica.flat.events import Recorder, event_targets, has_events
from daest.modelica.flat.functions import FunctionLibrary
from daest.modelica.flat.parameters import is_parameter, numeric_scope
from daest.modelica.flat.scope import ModelScope
from daest.modelica.language import syntax as s
from daest.modelica.language.expressions import Evaluator
from daest.modelica.language.parse import (
    NONE,
    Annotation,
    Role,
    annotation_of,
    check_keys,
    refuse_marks_of_classes,
)
from daest.modelica.language.source import Sources


class Reading:
    """A flat source being read. `numeric` has every parameter as a number, `scope` has the symbols;
    `annotations` holds the `__Daest(...)` of each variable by name."""

    def __init__(self, source: s.FlatSource) -> None:
        self.source = source
        self.sources = Sources(source.texts)
        self.time = ca.SX.sym("time")
        self.events: Recorder | None = None
        self.numeric = numeric_scope(source, self.evaluator)
        names = tuple(variable.name for variable in source.variables)
        self.scope = ModelScope(names, {**source.literals, "time": self.time})
        self.scope.constant_names = self.numeric.constant_names
        self.discrete = frozenset(x.name for x in source.variables if x.is_discrete and not is_parameter(x))
        self.scope.shapes = self.numeric.shapes
        self.events = self._recorder() if has_events(source) else None
        for file, text in source.texts.values():
            refuse_marks_of_classes(file, text)
        self.annotations = {x.name: self._annotation(x) for x in source.variables}

    def _recorder(self) -> Recorder:
        source = self.source
        discrete = frozenset(x.name for x in source.variables if x.is_discrete and not is_parameter(x))
        return Recorder(self.scope, event_targets(source), discrete)

    def evaluator(self, scope: ModelScope, span: s.Span | None) -> Evaluator:
        events = self.events if self.events is not None and scope is self.scope else None
        return Evaluator(scope, self.library(scope), self.sources.place, at=span, events=events)

    @property
    def targets(self) -> frozenset[str]:
        """Names of the variables that events assign."""
        return frozenset() if self.events is None else self.events.targets

    @property
    def restarted(self) -> frozenset[str]:
        """Names of the variables that `reinit` restarts, and of Real variables that events assign."""
        bodies = [body for when in self.source.whens for _, body in when.branches]
        return self.targets | {x.target.name for body in bodies for x in body if isinstance(x, s.Reinit)}

    def library(self, scope: ModelScope) -> FunctionLibrary:
        source = self.source
        return FunctionLibrary(source.functions, self.sources.place, scope.lookup, scope.path, source.folders)

    def declared_at(self, variable: s.FlatVariable) -> Place | None:
        """The place of the variable's identifier in its declaration."""
        identifier = variable.name.rpartition(".")[2].partition("[")[0]
        return self.sources.declaration(variable.span, identifier)

    def is_noise(self, variable: s.FlatVariable) -> bool:
        return self.annotations[variable.name].flag("noise", False)

    def _annotation(self, variable: s.FlatVariable) -> Annotation:
        if variable.span is None or variable.span.source not in self.sources.texts:
            return NONE
        file, text = self.sources.texts[variable.span.source]
        if b"__Daest" not in text:
            return NONE
        found = annotation_of(file, text, variable.span.end)
        if found:
            check_keys(found, _role(variable), variable.name)
        return found


def _role(variable: s.FlatVariable) -> Role:
    if variable.variability == "parameter":
        return "parameter"
    if variable.causality == "input":
        return "input"
    return "output" if variable.causality == "output" else "variable"
