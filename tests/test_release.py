"""What a release promises beside its code: a licence for everything, one version, links that exist."""

import os
import re
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import pytest
import yaml

import daest
from daest import machine

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_every_dependency_has_its_licence(project):
    requirements = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    required = {re.split(r"[\[<>=~! ;]", requirement)[0] for requirement in requirements} - {"daest"}
    text = (ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8")
    packages = text.partition("## Data")[0]
    listed = {
        row[0]: row[1] for row in re.findall(r"^\| ([a-z][\w-]+) \| ([^|]+) \| [^|]+ \|$", packages, re.M)
    }
    assert listed.pop("package") == "licence"
    assert set(listed) == required
    assert all(licence.strip() for licence in listed.values())


def test_one_version(project):
    assert "version" in project["dynamic"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", citation, re.M)[1] == daest.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## (\d+\.\d+\.\d+)", changes, re.M)
    assert versions[0] == daest.__version__


def test_licence_is_the_one_that_is_declared(project):
    assert project["license"] == "BSD-3-Clause"
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").startswith("BSD 3-Clause License")


@pytest.mark.slow
def test_wheel_works_outside_the_checkout(tmp_path):
    """Library, examples, schemas, styles and C sources are inside: nothing is looked for in the checkout."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(tmp_path / "site")]
    subprocess.run([*pip, str(ROOT)], check=True, capture_output=True)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    for words in (
        ["demo", "servo"],
        ["export", "servo/Servo.mo", "-o", "servo.fmu"],
        ["linearize", "servo.fmu"],
        ["report", "-p", "servo/daest.toml"],
        ["schema", "identify"],
    ):
        command = [sys.executable, "-m", "daest", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    code = "import daest; print(daest.__file__)"
    where = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert where.stdout.startswith(str(tmp_path))


def test_conda_recipe_asks_for_what_the_project_asks_for(project):
    recipe = yaml.safe_load((ROOT / "packaging" / "recipe.yaml").read_text(encoding="utf-8"))
    assert recipe["context"]["version"] == daest.__version__
    wanted = {tuple(re.split(r"(?=[<>=~])", one, maxsplit=1)) for one in project["dependencies"]}
    other_names = {"matplotlib-base": "matplotlib"}
    run = [one.split(" ", 1) for one in recipe["requirements"]["run"]]
    assert {(other_names.get(name, name), rule) for name, rule in run if name != "python"} == wanted
    for name in recipe["about"]["license_file"]:
        assert (ROOT / name).is_file()


def test_extras_of_the_page_exist(project):
    page = (ROOT / "docs" / "how-to" / "install.md").read_text(encoding="utf-8")
    named = set(re.findall(r"daest\[(\w+)\]", page))
    assert named == set(project["optional-dependencies"]) - {"docs", "test", "benchmark", "parquet"}


SCRIPTS = [
    path for path in (ROOT / "benchmarks").rglob("*.py") if "__main__" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_benchmark_says_on_what_it_was_measured(script):
    told = "from nonlinear_speed import" if script.stem == "nonlinear_identify_speed" else "described("
    assert told in script.read_text(encoding="utf-8")


def test_the_line_about_the_machine_has_versions_and_processor():
    line = machine.described(("numpy", "nothing-of-this-name"))
    assert line.startswith(f"daest {daest.__version__}, ")
    assert machine.processor() in line and re.search(r"\d+ cores", line)
    assert "numpy 2" in line and "nothing" not in line
