"""The published JSON Schemas: valid, one per command that prints a document, with the promised keys; what
commands print agrees with them (the fixture `daest` holds every document against its schema), and what they
show fits the terminal."""

import json
import shutil
from pathlib import Path

import pytest
from cart_data import CART
from jsonschema import Draft202012Validator, ValidationError

from daest.cli.main import COMMANDS
from daest.cli.schema import schema_names, schema_of

SERVO = Path(__file__).resolve().parents[2] / "examples" / "servo"
# Keys that scripts depend on.
PROMISED = {
    "linearize": "equations unknowns inputs outputs noises units parameters E J K B C D n_equations "
    "n_dynamic index poles transfer_functions theta source cross_check",
    "noise": "n_equations n_dynamic index N_singular_values equations n_forbidden annotated decisions",
    "identify": "status message parameters noise initial_state correlation weak_directions log_likelihood "
    "fit_percent rms one_step n_samples seconds period hold",
    "filter": "kind log_likelihood nis compared process_noise steady_after",
    "compare": "models table",
    "diagnose": "verdict message baseline candidates places disturbance next_experiment seconds",
    "improve": "steps final",
}


@pytest.mark.parametrize("name", schema_names())
def test_schema_is_one(name):
    schema = schema_of(name)
    Draft202012Validator.check_schema(schema)
    assert schema["title"] and schema["properties"]["schema"] == {"const": f"daest/{name}/1"}
    assert set(PROMISED.get(name, "").split()) <= set(schema["required"])


def test_every_command_has_one():
    assert set(schema_names()) == set(COMMANDS)


def test_a_schema_refuses_what_is_missing_or_of_another_type():
    validator = Draft202012Validator(schema_of("check"))
    good = {"schema": "daest/check/1", "recordings": [], "n_warnings": 0}
    validator.validate(good)
    for bad in ({**good, "n_warnings": "0"}, {**good, "schema": "daest/check/2"}, {"n_warnings": 0}):
        with pytest.raises(ValidationError):
            validator.validate(bad)


@pytest.fixture
def servo(tmp_path, monkeypatch):
    folder = shutil.copytree(SERVO, tmp_path / "servo", ignore=shutil.ignore_patterns("results"))
    monkeypatch.chdir(folder)
    return folder


PRINTED = [
    ("init", "Lag.mo", "run1.csv"),
    ("check",),
    ("linearize",),
    ("noise",),
    ("export", "-o", "lag.fmu"),
    ("effects",),
    ("simulate", "--to", "2"),
    ("identify",),
    ("filter",),
    ("compare",),
    ("report",),
    ("demo",),
    ("explain",),
    ("schema",),
    ("completion", "zsh"),
]


def test_what_commands_print(folder, daest):
    """One test, because later commands use the results of earlier ones."""
    for arguments in PRINTED:
        code, out, err = daest(*arguments, "--format", "json")
        assert code == 0, err
        assert json.loads(out)["schema"] == f"daest/{arguments[0]}/1"


def test_extended_model(tmp_path, monkeypatch, daest):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Cart.mo").write_text(CART)
    place = ("--effect", "CoulombFriction", "--at", "cart.flange_a")
    code, out, err = daest("extend", "Cart.mo", *place, "-o", "new.mo", "--format", "json")
    assert code == 0, err
    assert json.loads(out)["path"] == "new.mo"


SHOWN = [
    ("linearize",),
    ("noise",),
    ("effects", "CoulombFriction"),
    ("check",),
    ("compare", "--to", "5"),
    ("demo",),
    ("explain",),
    ("schema",),
]


@pytest.mark.slow  # every text of the tests of commands, in three widths: conftest.py
@pytest.mark.parametrize("width", [60, 200])
def test_text_fits_the_terminal(servo, daest, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    for arguments in SHOWN:
        code, out, err = daest(*arguments)
        assert code == 0, err
        longest = max(out.splitlines(), key=len)
        assert len(longest) <= width, (arguments, longest)


def test_schema_command(daest):
    code, out, _ = daest("schema", "noise")
    assert code == 0 and json.loads(out) == schema_of("noise")
    code, out, _ = daest("schema")
    assert code == 0 and all(name in out for name in schema_names())
    code, _, err = daest("schema", "nose")
    assert code == 2 and "schema-unknown" in err
