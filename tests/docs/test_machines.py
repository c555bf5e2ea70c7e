"""The machines of the documentation: every row is whole and on its page, counts are those of the rows."""

import importlib.util
import re
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
NEEDED = {"id", "section", "machine", "missing", "says", "judged"}
OPTIONAL = {"source", "error", "first", "first_said", "time"}
JUDGED = {"right", "honest", "wrong", "open", "no answer"}
KEPT = tomllib.loads((DOCS / "machines.toml").read_text(encoding="utf-8"))
ROWS = KEPT["row"]


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["generate"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["generate"]


@pytest.fixture(scope="module")
def page(generate) -> str:
    return generate.filled((DOCS / "machines.md").read_text(encoding="utf-8"))


def problems(row: dict) -> list[str]:
    """What is wrong with a row."""
    found = [f"lacks {key}" for key in sorted(NEEDED - row.keys())]
    found += [f"has {key}" for key in sorted(row.keys() - NEEDED - OPTIONAL)]
    found += [f"{key} is empty or no line of a table" for key, text in row.items() if not is_cell(text)]
    if row.get("judged") not in JUDGED:
        found.append("judged by no known word")
    if "first" in row and row["first"] not in JUDGED | {"not right"}:
        found.append("first judged by no known word")
    if row.get("section") not in {section["id"] for section in KEPT["section"]}:
        found.append("of no section")
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", row.get("id", "")):
        found.append("id is no anchor")
    return found


def is_cell(text: object) -> bool:
    return (
        isinstance(text, str)
        and bool(text.strip())
        and not re.search(r"[|\n$<>]|\{\{", re.sub("->", "", text))
    )


def test_every_row_is_whole():
    assert {row.get("id"): found for row in ROWS if (found := problems(row))} == {}


def test_what_is_not_whole_is_seen():
    good = ROWS[0]
    assert problems(good) == []
    assert problems({k: v for k, v in good.items() if k != "says"}) == ["lacks says"]
    assert problems({**good, "sais": "a"}) == ["has sais"]
    assert problems({**good, "judged": "good"}) == ["judged by no known word"]
    assert problems({**good, "first": "good"}) == ["first judged by no known word"]
    assert problems({**good, "section": "moon"}) == ["of no section"]
    assert problems({**good, "id": "A b"}) == ["id is no anchor"]
    for text in ("", "a | b", "a\nb"):
        assert problems({**good, "says": text}) == ["says is empty or no line of a table"]


def test_rows_of_a_section_stand_together_in_its_order():
    assert [n for _, n in Counter(row["id"] for row in ROWS).most_common(1)] == [1]
    sections = [section["id"] for section in KEPT["section"]]
    assert list(dict.fromkeys(row["section"] for row in ROWS)) == sections
    places = [sections.index(row["section"]) for row in ROWS]
    assert places == sorted(places)


def test_every_batch_is_whole():
    anchors = {row["id"] for row in ROWS}
    for batch in KEPT["batch"]:
        assert batch.keys() == {"name", "first", "since"} and all(map(is_cell, batch.values())), batch
        for link in re.findall(r"\]\((.*?)\)", " ".join(batch.values())):
            assert link.startswith("#") and link[1:] in anchors, link


def test_every_row_stands_on_the_page(page):
    assert page.count('<a id="') == len(ROWS)
    for row in ROWS:
        (line,) = [line for line in page.splitlines() if f'<a id="{row["id"]}"></a>' in line]
        assert line.count("|") == 6
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        assert cells[0].startswith(f'<a id="{row["id"]}"></a>{row["machine"]}')
        assert row.get("source", "") in cells[0]
        assert cells[1] == row["missing"]
        assert cells[2].startswith(row["says"]) and row.get("first_said", "") in cells[2]
        assert cells[3] == row.get("error", "")
        assert cells[4].startswith(row["judged"]) and cells[4].endswith(row.get("time", ""))
        assert ("at first" in cells[4]) is ("first" in row)


def test_repositories_are_links(page):
    names = {name for row in ROWS for name in re.findall(r"`(.+?/.+?)`", row.get("source", ""))}
    assert len(names) > 20
    for name in names:
        assert f"<br>[`{name}`](https://github.com/{name}) | " in page


def test_counts_are_those_of_the_rows(page, generate):
    lines = [line.split("|")[1:-1] for line in page.splitlines() if line.startswith(("| [", "| all"))]
    table = {cells[0].strip(): [int(cell) for cell in cells[1:]] for cells in lines if len(cells) == 9}
    total = table.pop("all")
    assert len(table) == len(KEPT["section"])
    assert [sum(column) for column in zip(*table.values(), strict=True)] == total
    assert total[0] == len(ROWS) == sum(total[1:6])
    assert total[1:6] == [sum(row["judged"] == word for row in ROWS) for word in generate.JUDGED]
    assert total[6:] == [sum("first" in r for r in ROWS), sum(r.get("first") == "right" for r in ROWS)]
    for section, numbers in zip(KEPT["section"], table.values(), strict=True):
        rows = [row for row in ROWS if row["section"] == section["id"]]
        assert numbers[0] == len(rows) == sum(numbers[1:6])
        told = page.partition(f"## {section['title']}\n")[2].partition("\n| ")[0]
        assert f"{len(rows)} rows: " in told
        for word in JUDGED:
            n = sum(row["judged"] == word for row in rows)
            assert (f" {n} {word}" in told) is (n > 0)


def test_what_is_wrong_today_is_said_first(page):
    told = re.search(r"^Wrong today: (.*)\.$", page, re.MULTILINE)[1]
    assert re.findall(r"\(#([\w-]+)\)", told) == [r["id"] for r in ROWS if r["judged"] == "wrong"]


def test_words_are_explained(page):
    for word in JUDGED:
        assert f"| {word} | " in page
    text = (DOCS / "machines.toml").read_text(encoding="utf-8").partition("[[section]]")[0]
    for key in NEEDED | OPTIONAL:
        assert f"#   {key} " in text
    for word in JUDGED | {"not right"}:
        assert word in text


def test_trust_links_to_rows(generate):
    text = generate.filled((DOCS / "trust.md").read_text(encoding="utf-8"))
    assert f"{len(ROWS)} rows" in text
    links = re.findall(r"machines\.md#([\w-]+)", text)
    titles = {generate.slugify(section["title"], "-") for section in KEPT["section"]}
    assert len(links) > 10 and set(links) <= {row["id"] for row in ROWS} | titles
