"""The site: builds without a warning, has no dead link and nothing from a network, and leaves nothing out."""

import html
import inspect
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import click
import pytest

import daest
from daest.cli.main import COMMANDS, cli
from daest.cli.schema import schema_names, schema_of
from daest.data.project import KEYS
from daest.errors import EXPLANATIONS
from daest.modelica.effects.catalogue import effect_library

ROOT = Path(__file__).resolve().parents[2]
LOADED = {("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src")}


def build(source: Path, target: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "mkdocs", "build", "-f", str(source / "mkdocs.yml"), "-d", str(target)]
    muted = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, capture_output=True, text=True, env=muted, cwd=source)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    target = tmp_path_factory.mktemp("docs") / "site"
    result = build(ROOT, target)
    assert result.returncode == 0, result.stderr
    assert "WARNING" not in result.stderr
    return target


class Document(HTMLParser):
    """Links, anchors and what a page loads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.anchors |= {values[key] for key in ("id", "name") if values.get(key)}
        for key in ("href", "src"):
            if values.get(key) is not None:
                self.links.append(values[key])
                if (tag, key) in LOADED:
                    self.loaded.append(values[key])


@pytest.fixture(scope="module")
def documents(site) -> dict[Path, Document]:
    # 404.html is for servers: its addresses begin at their root.
    return {path: Document(path) for path in site.rglob("*.html") if path.name != "404.html"}


def text_of(path: Path) -> str:
    """The words of a page, tags and entities resolved."""
    body = path.read_text(encoding="utf-8").partition("<article")[2].partition("</article>")[0]
    in_lines = re.sub(r"</?(?:a|code|em|span|strong)\b[^>]*>", "", body)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", in_lines)).split())


def test_no_dead_link(documents):
    dead, checked = [], 0
    for path, document in documents.items():
        for link in document.links:
            if re.match(r"https?:|mailto:|javascript:|data:", link):
                continue
            address, anchor = urldefrag(unquote(link))
            target = (path.parent / address).resolve() if address else path
            anchors = documents[target].anchors if target in documents else {anchor}
            checked += 1
            if not target.exists() or (anchor and anchor not in anchors):
                dead.append(f"{path.name}: {link}")
    assert dead == []
    assert checked > 500


def test_nothing_is_loaded_from_a_network(documents, site):
    loaded = [link for document in documents.values() for link in document.loaded]
    assert loaded
    assert [link for link in loaded if re.match(r"(https?:)?//", link)] == []
    for sheet in site.rglob("*.css"):
        assert re.findall(r"url\(\"?(?:https?:)?//[^)]*|@import[^;]*//[^;]*", sheet.read_text("utf-8")) == []


def test_a_dead_link_stops_the_build(tmp_path):
    """The check of this file is MkDocs' own, too: it must see a wrong page and a wrong anchor."""
    docs = tmp_path / "docs"
    docs.mkdir()
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    validation = re.search(r"^strict: true\n", settings, re.MULTILINE)[0]
    validation += re.search(r"^validation:\n(?:  .*\n)+", settings, re.MULTILINE)[0]
    (tmp_path / "mkdocs.yml").write_text(f"site_name: a\n{validation}", encoding="utf-8")
    (docs / "other.md").write_text("# Other\n", encoding="utf-8")
    for link, is_good in (("other.md#other", True), ("missing.md", False), ("other.md#missing", False)):
        (docs / "index.md").write_text(f"# A\n\n[b]({link})\n", encoding="utf-8")
        assert (build(tmp_path, tmp_path / "site").returncode == 0) is is_good


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_the_reference(name, site):
    text = text_of(site / "reference" / "commands.html")
    command = cli.get_command(click.Context(cli), name)
    for option in command.params:
        for spelt in option.opts if isinstance(option, click.Option) and not option.hidden else ():
            assert spelt in text
    for line in command.epilog.partition("Example:")[2].split("\n"):
        assert " ".join(line.split()) in text


