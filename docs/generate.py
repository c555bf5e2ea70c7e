"""What MkDocs needs of this site beside its pages: reference from the code, numbers of the study, formulas.

The pages below `reference/` exist only in the site. `theory.md`, `trust.md` and `machines.md` are templates,
filled with the limits of the code, the rates of the studies and the machines of `machines.toml`. Formulas
become MathML, which browsers draw without a script.
"""

from __future__ import annotations

import gc
import html
import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import click
import jinja2
from latex2mathml.converter import convert
from markdown.extensions.toc import slugify
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import daest
from daest.cli.main import COMMANDS, cli
from daest.cli.schema import schema_names, schema_of
from daest.data.limits import DATA
from daest.data.project import KEYS
from daest.diagnosis.answers import formulas
from daest.diagnosis.evidence import open_loop, pieces, unseen
from daest.diagnosis.gates import GATES
from daest.errors import EXPLANATIONS
from daest.estimation.gates import FIT
from daest.model.effects import Effect
from daest.modelica.effects.catalogue import effect_library
from daest.systems.tolerances import SOLVER

# Objects made between two looks of the garbage collector: all sources are read, and with 700 the site
# takes a quarter longer.
gc.set_threshold(50_000, 50, 50)

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
# Pictures of the start page, which the examples keep.
PICTURES = {"speed": "servo/speed.png", "staircase": "servo_hidden/staircase.png"}
RATES = Path(__file__).with_name("rates.json")
BLACK_BOX_RATES = Path(__file__).with_name("black_box_rates.json")
WRONG_RATES = Path(__file__).with_name("wrong_models_rates.json")
MACHINES = Path(__file__).with_name("machines.toml")
# How an answer is judged, in the order of the counts; a first answer may besides be "not right".
JUDGED = ("right", "honest", "wrong", "open", "no answer")
TEMPLATES = ("machines.md", "theory.md", "trust.md")
REPOSITORY = re.compile(r"`([\w-]+/[\w.-]+)`")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
TAG = re.compile(r"\\tag\{(.*?)\}")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference and the schemas."""
    pages = {
        "commands": commands(),
        "project": project_keys(),
        "messages": messages(),
        "effects": effects(),
        "python": public_names(),
        "json": schemas(),
    }
    for name, text in pages.items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    for name, path in PICTURES.items():
        files.append(File.generated(config, f"pictures/{name}.png", abs_src_path=str(EXAMPLES / path)))
    for name in schema_names():
        content = json.dumps(schema_of(name), indent=2, ensure_ascii=False)
        files.append(File.generated(config, f"reference/schemas/{name}.json", content=content))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    return filled(markdown) if page.file.src_uri in TEMPLATES else markdown


def on_page_content(content: str, **_: Any) -> str:
    return FORMULA.sub(_formula, content)


# Pages ------------------------------------------------------------------------------------------------------


def commands() -> str:
    """What every command does, its options and its example, as its own help says."""
    lines = [
        "# Commands",
        "",
        "Every command ends with 0 (done), 1 (a check failed) or 2 (could not do it).",
        "",
    ]
    group = cli.make_context("daest", [], resilient_parsing=True)
    for name in COMMANDS:
        command = cli.get_command(group, name)
        assert command is not None
        lines += command_entry(command.make_context(name, [], parent=group, resilient_parsing=True))
    return "\n".join(lines)


def command_entry(context: click.Context) -> Iterator[str]:
    command = context.command
    options = [p for p in command.params if isinstance(p, click.Option)]
    records = [record for p in options if (record := p.get_help_record(context))]
    paragraphs = (command.help or "").replace("\b", "").split("\n\n")
    yield from (
        f"## {context.info_name}",
        "",
        "```text",
        command.get_usage(context).removeprefix("Usage: "),
        "```",
        "",
    )
    yield "\n\n".join(escaped(paragraph) for paragraph in paragraphs)
    yield from (
        "",
        *table(("option", "what it does"), [(f"`{o}`", escaped(text)) for o, text in records]),
        "",
    )
    example = (command.epilog or "").partition("Example:")[2]
    yield from ("```sh", *(line.strip() for line in example.strip().splitlines()), "```", "")


def project_keys() -> str:
    """The keys of daest.toml by section."""
    lines = [
        "# daest.toml",
        "",
        "`daest init MODEL DATA` writes one with comments. Options on the command line come before it."
        " Paths count from its folder; values are in the units of the model.",
        "",
    ]
    for section, keys in KEYS.items():
        entries = (
            "" if section in ("model", "data") else ": `name = { key = value, … }`, names as in the model"
        )
        lines += ["", f"## [{section}]", "", *([f"Entries{entries}.", ""] if entries else [])]
        lines += table(("key", "what it says"), [(f"`{key}`", text) for key, text in keys.items()])
    return "\n".join(lines)


def messages() -> str:
    """Every message code with its explanation."""
    lines = [
        "# Messages",
        "",
        "The code stands in brackets behind `error` or `warning`; `daest explain CODE` says the same.",
        "",
    ]
    for first, codes in groupby(sorted(EXPLANATIONS), key=lambda code: code.partition("-")[0]):
        lines += [f"## {first}", ""]
        for code in codes:
            lines += [f"### {code}", "", escaped(EXPLANATIONS[code]), ""]
    return "\n".join(lines)


def effects() -> str:
    """The effect library by domain."""
    lines = [
        "# Effects",
        "",
        "Physics that a model may lack. `daest effects NAME --model MODEL` says where one can sit,"
        " [your own](../how-to/effect.md) is a Modelica class.",
        "",
    ]
    for domain, members in groupby(effect_library(), key=lambda effect: effect.domain):
        lines += [f"## {domain.capitalize()}", ""]
        for effect in members:
            lines += effect_entry(effect)
    return "\n".join(lines)


def effect_entry(effect: Effect) -> Iterator[str]:
    yield from (
        f"### {effect.name}",
        "",
        f"{escaped(effect.description)}. {escaped(effect.documentation)}",
        "",
    )
    yield from (f"`{effect.law}`", "")
    rows = [(f"`{p.name}`", p.role, p.unit, escaped(p.description)) for p in effect.parameters]
    yield from table(("parameter", "role", "unit", "meaning"), rows)
    yield ""


def public_names() -> str:
    """All public names; mkdocstrings reads signatures and docstrings."""
    lines = [
        "# Python",
        "",
        "`import daest` offers the steps of the commands as functions, from one value to the next;"
        " `examples/servo/tutorial.ipynb` walks through them.",
        "",
    ]
    for name in daest.__all__:
        lines += [f"::: {getattr(daest, name).__module__}.{name}", ""]
    return "\n".join(lines)


def schemas() -> str:
    """Top-level keys of what each command prints with --format json."""
    lines = [
        "# JSON",
        "",
        "With `--format json` a command prints one document. Keys that its schema requires stay; others may"
        " be added. Missing is null.",
        "",
    ]
    for name in schema_names():
        schema = schema_of(name)
        definitions = schema["$defs"]
        rows = [(f"`{key}`", kind(entry, definitions)) for key, entry in schema["properties"].items()]
        lines += [f"## {name}", "", f"{escaped(schema['title'])} ([schema](schemas/{name}.json)).", ""]
        lines += [*table(("key", "holds"), rows), ""]
    return "\n".join(lines)


def kind(entry: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """A schema's entry in a few words; `definitions` are those that it may refer to."""
    if "$ref" in entry:
        return kind(definitions[str(entry["$ref"]).rpartition("/")[2]], definitions)
    if "const" in entry:
        return f"`{json.dumps(entry['const'])}`"
    if "enum" in entry:
        return ", ".join(f"`{json.dumps(value)}`" for value in entry["enum"])
    if "anyOf" in entry:
        return " or ".join(dict.fromkeys(kind(each, definitions) for each in entry["anyOf"]))
    types = entry.get("type", "anything")
    text = " or ".join([types] if isinstance(types, str) else types)
    inner = entry.get("properties", {})
    if inner:
        return f"{text} of " + ", ".join(f"`{key}`" for key in inner)
    if isinstance(entry.get("items"), dict) and "array" in text:
        return f"{text} of {kind(entry['items'], definitions)}"
    if isinstance(entry.get("additionalProperties"), dict):
        return f"{text} by name: {kind(entry['additionalProperties'], definitions)}"
    return text


