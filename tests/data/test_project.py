"""daest.toml: what is read, and the message of everything that is wrong, with its line."""

import pytest

from daest.data.project import ParameterSetting, load_project
from daest.errors import ConfigError
from daest.model.parts import Prior

FULL = """\
[model]
source = "Servo.mo"
class = "Servo"
libraries = ["lib"]

[data]
estimate = ["run1.csv", "run2.csv"]
validate = "run3.csv"
inputs = { u = "voltage" }
outputs = { omega = "speed", disc.phi = "angle" }
time = "t"
from = 1
to = 9.5
resample = 0.05
detrend = "mean"
hold = "foh"

[parameters]
"spring.c" = { estimate = true, start = 0.04, min = 0, scale = "log" }
R = { value = 4.6 }
disc.J = { estimate = false }

[noise.process]
"disc.flange_b.tau" = { intensity = 1e-6, estimate = true }
[noise.measurement]
phi = { std = 0.01, estimate = true }
"""


def write(tmp_path, text):
    path = tmp_path / "daest.toml"
    path.write_text(text)
    return path


def error_of(tmp_path, text):
    with pytest.raises(ConfigError) as caught:
        load_project(write(tmp_path, text))
    return caught.value


def test_everything_is_read(tmp_path):
    project = load_project(write(tmp_path, FULL))
    assert project.source == tmp_path / "Servo.mo" and project.class_name == "Servo"
    assert project.libraries == (tmp_path / "lib",)
    assert project.estimate == (tmp_path / "run1.csv", tmp_path / "run2.csv")
    assert project.validate == (tmp_path / "run3.csv",)
    assert project.inputs == {"u": "voltage"}
    assert project.outputs == {"omega": "speed", "disc.phi": "angle"}
    assert project.time == "t"
    assert project.preparation.start == 1.0 and project.preparation.stop == 9.5
    assert project.preparation.period == 0.05 and project.preparation.detrend == "mean"
    assert project.hold == "foh"
    assert project.parameters["spring.c"] == ParameterSetting(True, 0.04, 0.0, None, "log", is_start=True)
    assert project.parameters["R"] == ParameterSetting(False, 4.6)
    assert project.parameters["disc.J"] == ParameterSetting(estimate=False)
    assert project.process_noise["disc.flange_b.tau"].size == 1e-6
    assert project.measurement_noise["phi"].estimate is True
    assert project.results == tmp_path / "results"


@pytest.mark.parametrize("name", ['"spring.c"', "spring.c"])
@pytest.mark.parametrize("before", ["", "estimate = true, "])
def test_prior_of_a_parameter(tmp_path, name, before):
    (tmp_path / "daest.toml").write_text(
        f"[parameters]\n{name} = {{ {before}prior = {{ mean = 0.04, std = 2e-3 }} }}\n"
    )
    setting = load_project(tmp_path).parameters["spring.c"]
    assert setting.prior == Prior(0.04, 2e-3)
    assert setting.estimate == (True if before else None)


@pytest.mark.parametrize(
    ("setting", "estimate"),
    [
        ("value = 2", False),
        ("value = 2, estimate = true", True),
        ("start = 2", None),
        ("value = 2, prior = { mean = 2, std = 0.1 }", None),
    ],
)
def test_a_value_holds_what_nothing_else_estimates(tmp_path, setting, estimate):
    project = load_project(write(tmp_path, f"[parameters]\nc = {{ {setting} }}\n"))
    assert project.parameters["c"].estimate is estimate


def test_no_file_is_an_empty_project(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    project = load_project()
    assert project.file is None and project.source is None and not project.estimate
    with pytest.raises(ConfigError) as caught:
        load_project(tmp_path / "other.toml")
    assert caught.value.code == "config-missing"


BAD_FILES = [
    ('[model]\nsource = "a.mo"\nclas = "A"\n', "config-unknown-key", 3, "did you mean class?"),
    ('[modell]\nsource = "a.mo"\n', "config-unknown-key", 1, "did you mean model?"),
    ('[data]\nestimate = ["a.csv"]\n\n[parameters]\nR = { valeu = 4.6 }\n', "config-unknown-key", 5, "value"),
    ("[model]\nsource = 3\n", "config-type", 2, "text in quotes"),
    ("[data]\nsplit = true\n", "config-type", 2, "a number"),
    ("[data]\nsplit = 1.5\n", "option-split", 2, "between 0 and 1"),
    ("[data]\nresample = -1\n", "option-resample", 2, "positive"),
    ('[data]\n\ndetrend = "quadratic"\n', "config-type", 3, '"linear"'),
    ("[data]\nestimate = [1]\n", "config-type", 2, "list of paths"),
    ("[data]\ninputs = { u = 3 }\n", "config-type", 2, "columns"),
    ("[parameters]\nR = 4.6\n", "config-type", 2, "value = 1.0"),
    ("[parameters]\nR = { start = 5, max = 4 }\n", "config-value", 2, "outside its bounds"),
    ("[parameters]\nR = { min = 5, max = 4 }\n", "config-value", 2, "min 5"),
    ("[parameters]\nR = { prior = 4 }\n", "config-type", 2, "mean = 1.0"),
    ("[parameters]\nR = { prior = { mean = 4 } }\n", "config-value", 2, "no std"),
    ("[parameters]\nR = { prior = { mean = 4, std = 0 } }\n", "config-value", 2, "std above 0"),
    ("[parameters]\nR = { prior = { mean = 4, std = 1, sigma = 1 } }\n", "config-unknown-key", 2, "sigma"),
    ("[parameters]\n\n\"a.b\" = { start = 5, value = 4 }\n", "config-value", 3, "a start and a value"),
    ("[noise.measurement]\nphi = { std = -1 }\n", "config-value", 2, "negative"),
    ("[noise.measurement]\nphi = { intensity = 1 }\n", "config-unknown-key", 2, "std"),
    ('[data]\nvalidate = "a.csv"\nsplit = 0.5\n', "config-value", 3, "both"),
    ("[model]\nsource = \n", "config-syntax", 2, "has no value"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "code", "line", "mentions"), BAD_FILES)
def test_bad_file(tmp_path, text, code, line, mentions):
    error = error_of(tmp_path, text)
    assert error.code == code
    assert error.where.line == line
    assert mentions in str(error)


def test_all_problems_at_once(tmp_path):
    message = str(error_of(tmp_path, '[model]\nsorce = "a"\n[data]\nsplit = "x"\n[parameters]\nR = 3\n'))
    assert "3 problems" in message
    assert "daest.toml:2" in message and "daest.toml:4" in message and "daest.toml:6" in message
