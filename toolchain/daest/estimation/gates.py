"""The thresholds of fits and filters: when searches end, what is told of the unknowns, and what is in doubt.

The page on trust shows them. Counts that only limit how long a search takes, and the points that it tries,
are no thresholds and stand where they are used. z are the coordinates of the search.
"""

from __future__ import annotations

from dataclasses import dataclass

from daest.model.thresholds import JUDGEMENT, ROUNDING, Thresholds, threshold


@dataclass(frozen=True)
class FitGates(Thresholds):
    """The thresholds. `rows` tells of each what stands beside its value."""

    converged_gain: float = threshold(
        1e-6,
        "log-likelihood",
        "that the next step of a search promises, below which the search has converged",
        "analysis: 1e-6 is 0.0014 standard errors",
    )
    stalled_gain: float = threshold(
        1e-3,
        "log-likelihood",
        "that a step promises, above which a search that finds no better point has stalled",
        JUDGEMENT,
    )
    slow_gain: float = threshold(
        10.0,
        "times the gain that ends a search",
        "that several steps must bring together, in a flat valley",
        JUDGEMENT,
    )
    creeping_gain: float = threshold(
        0.5,
        "share",
        "of what an undamped step promises: a step that gains less creeps along a valley",
        JUDGEMENT,
    )
    flat: float = threshold(
        1e-14,
        "share",
        "of the largest information, below which a coordinate has no influence on a step",
        ROUNDING,
    )
    shortest_step: float = threshold(
        1e-12,
        "share",
        "of the undamped step: where even that is no better, no step is",
        ROUNDING,
    )
    largest_step: float = threshold(
        2.5,
        "units of z",
        "that a coordinate moves in one step: a factor of 12 for a logarithmic one",
        JUDGEMENT,
    )
    worthwhile_gain: float = threshold(
        1e-2,
        "log-likelihood",
        "for which a search is taken up again from another point",
        JUDGEMENT,
    )
    settled_information: float = threshold(
        1.0,
        "1/z²",
        "about log(noise), above which a noise does not rest in the flat part of the likelihood",
        JUDGEMENT,
    )
    weak_std: float = threshold(
        0.3,
        "units of z",
        "of an unknown, from which on the likelihood beside it may be no parabola",
        JUDGEMENT,
    )
    no_information: float = threshold(
        1e-12,
        "share",
        "of the largest eigenvalue of the scaled information, below which a direction is unknown",
        ROUNDING,
    )
    foretold: float = threshold(
        3.0,
        "factor",
        "about its parabola, within which the likelihood tells of no hill beside it",
        JUDGEMENT,
    )
    same_valley: float = threshold(
        0.2,
        "share",
        "of a difference in log-likelihood that a parabola must foretell for two points to be in one valley",
        JUDGEMENT,
    )
    suspicious_level: float = threshold(
        0.05,
        "p-value",
        "of the whiteness of residuals, below which the next natural start is searched from",
        JUDGEMENT,
    )
    same_simulation: float = threshold(
        0.1,
        "log-likelihood",
        "between two simulations, within which they are one",
        JUDGEMENT,
    )
    random_start_level: float = threshold(
        1e-3,
        "p-value",
        "of the whiteness of residuals, below which random starts are searched from",
        JUDGEMENT,
    )
    lost_log: float = threshold(
        6.907755278982137,
        "log",
        "of value over start, beyond which no slope is left for the way back",
        JUDGEMENT,
    )
    flat_direction: float = threshold(
        1e-11,
        "eigenvalue",
        "of the information scaled to a unit diagonal, that counts as zero",
        ROUNDING,
    )
    no_influence: float = threshold(
        1e-16,
        "information per value",
        "measured, that is none: a change by 1e-8 of the noise",
        ROUNDING,
    )
    weak_direction: float = threshold(
        0.01,
        "relative std",
        "of the common factor of parameters, from which on their joint direction is weak",
        JUDGEMENT,
    )
    open_direction: float = threshold(
        0.5,
        "relative std",
        "from which on any direction is weak, that of a single parameter too",
        JUDGEMENT,
    )
    named_share: float = threshold(
        0.8,
        "share",
        "of its variance that a joint direction must explain to name a parameter",
        JUDGEMENT,
    )
    named_weight: float = threshold(
        0.12,
        "share",
        "of the largest weight of a direction, below which a parameter is not named",
        JUDGEMENT,
    )
    coloured_level: float = threshold(
        0.01,
        "p-value",
        "of the whiteness of a simulation's residuals, below which standard errors count them as coloured",
        JUDGEMENT,
    )
    unseen_start: float = threshold(
        1e-8,
        "share",
        "of the largest response, below which a combination of initial states stays at zero",
        ROUNDING,
    )
    at_bound: float = threshold(
        1e-6,
        "units of z",
        "from a bound, within which an unknown lies at it",
        JUDGEMENT,
    )
    same_optimum: float = threshold(
        1e-2,
        "log-likelihood",
        "between the ends of two searches, within which they are one",
        JUDGEMENT,
    )
    open_towards_zero: float = threshold(
        5.0,
        "std of log(value)",
        "above which a value may as well be zero",
        JUDGEMENT,
    )
    settled_weights: float = threshold(
        1e-9,
        "relative change",
        "of the variances of the outputs, that ends their iteration",
        ROUNDING,
    )
    smallest_std: float = threshold(
        1e-9,
        "share",
        "of the rms of an output, that its noise is at least: keeps data without noise finite",
        ROUNDING,
    )
    interval_level: float = threshold(
        0.95,
        "probability",
        "that an interval of the profile likelihood is to hold",
        "definition",
    )
    interval_accuracy: float = threshold(
        0.01,
        "share",
        "of the threshold of an interval, to which its crossing is found",
        JUDGEMENT,
    )
    better_optimum: float = threshold(
        0.05,
        "log-likelihood",
        "by which a value of a profile must be more likely than the estimate to be a better optimum",
        JUDGEMENT,
    )
    substep_change: float = threshold(
        0.2,
        "log-likelihood",
        "by which halving the substeps may change it, and again per 1000 samples",
        JUDGEMENT,
    )
    worse_filter: float = threshold(
        2.0,
        "log-likelihood",
        "by which the extended filter may fall short of the observer that it started from",
        JUDGEMENT,
    )
    rough_substeps: float = threshold(
        10.0,
        "times the substep change",
        "that the shortest substeps may still leave: far below a standard error",
        JUDGEMENT,
    )
    parabolic_end: float = threshold(
        0.15,
        "share",
        "by which the root of the drop at the end of an interval may differ from that of a parabola",
        "analysis: with 15 % more or less, 1.2 to 4.9 % lie beyond it instead of 2.5 %",
    )
    state_range: float = threshold(
        1e3, "scales of a state", "within which its initial value is searched", JUDGEMENT
    )
    runaway: float = threshold(
        1e14,
        "condition number",
        "of the covariance of simulation errors, beyond which the trajectory has run away",
        ROUNDING,
    )
    poor_simulation: float = threshold(
        0.5,
        "share",
        "of the spread of an output: a simulation that leaves more is tried by multiple shooting",
        JUDGEMENT,
    )
    same_shooting: float = threshold(
        1.0,
        "log-likelihood",
        "between joined segments and the simulation that they lead to, within which they are one",
        JUDGEMENT,
    )
    continuous: float = threshold(
        1e-6, "scales of a state", "of a gap between segments that counts as none", JUDGEMENT
    )
    nearly_continuous: float = threshold(
        1e-4, "scales of a state", "of the largest gap of segments that are joined all the same", JUDGEMENT
    )
    leading_loss: float = threshold(
        1.0,
        "log-likelihood",
        "that a predictor may be worse by than the one that leans more on the record",
        JUDGEMENT,
    )
    round_gain: float = threshold(
        0.2,
        "log-likelihood",
        "below which a round of noise levels and parameters in turn is the last",
        JUDGEMENT,
    )
    good_transfer: float = threshold(
        60.0,
        "percent of fit",
        "from which a transfer function of the physical order stands for the data in a start value",
        JUDGEMENT,
    )
    grid: float = threshold(1e-3, "share", "of a step, within which samples lie on a uniform grid", JUDGEMENT)
    same_step: float = threshold(
        1e-8, "share", "of the median step, within which two steps share a sampled model", ROUNDING
    )
    filter_substeps: float = threshold(
        0.02,
        "standard deviations",
        "of an estimate, rms: halving the substeps of a filter changes it by less",
        JUDGEMENT,
    )
    start_width: float = threshold(
        10.0,
        "standard deviations",
        "of the first smoothed state, with which a filter starts where its start is unknown",
        "analysis: 1 % of the information, narrow enough for sigma points",
    )
    warm_gain: float = threshold(
        0.02,
        "log-likelihood",
        "that the next step promises, below which a search from a similar model ends",
        JUDGEMENT,
    )
    rough_gain: float = threshold(
        1.0,
        "log-likelihood",
        "that the next step promises, below which the first, rough search of a refit ends",
        JUDGEMENT,
    )
    refit_round_gain: float = threshold(
        1.0, "log-likelihood", "below which a round of a refit is the last", JUDGEMENT
    )
    explained_noise: float = threshold(
        1e-6, "share", "of the noise intensity of a similar model, which stands for next to none", JUDGEMENT
    )
    noise_range: float = threshold(
        1e6,
        "factor",
        "about its start, both ways, within which a noise is searched by the extended filter",
        JUDGEMENT,
    )
    least_felt_noise: float = threshold(
        1e-3, "share", "of the intensity that outputs feel, below which no estimated noise starts", JUDGEMENT
    )
    settled_covariance: float = threshold(
        1e-11,
        "standard deviations",
        "distance to the stationary covariance at which a transient ends",
        ROUNDING,
    )
    died_out: float = threshold(
        1e-13,
        "share",
        "of the size of every state, below which an unknown direction or the mean has died out",
        ROUNDING,
    )
    settled_smoother: float = threshold(
        1e-12,
        "share",
        "distance of the information of the future to its stationary value at which a transient ends",
        ROUNDING,
    )
    equal_periods: float = threshold(
        1e-7, "share", "of the mean step, within which two steps are one", ROUNDING
    )
    model_period: float = threshold(
        1e-6,
        "share",
        "difference of a step of the record to the period of its model that is allowed",
        ROUNDING,
    )
    named_state: float = threshold(
        0.05,
        "share",
        "of the largest part of a combination of states, from which a state is named in it",
        JUDGEMENT,
    )
    agreement_gain: float = threshold(
        0.1,
        "log-likelihood",
        "that ends the search for the initial states that an agreement is judged from",
        "analysis: 1e-5 of the error",
    )
    fading: float = threshold(
        1e-2,
        "share",
        "of its size that an assumed noise keeps from each further round to the next",
        JUDGEMENT,
    )
    resampled_below: float = threshold(
        0.5,
        "share",
        "of the particles that are effective, below which they are drawn anew",
        "Arulampalam et al. (2002): half",
    )
    collapsed_below: float = threshold(
        5.0,
        "effective particles",
        "below which the estimate of a sample is that of a few lucky ones",
        JUDGEMENT,
    )
    profile_gain: float = threshold(
        1e-4, "log-likelihood", "that ends the searches over the other unknowns of a profile", JUDGEMENT
    )
    open_interval: float = threshold(
        100.0,
        "scales of z",
        "from which on one side an interval of a linear coordinate counts as open",
        JUDGEMENT,
    )
    constant_input: float = threshold(
        1e-9, "share", "of its size, within which an input is constant", ROUNDING
    )
    jump_kept: float = threshold(
        0.5,
        "share",
        "of a difference of residuals that is left at a thousandth of the distance where there is a jump",
        "analysis: 0.001 of a slope is left",
    )
    least_jump: float = threshold(1e-9, "residual", "that counts as a jump at a switching surface", ROUNDING)
    singular_pivot: float = threshold(
        1e-14, "share", "of its diagonal, below which the pivot of a covariance is rounding", ROUNDING
    )
    refined_denominator: float = threshold(
        1e-6,
        "share",
        "by which a pass changes the denominator, below which a refinement has ended",
        JUDGEMENT,
    )
    slowest_pole: float = threshold(
        1e-3,
        "share",
        "of the lowest frequency that poles of the prefilter stand in the left half plane at least",
        JUDGEMENT,
    )
    unmeasured_noise: float = threshold(
        1e-3,
        "share",
        "of the noise of the outputs that stands for the noise of states, which have no measurements",
        JUDGEMENT,
    )
    std_step: float = threshold(
        0.1,
        "share",
        "of the first step of a search over process noises that measurement noises take",
        JUDGEMENT,
    )
    least_refitted: float = threshold(
        0.5, "share", "of the refits of a bootstrap that must come to an end", JUDGEMENT
    )
    forgotten_start: float = threshold(
        1e-20, "share", "of the scale of a state, below which the initial state is forgotten", ROUNDING
    )
    steady_gain: float = threshold(
        0.01, "share", "of the stationary gain, within which a gain counts as steady", JUDGEMENT
    )
    start_rank: float = threshold(
        1e-9,
        "share",
        "of the largest singular value of the regression on the initial state, below which it shows nothing",
        ROUNDING,
    )
    well_conditioned: float = threshold(
        1e3,
        "condition number",
        "below which normal equations of the regression on the initial state are accurate",
        ROUNDING,
    )
    root_died_out: float = threshold(
        1e-9,
        "share",
        "of the size of every state, below which a direction of a root of a covariance has died out",
        ROUNDING,
    )


FIT = FitGates()