# Machines ---------------------------------------------------------------------------------------------------


def machines() -> dict[str, Any]:
    """The tables of machines.md: counts, one for each section, and what was taken together."""
    kept = tomllib.loads(MACHINES.read_text(encoding="utf-8"))
    sections = []
    counts = []
    for section in kept["section"]:
        rows = [row for row in kept["row"] if row["section"] == section["id"]]
        counts.append((f"[{section['title']}](#{slugify(section['title'], '-')})", *counted(rows)))
        head = ("machine", "known to be missing", "what daest says", "error on unseen data", "judged")
        lines = table(head, [machine_row(row) for row in rows])
        sections.append({**section, "counted": counts_told(rows), "table": "\n".join(lines)})
    counts.append(("all", *counted(kept["row"])))
    batches = [(batch["name"], batch["first"], batch["since"]) for batch in kept["batch"]]
    return {
        "sections": sections,
        "counts": "\n".join(table(("", "rows", *JUDGED, "first answer told", "right at first"), counts)),
        "batches": "\n".join(table(("machines", "at first", "now"), batches)),
        "n_rows": len(kept["row"]),
        "wrong": "; ".join(f"[{r['machine']}](#{r['id']})" for r in kept["row"] if r["judged"] == "wrong"),
    }


def machine_row(row: Mapping[str, str]) -> tuple[str, ...]:
    """The cells of a machine; its id is an anchor."""
    source = REPOSITORY.sub(r"[`\1`](https://github.com/\1)", row.get("source", ""))
    said = f". *At first: {row['first_said']}.*" if "first_said" in row else ""
    judged = [row["judged"]]
    if "first" in row:
        judged.append("at first, too" if row["first"] == row["judged"] else f"at first {row['first']}")
    if "time" in row:
        judged.append(row["time"])
    return (
        f'<a id="{row["id"]}"></a>{row["machine"]}' + (f"<br>{source}" if source else ""),
        row["missing"],
        row["says"] + said,
        row.get("error", ""),
        "; ".join(judged),
    )