def test_short_help_works_after_the_reference_is_made():
    """click keeps the help option that it first made for a command: a process of its own, where the
    reference is first."""
    program = (
        "import generate\nfrom daest.cli.main import run\n"
        "generate.commands()\nraise SystemExit(run(['explain', '-h']))"
    )
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT / "docs")
    assert result.returncode == 0 and "-h, --help" in result.stdout, result.stderr


def test_every_code_is_in_the_reference(site, documents):
    path = site / "reference" / "messages.html"
    text = text_of(path)
    assert EXPLANATIONS.keys() <= documents[path].anchors
    for explanation in EXPLANATIONS.values():
        assert " ".join(explanation.split()) in text


def test_every_effect_is_in_the_reference(site):
    text = text_of(site / "reference" / "effects.html")
    for effect in effect_library():
        assert effect.name in text
        assert " ".join(effect.law.split()) in text
        for parameter in effect.parameters:
            assert " ".join(parameter.description.split()) in text


def test_every_public_name_is_in_the_reference(site, documents):
    path = site / "reference" / "python.html"
    text = text_of(path)
    for name in daest.__all__:
        value = getattr(daest, name)
        assert f"{value.__module__}.{name}" in documents[path].anchors
        first = inspect.getdoc(value).split("\n\n")[0]
        assert " ".join(first.replace("`", "").split()) in text


def test_every_key_of_the_project_file_is_in_the_reference(site):
    text = text_of(site / "reference" / "project.html")
    for section, keys in KEYS.items():
        assert f"[{section}]" in text
        assert all(key in text for key in keys)


def test_schemas_lie_in_the_site(site, documents):
    page = documents[site / "reference" / "json.html"]
    for name in schema_names():
        file = f"schemas/{name}.json"
        assert file in page.links
        assert json.loads((site / "reference" / file).read_text("utf-8")) == schema_of(name)


def test_formulas_are_drawn(site):
    source = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
    content = (site / "theory.html").read_text(encoding="utf-8")
    blocks = len(re.findall(r"^\$\$.*\$\$$", source, re.MULTILINE))
    inline = len(re.findall(r"(?<!\$)\$(?!\$)[^$\n]+\$(?!\$)", source))
    assert content.count("<math") == blocks + inline > 50
    assert content.count('class="number"') == source.count("\\tag{")
    assert not re.search(r"\\\(|\\\[|\$\$|\\[a-z]+\{|<merror|{{", content.partition("<article")[2])


def test_rates_stand_on_the_page(site):
    rates = json.loads((ROOT / "docs" / "rates.json").read_text(encoding="utf-8"))
    text = text_of(site / "trust.html")
    assert f"on {rates['n_runs']} simulated recordings" in text
    for rate in rates["rates"]:
        assert re.search(
            rf"{re.escape(rate['group'])} {re.escape(rate['what'])} {rate['runs']} [\d.]+.%", text
        )
    for case in rates["cases"]:
        assert f"{case['case']} {case['runs']} " in text


# A page of words, of formulas and of listings; all of them in a slow test.
KINDS = (
    "index.html",
    "theory.html",
    "reference/commands.html",
)


@pytest.mark.browser
@pytest.mark.parametrize("names", [KINDS, pytest.param((), marks=pytest.mark.slow)], ids=["kinds", "all"])
def test_a_browser_opens_it_from_files(documents, site, watched, names):
    """Each page is loaded once: it follows the screen and the scheme that it is shown on."""
    for path in [site / name for name in names] or documents:
        watched.page.goto(path.as_uri())
        for width, scheme in watched.screens():
            assert watched.fits(), (path.name, width, scheme)
    assert watched.complaints == []
    assert watched.requests and watched.loaded_from_outside == []


@pytest.mark.browser
def test_search_finds_in_pages_that_are_opened_from_files(site, browser):
    page = browser.new_page()
    page.goto((site / "index.html").as_uri())
    page.click("input[name=query]", force=True)
    page.keyboard.type("staircase Sylvester", delay=20)
    page.wait_for_selector(".md-search-result__item", timeout=20_000)
    assert "Theory" in page.inner_text(".md-search-result__list")
    page.close()
