"""What the compiler says when it fails, as errors with a code, a place and a remedy."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from itertools import islice, pairwise
from pathlib import Path

import rumoca

from daest.errors import ModelError, Place
from daest.modelica.language.library import library_root
from daest.modelica.language.outline import (
    KINDS,
    Token,
    class_heads,
    class_tokens,
    depths,
    imported,
    name_end,
    place_of,
    place_told,
    tokens,
)
from daest.near import did_you_mean, near_names

STANDARD = "Modelica."  # how names of the Modelica Standard Library begin
# Functions of Modelica.Math that the language has under the same name.
BUILT_IN = frozenset(
    ["sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "log10"]
)
MOST_EXPECTED = 8  # words of the parser that are passed on

_BALANCE = re.compile(r"unbalanced model: (\d+) equations, (\d+) unknowns")
_QUOTED = re.compile(r"['`]([^'`]+)['`]")
_SUBTYPE = re.compile(r"violates constrainedby: `([\w.]+)` is not a subtype of `([\w.]+)`")
_LAYOUT = re.compile(
    r"source root '([^']+)': invalid Modelica package layout.*?"
    r"file '([^']+)' has `within ([\w.]*);` but expected `within ([\w.]*);`",
    re.DOTALL,
)
_BYTE = re.compile(r"start: BytePos\((\d+)\)")
_POSITION = re.compile(r"╭─\[.*?:(\d+):(\d+)\]")
_DECLARED_TYPE = re.compile(r"^  type (\w+) =", re.MULTILINE)


class RefusedFunction(ModelError):
    """The compiler does not take the algorithm of function `name`."""

    def __init__(self, name: str, what: str, where: Place | str, remedy: str) -> None:
        super().__init__("model-function", what, where=where, remedy=remedy)
        self.name = name


class Unfitting(ModelError):
    """The class `name` that is redeclared does not extend the constraining class `wanted`."""

    def __init__(self, problem: ModelError, name: str, wanted: str) -> None:
        super().__init__(problem.code, problem.what, where=problem.where, remedy=problem.remedy)
        self.name, self.wanted = name, wanted


class BeyondCompiler(ModelError):
    """The compiler reads the model, but does not take what one of its equations or functions does."""


class RefusedAlgorithm(ModelError):
    """The compiler does not take an algorithm section of a model."""


class RefusedClock(ModelError):
    """The compiler does not take an equation on a clock in the form in which it is written."""


class Unbalanced(ModelError):
    """Equations and unknowns differ in number, by the compiler's count."""

    def __init__(self, n_equations: int, n_unknowns: int, where: str) -> None:
        what = f"the model has {n_equations} equations for {n_unknowns} unknowns"
        super().__init__("model-unbalanced", what, where=where)
        self.n_equations = n_equations
        self.n_unknowns = n_unknowns


def internal(problem: BaseException, path: Path, text: bytes) -> ModelError:
    """The compiler itself broke."""
    if "derivative target" in str(problem):
        start = _BYTE.search(str(problem))
        return ModelError(
            "model-der-input",
            "der() differentiates an input or a discrete variable",
            where=place_of(str(path), text, int(start[1])) if start else str(path),
            remedy="Introduce a variable for it (`Real x = u;`) and write der(x).",
        )
    said = " ".join(str(problem).partition("stack backtrace")[0].split()) or type(problem).__name__
    return ModelError(
        "model-compiler",
        f"the Modelica compiler failed: {said}",
        where=str(path),
        remedy="Simplify the model until it compiles; what was taken out last is beyond the compiler.",
    )


