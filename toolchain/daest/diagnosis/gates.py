"""The thresholds of the diagnosis, each with its unit, its meaning and what set it.

`docs/trust.md` and `docs/theory.md` show the values from here. A count that only limits how long a search
takes is no gate and stands where it is used.
"""

from __future__ import annotations

from dataclasses import dataclass

from daest.model.thresholds import JUDGEMENT, ROUNDING, Thresholds
from daest.model.thresholds import threshold as gate

SIMULATED = "the machines of benchmarks/diagnosis_study.py, with other seeds than those of the rates"
BOXES = "the FMUs of benchmarks/black_box_study.py, with other seeds than those of the rates"
WRONG = (
    "benchmarks/wrong_models_study.py: a lag in place of a flexible part left 0.09 to 0.2 of its gain, or "
    "had a time constant of 2.7 to 4.7 standard errors"
)
FLEXIBLE = (
    "analysis: a flexible part at five times the bandwidth, half damped, acts like a delay of a fifth of the "
    "time constant"
)


@dataclass(frozen=True)
class Gates(Thresholds):
    """The thresholds. `rows` tells of each what stands beside its value."""

    screen_level: float = gate(
        0.05,
        "p-value",
        "score of the screen, corrected for the search, below which a candidate is refitted",
        "distribution: largest of jointly normal scores",
    )
    richer_level: float = gate(
        0.1,
        "p-value",
        "what the best candidate leaves, below which laws with more parameters are tried",
        JUDGEMENT,
    )
    min_same_form: float = gate(
        0.5,
        "share",
        "of the largest gain of a form, from which the form of what a law leaves is told instead",
        JUDGEMENT,
    )
    min_hold_gain: float = gate(
        10.0,
        "log-likelihood",
        "by which the other hold of the inputs must fit better with an effect to be taken",
        JUDGEMENT,
    )
    max_known_variance: float = gate(
        0.05,
        "share",
        "of the variance of a column that known signals leave, below which it is one of them",
        JUDGEMENT,
    )
    min_samples: int = gate(
        200,
        "samples",
        "of all recordings, below which nothing is diagnosed",
        JUDGEMENT,
    )
    absorbed_share: float = gate(
        0.02,
        "share",
        "of a response that no refitted parameter explains, below which the parameters do all of it",
        JUDGEMENT,
    )
    stated_power: float = gate(
        0.9,
        "probability",
        "with which the smallest detectable size is seen",
        "definition",
    )
    observer_runaway: float = gate(
        100.0,
        "standard deviations",
        "of an output: an observer with a larger error has run away",
        JUDGEMENT,
    )
    clear_hold_gain: float = gate(
        100.0,
        "log-likelihood",
        "by which one hold of the inputs must be better to be settled before anything is found",
        JUDGEMENT,
    )
    same_place_sine: float = gate(
        1e-3,
        "sine of an angle",
        "below which the outputs see the loads at two places alike",
        JUDGEMENT,
    )
    unseen_load: float = gate(
        1e-9,
        "share",
        "of the largest effect of a load on the outputs, below which a load is not seen",
        ROUNDING,
    )
    min_looked_at_gain: float = gate(
        5.0,
        "log-likelihood",
        "that a load must buy for what it follows to be looked at",
        JUDGEMENT,
    )
    same_course: float = gate(
        1e-6,
        "1 - abs(correlation)",
        "below which two variables are one up to offset and factor",
        ROUNDING,
    )
    same_place_correlation: float = gate(
        0.98,
        "correlation",
        "of two scores, above which the sensors do not tell two places apart",
        JUDGEMENT,
    )
    same_score: float = gate(
        0.999,
        "ratio",
        "of two scores, above which they are equal",
        JUDGEMENT,
    )
    hopeless_log_likelihood: float = gate(
        100.0,
        "log-likelihood",
        "below the best accepted candidate, at which a refit is not pursued",
        JUDGEMENT,
    )
    clear_unseen_error: float = gate(
        0.1,
        "share",
        "by which a candidate so far below must simulate an output of unseen data worse to be no rival",
        JUDGEMENT,
    )
    same_bic: float = gate(
        6.0,
        "BIC",
        "difference up to which two candidates are one answer",
        "Kass and Raftery (1995): positive evidence begins at 2, strong at 6",
    )
    min_bic_gain: float = gate(
        10.0,
        "BIC",
        "that an accepted effect must gain",
        "Kass and Raftery (1995): very strong evidence",
    )
    max_chance: float = gate(
        1e-3,
        "p-value",
        "of the likelihood ratio, corrected for the search, above which nothing is proven",
        "distribution: chi-squared",
    )
    min_significance: float = gate(
        3.0,
        "standard errors",
        "that the size of an accepted effect stands off its null",
        "distribution: normal",
    )
    min_explained: float = gate(
        0.5,
        "share",
        "of the size of the load that an accepted effect takes away",
        SIMULATED,
    )
    min_partly_explained: float = gate(
        0.35,
        "share",
        "of it that is enough where unseen data are simulated much better besides",
        SIMULATED,
    )
    max_simulated_ratio: float = gate(
        0.7,
        "ratio",
        "of errors of the simulated unseen data, with to without the effect, that is much better",
        SIMULATED,
    )
    min_curve_explained: float = gate(
        0.2,
        "share",
        "of the load that is enough where the law says all that it has to do with any variable",
        SIMULATED,
    )
    rest_level: float = gate(
        1e-3,
        "p-value",
        "below which the rest of the load certainly follows a variable",
        "distribution: chi-squared",
    )
    max_rest: float = gate(
        0.3,
        "share",
        "of the law's gain that the rest may gain where the law does away with most of the error",
        SIMULATED,
    )
    max_rounding_rest: float = gate(
        0.1,
        "share",
        "of the law's gain below which the rest is how the law is rounded",
        SIMULATED,
    )
    min_covered: float = gate(
        0.75,
        "share",
        "of a law's score that a free form explains, from which the law is a part of the form",
        SIMULATED,
    )
    min_simpler_gain: float = gate(
        0.97,
        "ratio",
        "of gains that a law with fewer parameters must reach to be preferred",
        JUDGEMENT,
    )
    min_vague_gain: float = gate(
        0.9,
        "ratio",
        "of gains that a law with fewer parameters must reach to be a rival of one whose others are vague",
        JUDGEMENT,
    )
    max_rival_error: float = gate(
        0.9,
        "ratio",
        "of errors in simulating unseen data, below which an accepted law is a rival of a likelier one",
        JUDGEMENT,
    )
    same_equation: float = gate(
        0.05,
        "log-likelihood, standard errors",
        "of the parameters of the model, within which two laws are one on these data",
        JUDGEMENT,
    )
    min_refused_gain: float = gate(
        0.7,
        "ratio",
        "to the gain of a refused candidate, below which no other is accepted",
        SIMULATED,
    )
    min_richer_gain: float = gate(
        10.0,
        "log-likelihood",
        "by which a law with more parameters must go beyond the simple one",
        JUDGEMENT,
    )
    min_dynamic_gain: float = gate(
        20.0,
        "log-likelihood",
        "of the simulation that an effect with states must gain to be refitted",
        JUDGEMENT,
    )
    same_fit: float = gate(
        0.5,
        "log-likelihood",
        "within which two places are the same to the sensors",
        JUDGEMENT,
    )
    error_of_choice: float = gate(
        0.5,
        "share",
        "of the distance between two estimates on different terms that counts as an error of the size",
        JUDGEMENT,
    )
    unseen_significance: float = gate(
        2.5,
        "standard errors",
        "of the mean over stretches, that tell better from worse on unseen data",
        "distribution: normal",
    )
    acting_share: float = gate(
        0.95,
        "share",
        "of the squared difference between two models: where that is, the effect acts",
        JUDGEMENT,
    )
    same_unseen_error: float = gate(
        0.01,
        "share",
        "by which errors on unseen data may differ and are the same",
        JUDGEMENT,
    )
    max_clear_ratio: float = gate(
        0.9,
        "ratio",
        "of errors from which a simulation of unseen data has become clearly better",
        JUDGEMENT,
    )
    max_most_ratio: float = gate(
        0.7,
        "ratio",
        "of errors from which most of the squared error on unseen data is gone",
        JUDGEMENT,
    )
    min_independent: float = gate(
        5.0,
        "samples",
        "that the errors of a simulation count for, below which it says nothing by its own",
        JUDGEMENT,
    )
    max_place: float = gate(
        1.1,
        "ratio",
        "of a rim, a stop or a limit to what its variable reaches, above which it does not act",
        JUDGEMENT,
    )
    open_parameter: float = gate(
        0.5,
        "share",
        "of a parameter as its standard error, from which a simulation is fitted from the given values, too",
        JUDGEMENT,
    )
    steady_duration: float = gate(
        3.0,
        "durations of the record",
        "beyond which the time constant of a mode adds up errors without bound",
        JUDGEMENT,
    )
    dynamics_level: float = gate(
        1e-2,
        "p-value",
        "of what a lag or delay leaves, below which it is another law",
        WRONG,
    )
    max_rest_of_dynamics: float = gate(
        0.05,
        "share",
        "of the gain of a lag or delay that it may leave",
        WRONG,
    )
    min_dynamic_significance: float = gate(
        6.0,
        "standard errors",
        "that the time constant of a lag or delay stands off zero",
        WRONG,
    )
    min_lag: float = gate(
        1.0 / 3.0,
        "ratio",
        "to the model's fastest time constant, below which a lag or delay stands for any unmodelled dynamics",
        FLEXIBLE,
    )
    likelier_significance: float = gate(
        1.64,
        "standard errors",
        "of the gain in log-likelihood of unseen data that confirm a law",
        "distribution: normal, 5 %",
    )
    min_expected_gain: float = gate(
        10.0,
        "log-likelihood",
        "that unseen data would gain if a law were right, below which they cannot tell",
        JUDGEMENT,
    )
    max_simulated_loss: float = gate(
        0.05,
        "share",
        "by which a whole simulation may be worse where unseen data are likelier",
        JUDGEMENT,
    )
    max_to_noise: float = gate(
        1.03,
        "ratio",
        "of the simulation error to the one-step error that is as good as it gets",
        JUDGEMENT,
    )
    missing_level: float = gate(
        1e-3,
        "p-value",
        "of the screen, corrected for the search, below which something is missing, named or not",
        "distribution: largest of jointly normal scores",
    )
    min_load_gain: float = gate(
        10.0,
        "log-likelihood",
        "that a load must buy to be a finding",
        JUDGEMENT,
    )
    expected_noise: float = gate(
        10.0,
        "ratio",
        "to the declared intensity, up to which noise is what the model expects",
        JUDGEMENT,
    )
    white_level: float = gate(
        1e-4,
        "p-value",
        "below which the innovations of the null are certainly not white",
        "distribution: chi-squared (Ljung and Box 1978)",
    )
    min_told_bic_gain: float = gate(
        10.0,
        "BIC",
        "above which a rejected candidate is worth a word",
        JUDGEMENT,
    )
    min_told_explained: float = gate(
        0.2,
        "share",
        "of the load below which no law is near to the one that is missing",
        JUDGEMENT,
    )
    max_told_ratio: float = gate(
        0.6,
        "ratio",
        "of errors on unseen data below which a rejected candidate is worth a word",
        JUDGEMENT,
    )
    same_unseen_ratio: float = gate(
        1.1,
        "ratio",
        "of errors on unseen data that tells no two candidates apart",
        JUDGEMENT,
    )
    changed_significance: float = gate(
        3.0,
        "standard errors",
        "that a refitted parameter must move to be off",
        "distribution: normal",
    )
    max_round_ratio: float = gate(
        0.98,
        "ratio",
        "of the worst validation error to the best so far that a round must reach",
        JUDGEMENT,
    )
    still_needed: float = gate(
        3.0,
        "standard errors",
        "that the size of an accepted effect must keep",
        "distribution: normal",
    )
    residual_level: float = gate(
        0.01,
        "probability",
        "of a false alarm by any test of one model",
        "distribution: level of the tests, corrected for their number",
    )
    where_level: float = gate(
        0.02,
        "probability",
        "of a false finding anywhere in one model",
        "distribution: permutations",
    )
    same_region: float = gate(
        0.5,
        "share",
        "of the union of two regions from which they say the same",
        JUDGEMENT,
    )
    min_told_share: float = gate(
        0.1,
        "share",
        "of the error that is worth a sentence",
        JUDGEMENT,
    )
    min_told_excess: float = gate(
        1.15,
        "ratio",
        "of the share of the error to what is expected, below which a finding is not told",
        JUDGEMENT,
    )
    fmu_level: float = gate(
        0.01,
        "p-value",
        "of a score, corrected for the search, below which an effect at an FMU is refitted",
        "distribution: of the largest of the correlated scores",
    )
    fmu_min_share: float = gate(
        0.2,
        "share",
        "of the squared residual as it is, from which a slow effect is refitted, too",
        BOXES,
    )
    fmu_absorbed_share: float = gate(
        1e-6,
        "share",
        "of a squared response that parameters leave over, below which they do all that it does",
        BOXES,
    )
    fmu_min_significance: float = gate(
        3.0,
        "standard errors",
        "that the size of a supported effect has",
        "distribution: normal",
    )
    fmu_min_validation_gain: float = gate(
        0.02,
        "share",
        "of the validation error that a supported effect takes away",
        BOXES,
    )
    fmu_max_foreseen: float = gate(
        0.1,
        "share",
        "of what can be foreseen of the residual that a supported effect may leave",
        BOXES,
    )
    fmu_same_log_likelihood: float = gate(
        3.0,
        "log-likelihood",
        "within which a candidate is as good as the best",
        BOXES,
    )
    fmu_refit_gain: float = gate(
        1e-3,
        "log-likelihood",
        "that ends the refits of an FMU and the searches for its initial states",
        JUDGEMENT,
    )
    fmu_size_step: float = gate(
        1e-3, "share", "of an input or output that an effect is where its response is computed", JUDGEMENT
    )
    fmu_cut: float = gate(
        0.2,
        "share",
        "of the largest value that is cut off where the response of a cut is computed",
        JUDGEMENT,
    )
    hardly_any_load: float = gate(
        1e-8, "share", "of the intensity of a load that stands for none, so that a gain exists", JUDGEMENT
    )
    odd_machine: float = gate(
        5.0,
        "robust standard deviations",
        "from the middle of the fleet, from which a machine is odd",
        JUDGEMENT,
    )
    normal_deviation: float = gate(
        1.4826,
        "standard deviations",
        "of a normal distribution in its median absolute deviation",
        "distribution: normal",
    )
    curve_error: float = gate(
        0.01, "share", "of the largest value of a curve, below which no error of it is believed", JUDGEMENT
    )
    formula_rank: float = gate(
        1e-6, "share", "of the largest singular value, below which terms of a formula are one", ROUNDING
    )
    two_variables: float = gate(
        0.9, "weight", "of the gain of a form over two variables beside that of a form over one", JUDGEMENT
    )
    form_rank: float = gate(
        1e-8,
        "share",
        "of the largest eigenvalue, below which a form does not tell its directions apart",
        ROUNDING,
    )
    learned_sharper: float = gate(
        0.3,
        "share",
        "of the speed over which a form rounds its sign that a learned load rounds it over",
        JUDGEMENT,
    )
    same_knot: float = gate(
        1e-3, "share", "of the range of a variable, within which two knots are one", JUDGEMENT
    )
    wide_interval: float = gate(
        1.0 / 16.0,
        "share",
        "of the range of a variable, above which an interval between knots may be divided",
        JUDGEMENT,
    )
    integrator_rate: float = gate(
        1e-9, "share", "of the fastest rate of a model, below which a mode counts as an integrator", ROUNDING
    )
    compared_beyond: float = gate(
        3.0,
        "factor",
        "by which the frequencies at which places are compared reach beyond the rates of the model",
        JUDGEMENT,
    )
    shortest_load: float = gate(
        2.0,
        "sampling periods",
        "below which the time constant of a load is that of white noise",
        "analysis: of the sampled model",
    )
    longest_load: float = gate(
        0.25,
        "share",
        "of the record, above which the time constant of a load is that of a constant",
        "analysis: of the record",
    )
    given_spread: float = gate(
        2.3,
        "log",
        "of a parameter about its given value, as the standard deviation of what is known of it: a decade",
        JUDGEMENT,
    )
    start_apart: float = gate(
        0.07, "share", "of a start value by which parameters are moved apart that do the same", JUDGEMENT
    )
    max_regressors: float = gate(
        0.1, "share", "of the samples that a test of residuals has as regressors", JUDGEMENT
    )
    test_rank: float = gate(
        1e-8,
        "share",
        "of the largest eigenvalue of a normalised covariance, below which one is rounding",
        ROUNDING,
    )
    nuisance_rank: float = gate(
        1e-7,
        "share",
        "of the largest singular value, below which a direction of the parameters is none",
        ROUNDING,
    )
    soft_sign: float = gate(
        0.05, "share", "of the rms of a speed over which the sign of a form changes", JUDGEMENT
    )
    max_formula_left: float = gate(
        0.3, "share", "of the size of a curve that its formula may leave", JUDGEMENT
    )


GATES = Gates()