def counted(rows: list[Mapping[str, str]]) -> tuple[str, ...]:
    """Rows, how they are judged, first answers that are told, and those that were right."""
    judged = Counter(row["judged"] for row in rows)
    first = [row["first"] for row in rows if "first" in row]
    numbers = (len(rows), *(judged[word] for word in JUDGED), len(first), first.count("right"))
    return tuple(str(number) for number in numbers)


def counts_told(rows: list[Mapping[str, str]]) -> str:
    """The same in a sentence."""
    n, *judged, n_first, n_right = counted(rows)
    words = [f"{k} {word}" for k, word in zip(judged, JUDGED, strict=True) if k != "0"]
    first = f" First answers are told for {n_first}, {n_right} of them right." if n_first != "0" else ""
    return f"{n} rows: {', '.join(words)}.{first}"


# Text -------------------------------------------------------------------------------------------------------


def filled(markdown: str) -> str:
    """A template with the rates of the studies and the limits of proof and tests of the code."""
    files = (RATES, BLACK_BOX_RATES, WRONG_RATES)
    rates, box, wrong = (json.loads(file.read_text(encoding="utf-8")) for file in files)
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined, comment_start_string="{##", autoescape=False
    )
    template = environment.from_string(markdown)
    return template.render(
        rates=rates,
        box=box,
        wrong=wrong,
        machines=machines(),
        gates=GATES,
        formulas=formulas,
        thresholds=(
            ("fit", FIT, "estimation/gates.txt"),
            ("solver", SOLVER, "systems/tolerances.txt"),
            ("data", DATA, "data/limits.txt"),
        ),
        unseen=unseen,
        pieces=pieces,
        open_loop=open_loop,
        data=DATA,
        percent=percent,
    )


def percent(share: float) -> str:
    """A share with two figures and a space that does not break."""
    return f"{100.0 * share:.{0 if share >= 0.0995 or not share else 1}f}\u00a0%".replace(
        ".0\u00a0", "\u00a0"
    )


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """A Markdown table, empty without rows."""
    lines = [head, ("---",) * len(head), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines] if rows else []


def escaped(text: str) -> str:
    """Plain text as Markdown that shows it."""
    return re.sub(r"[&*_<>\[\]$\\`|]", lambda match: f"&#{ord(match[0])};", " ".join(text.split()))


def _formula(match: re.Match[str]) -> str:
    tex = html.unescape(match[2])
    if match[1] == "span":
        return convert(tex)
    number = TAG.search(tex)
    shown = convert(TAG.sub("", tex).strip(), display="block")
    return (
        f'<div class="formula">{shown}'
        + (f'<span class="number">({number[1]})</span>' if number else "")
        + "</div>"
    )