def translated(
    message: str, path: Path, text: bytes, class_name: str, libraries: Iterable[Path] = ()
) -> ModelError:
    """The error behind a message of the compiler; `libraries` are those that were read."""
    missing = _not_in_library(message, path, text, libraries)
    if missing is not None:
        return missing
    limit = next(((what, remedy) for phrase, what, remedy in _BEYOND if phrase in message.lower()), None)
    if limit is not None:
        what, remedy = limit
        named = _QUOTED.search(message[message.index(_plain(message)[:20]) :])
        problem = ModelError(
            "model-compile",
            f"`{class_name}` is beyond the compiler that is built in: {what}"
            f"{f' (`{named[1]}`)' if named else ''}. The model may well be right",
            where=str(path),
            remedy=remedy,
        )
        pair = _SUBTYPE.search(message)
        return Unfitting(problem, pair[1], pair[2]) if pair else problem
    for translate in (
        _layout,
        _syntax,
        _balance,
        _unknown,
        _types,
        _der_expression,
        _clocked,
        _unsupported,
        _missing_class,
    ):
        made = translate(message, path, text, class_name)
        if made is not None:
            return made
    if "expression shape mismatch" in message and (taken := _hidden_array(text, class_name)) is not None:
        return _mistaken(*taken, str(path))
    if "failed in ToDae" in message:
        return BeyondCompiler(
            "model-compile",
            f"`{class_name}` is read and understood, but is beyond the compiler that is built in: "
            f"{_limit(_plain(message))}. The model may well be right",
            where=str(path),
            remedy="Take out one component after the other until it compiles: the last one has it. Replace "
            "that one (a table or an array by a formula, a record by its parts); "
            f"{_FMU}",
        )
    return ModelError(
        "model-compile",
        f"`{class_name}` does not compile: {_plain(message)}",
        where=str(path),
        remedy="Change the construct that the message names; or, with OpenModelica installed, make by "
        "`daest export MODEL --compiler omc -o NAME.bmo` Base Modelica, or with NAME.fmu an FMU, which all "
        "other commands take.",
    )


_FMU = (
    "or export the model by your own tool as an FMU, which all commands take; or, with OpenModelica "
    "installed, by `daest export MODEL --compiler omc -o NAME.bmo`."
)

# What the compiler's message contains in small letters, what of the model it cannot do, and what helps.
_BEYOND = (
    (
        "member augmentation",
        "an expandable connector gets a member by a connection",
        f"Declare the member in the connector (`expandable connector Bus Real heat; end Bus;`); {_FMU}",
    ),
    (
        "violates constrainedby",
        "a redeclared component whose class has the right interface, but does not extend the constraining "
        "class",
        f"Let the new class extend the constraining one; {_FMU}",
    ),
    (
        "unevaluable array dimensions",
        "the size of an array follows from a function, or from a replaceable package, as of a medium",
        "Write the size as a number, a fluid as a component with constants (Modelica.Thermal.FluidHeatFlow "
        f"does); {_FMU}",
    ),
    (
        "missing exact function-selection identity",
        "a function that a library lets stand for another one, as for the path of a file",
        f"Write the table or the number that is read from the file into the model; {_FMU}",
    ),
    (
        "wrong dae coordinate role",
        "an equation between whole records, as Complex numbers with operators",
        f"Write one equation for each part (`v.re = …; v.im = …;`); {_FMU}",
    ),
    (
        "current-value dependency cycle",
        "a when-clause reads a variable that it assigns itself",
        f"Read its value before the event, `pre(name)`; {_FMU}",
    ),
    (
        "externalobject owner",
        "an external object of a library of its own",
        f"Write what its C code computes in Modelica, or let it be an input of the recording; {_FMU}",
    ),
    (
        "unresolved flat reference",
        "an equation for a component that its condition leaves out, or one between whole records, as Complex "
        "numbers",
        "Put the equation of a conditional component into its class (connections to it may stay), and write "
        f"one for each part of a record (`v.re = …; v.im = …;`); {_FMU}",
    ),
)

_LIMITS = (
    ("expected Real, found Integer", "an Integer where a Real is wanted: write 1.0 for 1"),
    (
        "expression shape mismatch",
        "a slice of an array of components (`connect(c[1:n-1].p, d.p)`: write a for-loop over `c[i].p`), "
        "values that do not fit where they stand (three for an array of two, 1.5 for an Integer), or a "
        "parameter that is computed by a function of arrays or tables",
    ),
    (
        "non-guarded nested return",
        "a function that returns from within a loop or a branch (`return` inside `for`, behind which more "
        "follows): let a variable hold the result, and leave the loop by `break`",
    ),
    (
        "`record-array member slice`",
        "a member of all elements of an array of records (`z.re` of `Complex z[n]`): write a for-loop over "
        "`z[i].re`",
    ),
    ("`record constructor`", "a record that a function makes: let the function return its parts"),
    (
        "numeric expression, found Record",
        "an equation between whole records, as Complex numbers with operators: write one for each part "
        "(`v.re = …; v.im = …;`)",
    ),
    (
        "requires scalar assignments",
        "it assigns arrays, has a loop, or calls a function with several results",
    ),
    (
        "element assignments must cover",
        "a Boolean, Integer or enumeration array of which an element has no equation (is an input connected "
        "to nothing?), or several",
    ),
    ("impure call context", "an impure function, as one that draws random numbers"),
    ("function value type", "a function of an external object (code in C)"),
    ("function shape proof", "a function whose arrays have sizes that follow from its inputs"),
    (
        "`array comprehension domain`",
        "an array that is built over a range whose end is computed (`{… for k in 1:n}`): write the end as a "
        "number, or the elements one by one",
    ),
    (
        "event tensor loop",
        "an array that an algorithm assigns element by element in a loop: assign every element by a line of "
        "its own, or write equations",
    ),
    (
        "statement without a checked DAE owner",
        "has a loop without a known number of rounds (`while`, or a `for` over a range that is computed), or "
        "calls such a function",
    ),
)


