"""The house: rooms import downwards only, no file imports itself round a corner, and each name is imported
from the file that defines it."""

import ast
import re
from collections.abc import Iterable, Mapping
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

import daest

PACKAGE = Path(daest.__file__).parent
ROOT = Path(__file__).resolve().parents[1]
TESTS = Path(__file__).resolve().parent

# From the ground up. Rooms on one floor do not know each other.
FLOORS = (
    ("errors", "files", "cache", "near", "lists", "quantities", "machine"),
    ("model",),
    ("numerics",),
    ("modelica", "systems"),
    ("fmu", "data"),
    ("estimation",),
    ("design",),
    ("diagnosis",),
    ("report",),
    ("app",),
    ("cli",),
    ("front",),
    ("__main__",),
)
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
# Files on the ground lean on each other: units are checked with errors.
GROUND = 0


# The parts of statements that hold statements: of `try` and `match`, too.
BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")


@cache
def files() -> dict[str, Path]:
    """Every module of the package by its name."""
    names = {p: ("daest", *p.relative_to(PACKAGE).with_suffix("").parts) for p in PACKAGE.rglob("*.py")}
    return {".".join(parts).removesuffix(".__init__"): path for path, parts in names.items()}


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(files()[module].read_text(encoding="utf-8"))


@cache
def imports(module: str) -> list[ast.Import | ast.ImportFrom]:
    """At whatever depth; of the tree only the statements are looked at."""
    found, waiting = [], list(tree(module).body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for part in BLOCKS:
            waiting += getattr(node, part, ())
    return sorted(found, key=lambda node: node.lineno)


@cache
def arrows() -> dict[str, dict[str, int]]:
    """What each module imports of the package, at whatever depth, with the line; `import daest` apart, which
    loads nothing."""
    return {name: dict(_imports(name)) for name in files()}


def _imports(module: str):
    for node in imports(module):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: a relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield from _own(whole if whole in files() else str(node.module), node.lineno)
        else:
            for alias in node.names:
                yield from _own(alias.name, node.lineno)


def _own(name: str, line: int):
    if name.startswith("daest."):
        yield name, line


def room(module: str) -> str:
    return module.split(".")[1]


def test_the_page_names_the_rooms_and_only_files_that_there_are():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", page.split("## Folders")[0], re.MULTILINE)
    named = [re.findall(r"`(\w+)`", row) for row in rows]
    below = FLOORS[:-1]
    assert sorted(chain(*named)) == sorted(chain(*below))
    assert [FLOOR[row[0]] for row in named] == sorted((FLOOR[row[0]] for row in named), reverse=True)
    for file in set(re.findall(r"`([a-z_]+(?:/\w+)*\.py)`", page)):
        assert (PACKAGE / file).is_file() or (ROOT / file).is_file(), file


def test_every_room_has_a_floor():
    assert {room(name) for name in files() if name != "daest"} == set(FLOOR)


def test_rooms_import_downwards_only():
    upward = [
        f"{files()[name].relative_to(PACKAGE)}:{line} imports {other}"
        for name, others in arrows().items()
        if name != "daest"
        for other, line in others.items()
        if room(name) != room(other) and not _is_below(room(other), room(name))
    ]
    assert upward == []


def _is_below(lower: str, upper: str) -> bool:
    return FLOOR[lower] < FLOOR[upper] or FLOOR[lower] == FLOOR[upper] == GROUND


def test_no_file_imports_itself_round_a_corner():
    assert circles({name: set(others) for name, others in arrows().items()}) == []


def test_folders_of_a_room_do_not_lean_on_each_other():
    """What a folder takes from the others of its room does not come back to it. Files of the room itself call
    into its folders, or are known to all of them."""
    folders: dict[str, set[str]] = {folder(name): set() for name in files() if name.count(".") == 3}
    for name in files():
        if name.count(".") == 3:
            own = folder(name)
            others = {folder(other) for other in arrows()[name] if other.count(".") == 3}
            folders[own] |= {other for other in others if other != own and room(other) == room(own)}
    assert circles(folders) == []


def test_the_page_names_the_folders_from_below():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page.split("## Folders")[1].split("## Where")[0]
    rows = re.findall(r"^\| (?:`(\w+)` )?\| `(\w+)` \|", table, re.MULTILINE)
    named, own = [], ""
    for of, name in rows:
        own = of or own
        named.append(f"daest.{own}.{name}")
    rooms = {room(name) for name in named}
    there = {folder(name) for name in files() if name.count(".") == 3}
    assert set(named) == {name for name in there if room(name) in rooms}
    upward = [
        f"{name} imports {other}"
        for name, others in arrows().items()
        for other in others
        if folder(name) in named and folder(other) in named and room(name) == room(other)
        if named.index(folder(name)) < named.index(folder(other))
    ]
    assert upward == []


def folder(module: str) -> str:
    return module.rpartition(".")[0]


@pytest.mark.parametrize(
    ("arrows", "expected"),
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}, [["a", "b", "c"]]),
        ({"a": {"b"}, "b": {"a"}, "c": {"d"}, "d": {"c", "a"}}, [["a", "b"], ["c", "d"]]),
    ],
)
def test_circles_are_found(arrows, expected):
    assert circles(arrows) == expected


def circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Files that reach themselves, those that reach each other together."""
    reached = {name: _reached(arrows, name) for name in arrows}
    rounds = {
        tuple(sorted(o for o in reached[n] if n in reached.get(o, ()))) for n in arrows if n in reached[n]
    }
    return sorted(map(list, rounds))


def test_names_come_from_the_file_that_defines_them():
    """`daest` itself apart, which names what is public."""
    astray = [
        f"{path.relative_to(PACKAGE)}:{node.lineno} imports {alias.name} by {node.module}"
        for module, path in files().items()
        for node in imports(module)
        if isinstance(node, ast.ImportFrom) and node.module in files() and path.parent != PACKAGE
        for alias in node.names
        if alias.name not in _defined(str(node.module)) and f"{node.module}.{alias.name}" not in files()
    ]
    assert astray == []


@cache
def _defined(module: str) -> frozenset[str]:
    found: set[str] = set()
    for node in tree(module).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {
                name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)
            }
    return frozenset(found)


def _reached(arrows: dict[str, set[str]], start: str) -> set[str]:
    seen: set[str] = set()
    waiting = list(arrows[start])
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting.extend(arrows.get(name, ()))
    return seen


def test_quick_files_are_there(request):
    """A file that is renamed does not leave the quick tests unseen."""
    conftest = request.config.pluginmanager.get_plugin(str(TESTS / "conftest.py"))
    for name in (*conftest.QUICK, *conftest.NOT_QUICK):
        assert (TESTS / name).is_dir() or (TESTS / f"{name}.py").is_file(), name


SHAPE = re.compile(r"\((?:[^\s(),]+|\.\.\.)(?: [-+*] [^\s(),]+)*,(?: [^(),]+(?:,|, )?)*\)|[Ss]hape")
ARRAY = re.compile(r"\bnp\.ndarray\b|\bsp\.cs[rc]_array\b")


def _told_methods(classes: Iterable[ast.ClassDef]) -> set[str]:
    """Methods whose docstring tells shapes in one class: those of the same name in others do the same."""
    return {
        f.name
        for one in classes
        for f in one.body
        if isinstance(f, ast.FunctionDef) and SHAPE.search(ast.get_docstring(f) or "")
    }


def _without_shapes(modules: Mapping[str, ast.Module]) -> list[str]:
    """Public functions with arrays in their signature where neither their docstring, nor that of their class,
    nor that of the method of a protocol tells a shape."""
    classes = [n for one in modules.values() for n in one.body if isinstance(n, ast.ClassDef)]
    told, astray = _told_methods(classes), []
    for module, found in modules.items():
        own = [(n, "") for n in found.body if isinstance(n, ast.FunctionDef)]
        for one in found.body:
            if isinstance(one, ast.ClassDef) and not one.name.startswith("_"):
                whole = ast.get_docstring(one) or ""
                own += [(f, whole) for f in one.body if isinstance(f, ast.FunctionDef) and f.name not in told]
        astray += [
            f"{module}:{f.lineno} {f.name}"
            for f, whole in own
            if not f.name.startswith("_")
            and ARRAY.search(" ".join(map(ast.unparse, _annotations(f))))
            and not SHAPE.search((ast.get_docstring(f) or "") + whole)
        ]
    return astray


def _annotations(f: ast.FunctionDef) -> list[ast.expr]:
    arguments = [*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs]
    return [a for a in (*(one.annotation for one in arguments), f.returns) if a is not None]


def test_arrays_of_public_functions_have_shapes():
    assert _without_shapes({module: tree(module) for module in files()}) == []


@pytest.mark.parametrize(
    ("docstring", "is_told"),
    [
        ("The rank.", False),
        ("The rank (see above, too).", False),
        ("The rank of A (n, m).", True),
        ("Of x (n,).", True),
        ("Of x (..., n), y (2 n + 1, n).", True),
        ("Of the same shape.", True),
    ],
)
def test_a_function_without_shapes_is_found(docstring, is_told):
    module = ast.parse(f'def rank(A: np.ndarray) -> int:\n    """{docstring}"""\n')
    assert _without_shapes({"m": module}) == ([] if is_told else ["m:1 rank"])
