"""Which class of a file to compile."""

from __future__ import annotations

from pathlib import Path

from daest.errors import ModelError
from daest.modelica import failures
from daest.modelica.outline import ClassHead, class_heads
from daest.modelica.tokens import place_of, tokens


def select_class(text: bytes, path: Path, wanted: str | None) -> str:
    """The full name of the model to compile.

    Without `wanted` it is the file's only complete model: among the outermost classes if there is one, else
    among those inside of packages; of several, the only one that no other class of the file uses. With
    `wanted`, the short name of a class inside of a package is enough. Raises ModelError when there is none
    or more than one.
    """
    heads = class_heads(text)
    if wanted is not None:
        return _named(heads, text, path, wanted)
    models = _candidates(heads)
    unused = [head for head in models if not _is_used(head, text)]
    for choice in (models, unused):
        if len(choice) == 1:
            return choice[0].name
    if not models:
        raise _no_model(heads, text, path)
    raise ModelError(
        "model-ambiguous",
        f"{path} holds {len(models)} models: {', '.join(head.name for head in models)}",
        where=str(path),
        remedy=f"Name the one to use: --class {(unused or models)[-1].name}.",
    )


def _candidates(heads: tuple[ClassHead, ...]) -> list[ClassHead]:
    """Complete models that lie inside of packages only: a class declared in a model is a part of that
    model."""
    outer_models = {head.name for head in heads if head.kind != "package"}
    free = [head for head in heads if head.is_model and not _lies_in(head.name, outer_models)]
    outermost = [head for head in free if head.depth == 0]
    return outermost or free


def _is_used(head: ClassHead, text: bytes) -> bool:
    """Whether the class is named anywhere but where it is defined."""
    short = head.name.rpartition(".")[2]
    before = ""
    for token in tokens(text):
        if token.text == short and token.start != head.start and before != "end":
            return True
        before = token.text
    return False


def _lies_in(name: str, outer: set[str]) -> bool:
    parts = name.split(".")
    return any(".".join(parts[:i]) in outer for i in range(1, len(parts)))


def _named(heads: tuple[ClassHead, ...], text: bytes, path: Path, wanted: str) -> str:
    matching = [head for head in heads if head.name == wanted or head.name.endswith("." + wanted)]
    exact = [head for head in matching if head.name == wanted] or matching
    if not exact:
        if not heads:
            raise _no_model(heads, text, path)
        raise failures.unknown_class(wanted, path, text)
    head = exact[0]
    if len(exact) > 1:
        raise ModelError(
            "model-ambiguous",
            f"`{wanted}` may be {' or '.join(one.name for one in exact)}",
            where=str(path),
            remedy="Give the full name.",
        )
    if not head.is_model:
        kind = f"partial {head.kind}" if head.is_partial else head.kind
        raise failures.not_a_model(head.name, kind, place_of(str(path), text, head.start))
    return head.name


def _no_model(heads: tuple[ClassHead, ...], text: bytes, path: Path) -> ModelError:
    found = ", ".join(f"{'partial ' if h.is_partial else ''}{h.kind} {h.name}" for h in heads[:5])
    return ModelError(
        "model-none",
        f"{path} holds no complete model" + (f", only {found}" if found else ""),
        where=place_of(str(path), text, heads[0].start) if heads else str(path),
        remedy="Write `model NAME … equation … end NAME;`.",
    )