def _mistaken(array: str, around: str, inside: str, where: str) -> ModelError:
    """The compiler takes the array of the class around for what has its name in a class inside."""
    return BeyondCompiler(
        "model-compile",
        f"`{array}` is an array in `{around}` and something else in the class `{inside}` inside of it, and "
        "the compiler that is built in takes one for the other. The model may well be right",
        where=where,
        remedy=f"Call one of them otherwise, or put the class `{inside}` in front of `{around}`.",
    )


def _hidden_array(text: bytes, class_name: str) -> tuple[str, str, str] | None:
    """An array of values in a class which has the name of a component that is none in a class inside: its
    name, and those of the two classes. None where there is none."""
    heads = [head for head in class_heads(text) if not head.is_short]
    outer = next((head for head in heads if head.name == class_name), None)
    arrays = () if outer is None else _value_arrays(class_tokens(text, outer))
    for head in heads if arrays else ():
        if head.name.startswith(f"{class_name}."):
            own = next((word for word in _declared(class_tokens(text, head)) if word in arrays), None)
            if own is not None:
                return own, class_name, head.name.rpartition(".")[2]
    return None


def _declared(words: Sequence[Token]) -> Iterable[str]:
    """The names behind another name in a class, outside of brackets, without those of arrays: of components,
    and words of the language."""
    for i, depth in islice(depths(words), 1, None):
        is_array = i + 1 < len(words) and words[i + 1].text == "["
        if depth == 0 and words[i].kind == words[i - 1].kind == "name" and not is_array:
            yield words[i].text


def _value_arrays(words: Sequence[Token]) -> set[str]:
    """The parameters and constants of a class that are declared as arrays, `parameter Real L[2]`."""
    found = set()
    for i, depth in depths(words):
        if depth == 0 and words[i].text in ("parameter", "constant"):
            at = name_end(words, i + 1)
            if at + 1 < len(words) and words[at + 1].text == "[":
                found.add(words[at].text)
    return found


def _limit(said: str) -> str:
    """What of the model is beyond the compiler, in words of the language; its own where none are known."""
    return next((words for phrase, words in _LIMITS if phrase in said), said)


def _plain(message: str) -> str:
    """The compiler's message without the names of its phases and without its repetition."""
    first = message.splitlines()[0]
    return re.sub(r"^.*?failed in \w+: ", "", re.sub(r"^\S+ could not be compiled: ", "", first))


def _not_in_library(message: str, path: Path, text: bytes, libraries: Iterable[Path]) -> ModelError | None:
    """A class that is missing in a library that was read: another version of it may have it."""
    for phrase in ("unresolved type", "base class not found"):
        if phrase not in message:
            continue
        name = _name_after(phrase, message)
        first = name.partition(".")[0]
        for library in libraries:
            if first == name or library.name.partition(" ")[0] != first or _declares(library, name):
                continue
            near = (
                "" if ".SIunits." not in name else " Modelica.SIunits is Modelica.Units.SI since version 4.0."
            )
            return ModelError(
                "model-unknown-class",
                f"class `{name}` is not in the library {first} that was read, {library}",
                where=_place_of_name(path, text, name.split(".")) or str(path),
                remedy=f"Check its spelling, or put the version of {first} that the text was written for "
                f"beside it: `uses` chooses among them.{near}",
            )
    return None


def is_missing_in_library(problem: ModelError) -> bool:
    """Whether the error is that of a class that a library does not declare."""
    return problem.code == "model-unknown-class" and "is not in the library" in problem.what


