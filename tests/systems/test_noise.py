"""Admissible white noise: the report's model, exact rational arithmetic as second opinion, scale
invariance."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from flat_models import Draft, add_noise, library_servo, report_servo, servo_draft

from daest.errors import ConfigError
from daest.systems.linear.linearize import linearize
from daest.systems.linear.noise import noise_report
from daest.systems.linear.split import split


def exact_growth(dae) -> np.ndarray:
    """growth[j, k]: power of s with which unknown j answers to noise on equation k as s → ∞; -99 for no
    answer.

    (sE - J)⁻¹ in rational arithmetic at s = 10^60 and 10^63: the ratio is 1000^power to 50 digits. Knows
    nothing of pencils.
    """
    responses = [_exact_inverse(dae.E, dae.J, Fraction(10) ** power) for power in (60, 63)]
    growth = np.full((dae.n, dae.n), -99)
    for j in range(dae.n):
        for k in range(dae.n):
            near, far = responses[0][j][k], responses[1][j][k]
            if near:
                growth[j, k] = round(float(np.log10(float(abs(far / near)))) / 3)
    return growth


def _exact_inverse(E, J, s) -> list[list[Fraction]]:
    n = len(E)
    rows = [
        {c: s * _fraction(E[r, c]) - _fraction(J[r, c]) for c in range(n) if E[r, c] or J[r, c]}
        | {n + r: Fraction(1)}
        for r in range(n)
    ]
    for c in range(n):
        pivot = min((r for r in range(c, n) if rows[r].get(c)), key=lambda r: len(rows[r]))
        rows[c], rows[pivot] = rows[pivot], rows[c]
        scale = rows[c][c]
        rows[c] = {k: v / scale for k, v in rows[c].items()}
        for r in range(n):
            factor = rows[r].pop(c, None) if r != c else None
            if factor:
                for k, v in rows[c].items():
                    if k != c:
                        rows[r][k] = rows[r].get(k, Fraction(0)) - factor * v
                        if not rows[r][k]:
                            del rows[r][k]
    return [[rows[j].get(n + k, Fraction(0)) for k in range(n)] for j in range(n)]


def _fraction(value: float) -> Fraction:
    return Fraction(repr(float(value)))


def forbidden(report) -> list[int]:
    return [i for i, place in enumerate(report.places) if not place.admissible]


@pytest.mark.parametrize(("star", "count", "gear_norm"), [(False, 10, 1 / 67), (True, 9, 1 / 60)])
def test_the_reports_model(star, count, gear_norm):
    dae = linearize(report_servo(star))
    report = noise_report(dae)
    assert (len(report.places), report.n_dynamic, report.index) == (54, 4, 2)
    values = [value for value in report.N_singular_values if value]
    assert len(report.N_singular_values) == 50
    np.testing.assert_allclose(values, [1.41, 1.00], atol=0.005)
    assert report.n_forbidden == count
    for place in report.places:
        if not place.admissible:
            assert ".phi" in place.name and "der" not in place.name and "tau" not in place.name
    gear = [p for p in report.places if p.projection_norm == pytest.approx(gear_norm, rel=0.01)]
    assert len(gear) == 3 and not any(p.admissible for p in gear)
    assert report.decisions[-1].rank == count
    assert report.decisions[-1].gap > 1e5


@pytest.mark.parametrize(("star", "count"), [(False, 7), pytest.param(True, 6, marks=pytest.mark.slow)])
def test_a_coarse_tolerance_loses_the_three_of_the_gear(star, count):
    dae = linearize(report_servo(star))
    fine, coarse = noise_report(dae), noise_report(dae, tolerance=0.02)
    assert coarse.n_forbidden == count
    lost = set(forbidden(fine)) - set(forbidden(coarse))
    assert len(lost) == 3
    assert all(fine.places[i].projection_norm < 0.02 for i in lost)


@pytest.mark.parametrize(
    "make", [report_servo, pytest.param(lambda: report_servo(True), marks=pytest.mark.slow), library_servo]
)
def test_verdicts_agree_with_exact_arithmetic(make):
    dae = linearize(make())
    growth = exact_growth(dae)
    report = noise_report(dae)
    assert forbidden(report) == np.flatnonzero((growth >= 1).any(axis=0)).tolist()
    names = [unknown.name for unknown in dae.unknowns]
    for k, place in enumerate(report.places):
        assert place.order == max(0, growth[:, k].max()), place.name
        want = {names[j] for j in np.flatnonzero(growth[:, k] >= 1)}
        assert set(place.differentiated) == want, place.name


def test_projection_is_the_one_of_the_report():
    dae = linearize(report_servo())
    form = split(dae)
    n1 = form.n_dynamic
    _, values, vt = np.linalg.svd(form.N)
    V2 = vt[np.sum(values > 1e-9) :].T
    assert V2.shape == (50, 48)
    inner = np.block([[np.eye(n1), np.zeros((n1, 48))], [np.zeros((50, n1)), V2]])
    M = np.linalg.solve(form.left, inner)  # (39)
    projection = np.eye(dae.n) - M @ np.linalg.pinv(M)  # (40)
    want = np.linalg.norm(projection, axis=0)
    got = [place.projection_norm for place in noise_report(dae, form).places]
    np.testing.assert_allclose(got, want, atol=1e-6)  # cond(M) is near 1e6


def test_verdict_does_not_depend_on_units():
    rng = np.random.default_rng(12)
    for make in (report_servo, library_servo):
        dae = linearize(make())
        plain = noise_report(dae)
        for _ in range(2):
            rows, columns = (10.0 ** rng.uniform(-6, 6, dae.n) for _ in range(2))
            scaled = replace(
                dae,
                E=rows[:, None] * dae.E * columns,
                J=rows[:, None] * dae.J * columns,
                C=dae.C * columns,
                K=rows[:, None] * dae.K,
                B=rows[:, None] * dae.B,
                offset=rows * dae.offset,
            )
            report = noise_report(scaled)
            assert forbidden(report) == forbidden(plain)
            for one, other in zip(report.places, plain.places, strict=True):
                assert (one.differentiated, one.order) == (other.differentiated, other.order)
                assert one.white_outputs == other.white_outputs


def test_advice_names_admissible_equations_with_a_derivative():
    dae = linearize(report_servo())
    report = noise_report(dae)
    by_text = {place.name: place for place in report.places}
    advice = by_text["disc.phi = disc.flange_a.phi"].advice
    assert "`disc.w = der(disc.phi)`" in advice and "first-order" in advice
    for place in report.places:
        if not place.admissible:
            proposed = [text for text in place.advice.split("`") if " = " in text]
            assert proposed
            assert all(by_text[text].admissible and "der(" in text for text in proposed)
    assert by_text["J1*motor.a = motor.flange_a.tau + motor.flange_b.tau"].advice == ""


def test_noise_of_the_model_is_judged_by_its_column():
    torque = "J1*motor.a = motor.flange_a.tau + motor.flange_b.tau"
    angle = "disc.phi = disc.flange_a.phi"
    dae = linearize(report_servo(noises={"good": torque, "bad": angle}))
    report = noise_report(dae)
    good, bad = report.annotated
    assert (good.name, good.admissible, good.differentiated) == ("good", True, ())
    assert (bad.name, bad.admissible) == ("bad", False)
    assert [dae.equations[i].text for i in bad.equations] == [angle + " + bad"]
    assert "damper.w_rel" in bad.differentiated and bad.advice
    assert not report.all_admissible


def test_two_entries_that_cancel_are_admissible():
    # The same noise on both angle equations of a rigid connection only shifts the angle between them.
    m = Draft("Shifted", unknowns=["p", "v", "q", "r", "rate"], noises={"w": 1.0})
    for text in ("v = der(p)", "der(v) = -p", "q = p + w", "r = q - w", "rate = der(r)"):
        m.equation(text)
    report = noise_report(linearize(m.flat()))
    assert report.annotated[0].admissible
    assert forbidden(report) == [2, 3]


def test_white_noise_in_outputs_is_named():
    m = Draft("Direct", unknowns=["x", "z"], noises={"w": 1.0, "v": 1.0})
    for text in ("der(x) = -x + w", "z = x + v"):
        m.equation(text)
    m.outputs = {"filtered": "x", "noisy": "2*z", "explicit": "x + w", "difference": "z - x"}
    w, v = noise_report(linearize(m.flat())).annotated
    assert w.white_outputs == ("explicit",)
    assert v.white_outputs == ("noisy", "difference")
    assert "noisy" in v.advice


def test_index_one_allows_everything():
    m = Draft("Circuit", parameters={"R": 2.0, "C": 1e-6}, unknowns=["v", "i", "u"])
    for text in ("C*der(v) = i", "R*i = u - v", "u = 1"):
        m.equation(text)
    report = noise_report(linearize(m.flat()))
    assert (report.index, report.n_forbidden, report.N_singular_values) == (1, 0, (0.0, 0.0))
    assert all(place.projection_norm == 0.0 for place in report.places)


def test_places_that_are_asked_for():
    draft = servo_draft()
    add_noise(draft, "w", "R*resistor.i = resistor.v")
    dae = linearize(draft.flat())

    def texts(*at):
        return [dae.equations[place.equations[0]].text for place in noise_report(dae, at=at).asked]

    assert texts(0) == texts("0") == [dae.equations[0].text]
    assert noise_report(dae, at=["w"]).asked[0].name == "w"
    assert len(texts("disc")) == 5
    assert texts("disc.flange_b.tau") == ["disc.flange_b.tau = 0"]
    assert texts("emf.w") == ["emf.w = der(emf.flange.phi)", "k*emf.w = emf.v"]
    assert texts("spring.tau = c*spring.phi_rel") == ["spring.tau = c*spring.phi_rel"]
    with pytest.raises(ConfigError) as caught:
        noise_report(dae, at=["disc.flange_c.tau"])
    assert caught.value.code == "noise-place-unknown"
    assert "disc.flange_b.tau" in caught.value.remedy