def _declares(library: Path, name: str) -> bool:
    """Whether a class stands in the files of a library, by the path that its name describes."""
    place, parts = library, name.split(".")[1:]
    for i, part in enumerate(parts):
        if (place / part / "package.mo").is_file():
            place = place / part
            continue
        own = place / f"{part}.mo"
        file, rest = (own, parts[i + 1 :]) if own.is_file() else (place / "package.mo", parts[i:])
        if not rest:
            return True
        kinds = r"(?:class|model|block|package|function|record|connector|type|operator)"
        declared = re.compile(rf"\b{kinds}\s+{re.escape(rest[-1])}\b")
        return (
            file.is_file() and declared.search(file.read_text(encoding="utf-8", errors="replace")) is not None
        )
    return True


def _syntax(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    return syntax_fault(path, text)


_RESERVED = re.compile(
    "algorithm|and|annotation|block|break|class|connect|connector|constant|constrainedby|der|discrete|each|else|"
    "elseif|elsewhen|encapsulated|end|enumeration|equation|expandable|extends|external|false|final|flow|for|"
    "function|if|import|impure|in|initial|inner|input|loop|model|not|operator|or|outer|output|package|parameter|"
    "partial|protected|public|pure|record|redeclare|replaceable|return|stream|then|true|type|when|while|within"
)


def syntax_fault(path: Path, text: bytes) -> ModelError | None:
    """The first place where the text is no Modelica, if there is one."""
    strange = next((token for token in tokens(text) if token.kind == "other" and token.text > "~"), None)
    if strange is not None:
        return ModelError(
            "model-syntax",
            "a letter outside of ASCII stands in a name",
            where=place_of(str(path), text, strange.start),
            remedy="Names are made of a to z, A to Z, digits and _: write ae for ä and so on. Comments and "
            "texts may hold any letters.",
        )
    for diagnostic in _diagnostics(path, text):
        if diagnostic.rule != "syntax-error":
            continue
        word = _reserved_class(text)
        if word is not None:
            where = place_of(str(path), text, word.start)
            said = f"unexpected `{word.text}`"
            return ModelError("model-syntax", said, where=where, remedy=_no_name(word.text))
        shown = diagnostic.message
        position = _POSITION.search(shown)
        where = Place(str(path))
        if position:
            where = place_told(str(path), text, int(position[1]), int(position[2]))
        what = re.search(r"×\s*(.+(?:\n\s+│ .+)*)", shown)
        expected = re.search(r"help: (expected.+?)(?:\n\s*\n|\Z)", shown, re.DOTALL)
        remedy = _expected(" ".join(expected[1].split()) if expected else "")
        said = re.sub(r"\s*\n\s+│\s*", " ", what[1]) if what else "syntax error"
        if "End name" in said:
            remedy = "Write the same name behind `model` and behind `end`."
        reserved = _reserved_name(said, text, where)
        if reserved:
            remedy = _no_name(reserved)
        return ModelError("model-syntax", said, where=where, remedy=remedy)
    return None


def _reserved_class(text: bytes) -> Token | None:
    """The reserved word by which a class is declared (`function flow`), if there is one. The parser stumbles
    over the word before it, or far behind it. `model extends M` is Modelica."""
    found = list(tokens(text))
    return next(
        (
            word
            for kind, word in pairwise(found)
            if kind.kind == "name" and kind.text in KINDS and _RESERVED.fullmatch(word.text)
            if word.text not in {"extends", *KINDS}
        ),
        None,
    )


def _no_name(word: str) -> str:
    return f"`{word}` is a word of the language and cannot name anything: write `{word}_`."


def _reserved_name(said: str, text: bytes, where: Place) -> str:
    """The reserved word that the parser met where a name is declared (`Real flow(unit = "1");`): a name
    or a bracket stands before it and what follows a name behind it. Empty where it is something else."""
    unexpected = re.fullmatch(r"unexpected `(\w+)`", said)
    if unexpected is None or not _RESERVED.fullmatch(unexpected[1]) or where.line is None:
        return ""
    line = text.decode("utf-8", "replace").splitlines()[where.line - 1]
    is_declared = re.search(rf"[\w\]]\s+{unexpected[1]}\s*([(;=,\[\"]|$)", line)
    return unexpected[1] if is_declared else ""


def _expected(said: str) -> str:
    """What the parser expected. Where a declaration or equation could go on or end it names every operator,
    which helps nobody."""
    if not said:
        return "Check the line before, too: a `;` may be missing."
    words = said.partition(": ")[2].split(", ")
    if len(words) > MOST_EXPECTED and ";" in words:
        return "A `;`, a `,` or an operator is expected before it, perhaps on the line before."
    return said


def _diagnostics(path: Path, text: bytes) -> list[rumoca.Diagnostic]:
    try:
        return list(rumoca.validate_source(text.decode("utf-8"), filename=path.name))
    except Exception:  # validation is a second opinion only; the first message stands
        return []


def _balance(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    found = _BALANCE.search(message)
    return Unbalanced(int(found[1]), int(found[2]), str(path)) if found else None


_MESSAGE_OF_IMPORT = (
    "Imports are not inherited: repeat that of the class which is extended, or write `{}`."  # MLS 13.2.1
)


def _unknown(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    """A class or a component that is nowhere declared. Members of a component of an unknown class are unknown
    too: then it is the class that counts."""
    for phrase in ("unresolved type", "base class not found"):
        if phrase in message:
            name = _name_after(phrase, message)
            full = imported(list(tokens(text)), name)
            beyond = full != name and _is_in_library(full)  # another class has the import
            near = (
                []
                if beyond or full.startswith(STANDARD)
                else _library_neighbours(full) or _near(name, _class_names(text))
            )
            remedy = (
                (_MESSAGE_OF_IMPORT.format(full) if beyond else "")
                or _own_name(full)
                or ("" if near else _said_members(full))
                or "Check its spelling, or give its library's folder by -L or MODELICAPATH."
            )
            return _not_known("model-unknown-class", "class", name, near, remedy, path, text)
    for phrase in ("unresolved component", "unresolved function"):
        if phrase in message:
            name = _name_after(phrase, message)
            own = _own_name(imported(list(tokens(text)), name))
            names = sorted({token.text for token in tokens(text) if token.kind == "name"})
            near = [] if own else _near(name, names)
            remedy = own or "Declare it, or check its spelling."
            return _not_known("model-unknown-name", "name", name, near, remedy, path, text)
    return None


def _own_name(name: str) -> str:
    """The remedy for a name of the Modelica Standard Library, which daest does not bring: the class of its
    own library in that place, where there is one. Empty for any other name."""
    if not name.startswith(STANDARD):
        return ""
    elsewhere = "give the folder of the Modelica Standard Library by -L or MODELICAPATH"
    within, _, last = name.rpartition(".")
    if within == "Modelica.Math" and last in BUILT_IN:
        return f"Write `{last}`, which the language has, or {elsewhere}."
    own = "Daest." + name.removeprefix(STANDARD).replace("SIunits.", "Units.SI.")
    near = [own] if _is_in_library(own) else _library_neighbours(own)
    if not near:
        return f"It is of the Modelica Standard Library: {elsewhere}."
    return f"Write {' or '.join(f'`{one}`' for one in near)}, which daest brings, or {elsewhere}."


def _is_in_library(name: str) -> bool:
    """Whether the bundled library has the class, in a file of its own or inside a package."""
    try:
        path = library_root().joinpath(*name.split("."))
    except ModelError:
        return False
    if path.is_dir() or path.with_suffix(".mo").is_file():
        return True
    package = path.parent / "package.mo"
    declared = rf"\b(?:type|connector|model|function|constant [\w.]+)\s+{re.escape(path.name)}\b"
    return package.is_file() and re.search(declared, package.read_text(encoding="utf-8")) is not None


def _name_after(phrase: str, message: str) -> str:
    quoted = _QUOTED.search(message[message.index(phrase) :])
    return quoted[1] if quoted else "?"


def _near(name: str, known: Iterable[str]) -> list[str]:
    """Names like `name`, or like its first part: of a.b the text may know a alone."""
    first, _, rest = name.partition(".")
    others = {other for other in known if other not in (name, first)}
    return near_names(name, others, 2) or [
        f"{other}.{rest}" for other in near_names(first, others, 2) if rest
    ]


def _not_known(
    code: str, kind: str, name: str, near: list[str], remedy: str, path: Path, text: bytes
) -> ModelError:
    if near:
        remedy = f"Did you mean {' or '.join(f'`{other}`' for other in near)}? {remedy}"
    where = _place_of_name(path, text, name.split("."))
    return ModelError(code, f"{kind} `{name}` is not known", where=where or str(path), remedy=remedy)


def _place_of_name(path: Path, text: bytes, parts: list[str]) -> Place | None:
    """Where the dotted name stands for the first time, or else its first part."""
    words = list(tokens(text))
    dotted = [word for part in parts for word in (part, ".")][:-1]
    for i in range(len(words)):
        if [word.text for word in words[i : i + len(dotted)]] == dotted:
            return place_of(str(path), text, words[i].start)
    return _first_place(path, text, lambda token: token.text == parts[0])


def _library_neighbours(name: str) -> list[str]:
    """Classes of the bundled library that are called nearly like `name`, where it leaves the library."""
    parts = name.split(".")
    depth, members = _left_library(parts)
    near = near_names(parts[depth], members, 2)
    return [".".join([*parts[:depth], member, *parts[depth + 1 :]]) for member in near]


def _said_members(name: str) -> str:
    """What the bundled library holds in the package of a class that it does not hold, as a sentence; empty
    where that is not a package of its own."""
    parts = name.split(".")
    depth, members = _left_library(parts)
    if not depth or depth < len(parts) - 1:
        return ""
    return f"{'.'.join(parts[:-1])} holds {', '.join(sorted(members))}."


def _left_library(parts: Sequence[str]) -> tuple[int, list[str]]:
    """How many of the parts of a name are packages of the bundled library, and what the last of these
    holds."""
    try:
        folder = library_root()
    except ModelError:
        return 0, []
    depth = 0
    while depth < len(parts) - 1 and (folder / parts[depth]).is_dir():
        folder, depth = folder / parts[depth], depth + 1
    held = {entry.stem for entry in folder.iterdir() if entry.is_dir() or entry.suffix == ".mo"}
    package = folder / "package.mo"
    declared = package.read_text(encoding="utf-8") if package.is_file() else ""
    return depth, sorted((held | set(_DECLARED_TYPE.findall(declared))) - {"package"})


def _class_names(text: bytes) -> list[str]:
    names = [head.name for head in class_heads(text)]
    return [*names, *(name.rpartition(".")[2] for name in names)]


def _first_place(path: Path, text: bytes, wanted: Callable[[Token], bool]) -> Place | None:
    return next((place_of(str(path), text, token.start) for token in tokens(text) if wanted(token)), None)


def _types(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    if "failed in Typecheck" not in message:
        return None
    said = message.partition("failed in Typecheck: ")[2]
    first = said.split("; ")[0]
    position = re.search(r"\s*\[([^\[\]]*):(\d+):(\d+)\]\s*$", first)
    where: Place | str = str(path)
    if position:
        is_own = Path(position[1]).name == path.name
        line, column = int(position[2]), int(position[3])
        where = place_told(str(path), text, line, column) if is_own else Place(position[1], line, column)
        first = first[: position.start()]
    remedy = "Make both sides of the same type and size."
    if "invalid unit" in first:
        remedy = 'Write units as in "N.m/s", "1/K" or "m2"; what has none, as a percentage, has the unit "1".'
    if "unknown modifier" in first:
        remedy = "Check its spelling; what is redeclared in the place of the class must have it, too."
    return ModelError("model-type", first, where=where, remedy=remedy)


def _der_expression(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    if "derivative expression" not in message:
        return None
    where = next((place_of(str(path), text, token.start) for token in _der_of_expressions(text)), str(path))
    return ModelError(
        "model-der-expression",
        "der() differentiates an expression",
        where=where,
        remedy="Introduce a variable for the expression and differentiate that variable.",
    )


def _der_of_expressions(text: bytes) -> Iterable[Token]:
    """Every `der` whose argument holds an operator."""
    words = list(tokens(text))
    for i, token in enumerate(words[:-1]):
        if token.text != "der" or words[i + 1].text != "(":
            continue
        for inner in words[i + 2 :]:
            if inner.text == ")":
                break
            if inner.kind == "number" or inner.text in "+-*/^(":
                yield token
                break


_FUNCTION = re.compile(r"`function [\w ]+`: `([\w.]+)` (.+)")


def _unsupported(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    """Constructs that the compiler does not take, found in the text by their keyword."""
    function = _FUNCTION.search(message)
    if function:
        return _function(function[1], function[2], path, text)
    for phrase, keyword, what in _CONSTRUCTS:
        if phrase in message:
            where = _first_place(path, text, lambda token: token.text == keyword)  # noqa: B023
            kind = RefusedAlgorithm if keyword == "algorithm" else ModelError
            return kind(
                "model-unsupported",
                f"{what} is not supported: {_limit(_plain(message))}",
                where=where or str(path),
                remedy="Write it as equations between continuous variables.",
            )
    return None


CLOCKED_REMEDY = (
    "Write the sampled part as `when sample(0, {period}) then … end when;` around its equations, there "
    "pre(x) for previous(x), {period} for interval(x), and x itself for sample(x, …) and hold(x), which "
    "keeps its value between samples; or take Modelica.Blocks.Discrete; or export the model by your own "
    "tool as an FMU, which all commands take."
)
_CLOCK_FORM = (
    "Declare the clock, `Clock c = Clock({period});`, and write the clocked equations inside of "
    "`when c then … end when;` or with sample(x, c) as the whole right side of an equation. "
)
_CLOCKED = ("Clock", "previous", "subSample", "superSample", "shiftSample", "backSample", "noClock")


def _clocked(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    """Equations on a clock, where the user's own text has them."""
    if "failed in ToDae" not in message and "clock" not in message:
        return None
    found = list(tokens(text))
    calls = [
        i
        for i, (token, following) in enumerate(pairwise(found))
        if token.kind == "name" and token.text in _CLOCKED and following.text == "("
    ]
    if not calls:
        return None
    periods = [found[i + 2].text for i in calls if found[i].text == "Clock" and found[i + 2].kind == "number"]
    return RefusedClock(
        "model-unsupported",
        f"`{found[calls[0]].text}(…)`: equations on a clock are not supported in this form",
        where=place_of(str(path), text, found[calls[0]].start),
        remedy=(_CLOCK_FORM + "Or: " + CLOCKED_REMEDY).format(period=periods[0] if periods else "period"),
    )


# What the compiler's message contains, the keyword to look for, and what it is.
_CONSTRUCTS = (
    ("`pre expression`", "pre", "`pre`"),
    ("model algorithm", "algorithm", "an algorithm section with loops or calls"),
    ("initial algorithm", "algorithm", "an initial algorithm"),
    ("when-", "when", "`when`"),
)


def _function(name: str, why: str, path: Path, text: bytes) -> ModelError:
    short = name.rpartition(".")[2]
    heads = [head for head in class_heads(text) if head.name.rpartition(".")[2] == short]
    return RefusedFunction(
        name,
        f"function `{name}` cannot be executed: it {_limit(why)}",
        place_of(str(path), text, heads[0].start) if heads else str(path),
        "Assign every output; use for-loops over one constant range; no `while`, `break` or `return`.",
    )


def _layout(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    """A folder of libraries of which files are missing: the first of the files that the compiler names."""
    found = _LAYOUT.search(message)
    if found is None:
        return None
    folder, file, own, expected = found.groups()
    count = len(re.findall("but expected `within", message))
    return ModelError(
        "model-compile",
        f"the library in {folder} is not whole: {file} says `within {own};`, but lies where "
        f"`within {expected};` is expected{f', and so do {count - 1} more files' if count > 1 else ''}",
        where=str(path),
        remedy="look whether every folder of the library has its package.mo; give the folder that holds the "
        "library's own folder by -L or MODELICAPATH",
    )


def _missing_class(message: str, path: Path, text: bytes, class_name: str) -> ModelError | None:
    if "resolve/parse failed" not in message:
        return None
    return unknown_class(class_name, path, text)


def unknown_class(name: str, path: Path, text: bytes) -> ModelError:
    """There is no class of that name in the file, or it is none that has equations; or the file is broken."""
    fault = syntax_fault(path, text)
    if fault is not None:
        return fault
    heads = class_heads(text)
    for head in heads:
        if head.name == name and not head.is_model:
            kind = "partial " + head.kind if head.is_partial else head.kind
            return not_a_model(name, kind, place_of(str(path), text, head.start))
    models = [head.name for head in heads if head.is_model]
    hint = did_you_mean(name, models, 1)
    listed = f"The file has: {', '.join(models)}." if models else "The file has no model."
    return ModelError(
        "model-unknown-class", f"there is no model `{name}` in {path}", where=str(path), remedy=hint + listed
    )


def not_a_model(name: str, kind: str, where: Place | str) -> ModelError:
    return ModelError(
        "model-kind",
        f"`{name}` is a {kind}, which has no equations of its own",
        where=where,
        remedy="Name a model that is complete: one that is neither partial nor a package, function or type.",
    )
