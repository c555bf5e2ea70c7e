"""One error tree, and the catalogue of message codes behind ``daest explain``.

Every error says what happened, where (file, line, column, variable) and how to mend it. A command shows it
as one message and ends with exit code 2; a program catches `DaestError` and reads its fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


def printable(text: str) -> str:
    """Text of a file or of a foreign program for a message or a terminal: what would move the cursor, colour
    or hide something, or break the line, is written as an escape."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


@dataclass(frozen=True)
class Place:
    """A position in a user's file; line and column count from 1."""

    file: str
    line: int | None = None
    column: int | None = None

    def __str__(self) -> str:
        parts = [self.file]
        if self.line is not None:
            parts.append(str(self.line))
            if self.column is not None:
                parts.append(str(self.column))
        return ":".join(parts)


class DaestError(Exception):
    """Something could not be done. `code` is a key of `EXPLANATIONS`; `remedy` says what to do. An error that
    tells several has them in `problems`."""

    def __init__(
        self,
        code: str,
        what: str,
        *,
        where: Place | str | None = None,
        remedy: str = "",
        problems: Sequence[DaestError] = (),
    ) -> None:
        super().__init__(what)
        self.code = code
        self.what = what
        self.where = where
        self.remedy = remedy
        self.problems = tuple(problems)

    def __str__(self) -> str:
        lines = [f"error[{self.code}]: {self.what}"]
        if self.where is not None:
            lines.append(f"  --> {self.where}")
        if self.remedy:
            lines.append(f"  help: {self.remedy}")
        return "\n".join(printable(line) for line in "\n".join(lines).split("\n"))

    def __reduce__(self) -> tuple:
        return _rebuild, (type(self), self.code, self.what, self.where, self.remedy, self.problems)


def _rebuild(
    kind: type[DaestError],
    code: str,
    what: str,
    where: Place | str | None,
    remedy: str,
    problems: Sequence[DaestError],
) -> DaestError:
    return kind(code, what, where=where, remedy=remedy, problems=problems)


class ModelError(DaestError):
    """The Modelica source, or the model made from it, cannot be used."""


class FmuError(DaestError):
    """An FMU cannot be written, read or run."""


class DataError(DaestError):
    """A recording cannot be used."""


class ConfigError(DaestError):
    """`daest.toml` or an option of a command is wrong."""


class EstimationError(DaestError):
    """The data and the model do not allow the estimate that was asked for."""


class NumericalError(DaestError):
    """A computation has no reliable answer; the message names the decision that failed."""


EXPLANATIONS: dict[str, str] = {
    # Sorted by code. Each text: what it means, why it matters, what to do.
    "app-busy": (
        "The page starts one command at a time in a folder, so that results do not overtake each other. Wait "
        "until the command that runs has ended, or stop it; what a stopped search has done is kept."
    ),
    "app-file": (
        "A file that was dropped onto the page is kept in the folder of the project under its own name if it "
        "is a model or a recording, if its name is a plain one, and if the folder has no other file of that "
        "name. Rename it, or copy it yourself."
    ),
    "app-folder": (
        "daest app shows the project of a folder, which must exist; an empty folder will do, a model and a "
        "recording can be dropped onto the page."
    ),
    "app-folder-gone": (
        "The folder that the page shows was removed, renamed or unmounted while the server ran. Nothing is "
        "written elsewhere. Put it back, or end the server and start it where the project is now."
    ),
    "app-port": (
        "The system does not let daest app listen on the port of --port: another program does already, or "
        "numbers below 1024 need rights. Without --port a free one is taken."
    ),
    "app-request": (
        "The page asked for something that the project does not have (any more): a step, a candidate, a "
        "parameter or a file. It shows an older state; load it again."
    ),
    "app-running": (
        "One server at a time serves a folder; any number of pages may show it. Open the address that the "
        "message names, or end that server."
    ),
    "at-without-values": (
        "The file of --at must hold parameters (as results/fit.json does) or an operating point under the "
        "key at, values by the names of unknowns and inputs."
    ),
    "bootstrap-failed": (
        "Most recordings that the fitted model makes cannot be identified again, so that no interval can be "
        "told: the data leave directions free, or the fit sits where the model can hardly be simulated."
    ),
    "check-clock-duplicate": (
        "Two samples of a recording have the same time, so that nothing can be said about what happened "
        "between them. Recorders that write faster than their clock ticks do this. Remove one of them, or "
        "number the rows. A single row beside a step that leaves one out came late or early: it is taken in "
        "the middle of that step."
    ),
    "check-clock-gap": (
        "Single samples are left out. Filters and identification take the times as they are; an input is "
        "unknown in the gap, and is taken as held or as a straight line."
    ),
    "check-clock-jitter": (
        "The samples are not at equal distances. That is taken into account everywhere; only ARX models and "
        "the stationary filter need even times, which --resample makes."
    ),
    "check-clock-jump": (
        "The time jumps by many steps: the recorder was paused, or two recordings were put one behind the "
        "other. Make two files of it, which are two experiments, or cut with --from and --to."
    ),
    "check-clock-order": (
        "The time goes back or is missing in some rows. Sort the rows; two recordings belong in two files."
    ),
    "check-clock-rate": (
        "The two halves of a recording have different sampling periods: the recorder was set anew, or "
        "the time is not in seconds throughout."
    ),
    "check-computed": (
        "A column is computed from another one: a copy of it, scaled or late, or its difference quotients. "
        "It holds no measurement of its own, and its errors are those of the other. Leave one of the two out "
        "of the outputs: identification would take one measurement for two, and its standard errors would be "
        "too small."
    ),
    "check-constant": (
        "A column never changes. An output that does not move tells nothing about any parameter: the sensor "
        "may be off."
    ),
    "check-copied": (
        "Cells of an input were filled in from an output, or the other way round: both are the same to the "
        "last digit in long stretches in which they move, and differ elsewhere. The model is driven there by "
        "what it is compared with, and an effect that lets the input decide explains the output without any "
        "physics. Leave these cells of the output empty, or say in the model what the input does there, as a "
        "pipe that gives no heat while no water flows."
    ),
    "check-dropouts": (
        "A signal jumps to one and the same value for a few samples and comes back: a loose contact, or a "
        "value that the recorder writes where it has none. Leave those cells empty, which means that the "
        "sample is missing."
    ),
    "check-few-samples": (
        "The recording has so few samples that faults cannot be told from the signal, and hardly more than "
        "one or two parameters be estimated. Record longer, or at a shorter period."
    ),
    "check-input-unseen": (
        "An input has another value after a pause of the clock than before. Between two samples it is held "
        "or runs straight, whichever the model simulates better with, and neither is what happened: the "
        "machine has moved under an input that nobody recorded. Cut the recording there with --from and "
        "--to, or make two files of it, which are two experiments with initial states of their own."
    ),
    "check-interpolated": (
        "An output runs on straight lines between every so many samples: a slower logger was interpolated to "
        "the rows of a faster one. What stands between two readings has no noise, and tests that count it as "
        "measured see loads in every kink. Leave those cells empty: outputs may lack values, and the inputs "
        "keep all of theirs. Or take --resample with the period of the readings."
    ),
    "check-lag": (
        "One column is another one, later by a fixed time. That may be the machine; if both are sensors of "
        "one quantity, their clocks differ, and identification would put the lag into the parameters. Shift "
        "one column, or let daest diagnose try a delay."
    ),
    "check-missing": (
        "Some values of a column are missing. Outputs may lack values; inputs must be known at every time."
    ),
    "check-model-clock": (
        "Units of parameters tell that the equations count time in hours, as in `C*der(T) = Q` with "
        "C in kW.h/K and Q in kW, or where all rates are in 1/h. A column of the time that tells its unit, "
        "as `time [min]` does, or that holds dates, is read in hours then, and so are --from, --to and "
        "--resample. One without a unit counts hours as it stands."
    ),
    "check-outliers": (
        "Single samples, or bursts of a few, lie far from their neighbours, farther than noise does, or an "
        "output runs off and comes back while nothing else moves. Least squares follow them. "
        "Leave those cells empty if the machine cannot have moved so."
    ),
    "check-polarity": (
        "A signal moves the other way than it should: against the model at any likely value of its "
        "parameters, or against another column of the same quantity; of several inputs one that, turned, "
        "leaves far less of the errors of a simulation. Look at the sensor's wiring and the "
        "sign convention of the model; multiply the column by -1, or the parameter that is a gain."
    ),
    "check-quantised": (
        "A signal changes in steps of its resolution. The error of a sample then is neither Gaussian nor "
        "independent of its neighbours, and the standard errors of an estimate are too small. A finer "
        "sensor, or --resample to a longer period, helps."
    ),
    "check-repeated": (
        "What validates a fit stands in a recording that it was made from, too: one file is a part of the "
        "other, or a copy. Errors on such samples are not those on unseen data, and tests on them refuse "
        "nothing. Leave one of the two out, or cut them with --from and --to."
    ),
    "check-saturation": (
        "A signal runs into a limit and stays there, and comes back as fast as it went: the range of the "
        "sensor or of the recorder. Leave those cells empty, or cut with --from and --to. A command that is "
        "limited and recorded as such is in order."
    ),
    "check-scale": (
        "An output moves as in the model, but is as many times larger or smaller as its numbers would be in "
        "another unit: degrees for radians, mm for m. Write the unit into the header (`phi [deg]`) or into "
        "[data.units] of daest.toml. Start values that are far off do the same to all outputs."
    ),
    "check-set-point": (
        "An output follows an input of another kind of quantity in numbers: settled, both columns are the "
        "same at all levels, with nothing added, and the model at its values has another gain. A controller "
        "does that, and the column is then its set point, not the voltage or the flow that drives the "
        "machine; effects that are found with it may be those of the controller. Record what the controller "
        "gives the machine, or write the controller into the model. A machine may have this gain by chance: "
        "values of the parameters with which the model has it, too, end the warning."
    ),
    "check-sign-lost": (
        "An output is never below zero, and as large where the model has it negative as where it has it "
        "positive, at any likely value of the parameters: a pulse counter, or the current that a bridge "
        "reports, tells a magnitude. Measure it in the model, too, as `y = abs(i)`, or record the sign. Or "
        "the only input that moves stays on one side of zero, and the model moves an output one way alone "
        "with it, while the recording comes back: the duty of a bridge that has a pin for the direction. "
        "Record the input with its sign."
    ),
    "check-stuck": (
        "A signal stands still to the last digit although its noise shows elsewhere, or jumps when it goes "
        "on: the sensor or its transmission had stopped. Leave those cells empty. An output that rests while "
        "all inputs of the model are zero is not told."
    ),
    "check-text": ("Some cells of a column hold a text where numbers are expected."),
    "check-time-unit": (
        "Nothing tells the unit of the time: not the header, not the end of its name, and the values are no "
        "dates. It is read as seconds. Where it counts milliseconds or samples, every time constant of the "
        "model would come out wrong by that factor: write the unit into the header (`t [ms]`) or into "
        "[data.units] of daest.toml."
    ),
    "check-turns": (
        "An angle goes round many times. A simulation adds up the errors of its speed, so that model and "
        "measurement drift apart in the angle although the speed agrees. Take the speed as the output, or "
        "estimate from one-step predictions (--method pem), which are corrected by every measured angle."
    ),
    "check-unit-unknown": (
        "A column has a unit, and the input or output of the model that it belongs to has none. The values "
        "are taken as they stand, so the model must be written in the unit of the column. Declare the unit "
        'in the model, `Real pos(unit = "m")`: then values are converted.'
    ),
    "check-unusable": (
        "The recording cannot be used with the model; the message says why, as daest identify would."
    ),
    "check-wrapped": (
        "An angle is recorded between two limits a turn apart and begins again there, as the heading of a "
        "compass, or what atan2 gives. The angle of a model counts on, so that its error grows by a turn at "
        "each jump, and a fit means nothing. Add a turn at each jump back (numpy.unwrap, or MATLAB, "
        "in radians), or take the rate of turn as the output."
    ),
    "cluster-differs": (
        "A worker of the cluster has other versions of daest or of the packages that numbers depend on, or "
        "no C compiler where this machine has one: its results might be others. Install the same there, and "
        "restart the workers."
    ),
    "cluster-lost": (
        "The scheduler or all workers of the cluster have gone while they were working. Start them again and "
        "repeat the command; diagnose and improve go on where they were."
    ),
    "cluster-unreachable": (
        "--cluster names the scheduler of a Dask cluster (tcp://HOST:8786), which dask scheduler shows when "
        "it starts; dask worker ADDRESS adds workers to it. Nothing answered there, or no worker has come."
    ),
    "cluster-without-dask": (
        "Dask is an extra of daest, since most work needs one machine alone: pip install 'daest[cluster]', "
        "here and on every machine of the cluster."
    ),
    "compare-bootstrap-noise": (
        "A bootstrap simulates records with the model, noise included, so that every output needs a known "
        "measurement noise: identify the model first, or give it in the model or under [noise.measurement]."
    ),
    "compare-missing-output": (
        "The models that are compared must have the outputs of the first one in common. [data] outputs in "
        "daest.toml can declare any variable of a model as an output."
    ),
    "compilation-failed": (
        "The C compiler did not accept generated code, or did not run. The message shows its own words. "
        "Setting the environment variable CC to another compiler, or installing daest[compiler], often "
        "helps."
    ),
    "config-exists": (
        "daest init does not overwrite a daest.toml. Remove the old one, or write another with -p FILE."
    ),
    "config-missing": (
        "The daest.toml that was named with -p does not exist. daest init writes one from a model and a "
        "recording."
    ),
    "config-syntax": (
        "daest.toml is not valid TOML. The message names line and column; https://toml.io describes the "
        "syntax."
    ),
    "config-type": (
        "A value in daest.toml has the wrong type: a text where a number is expected, say. The message "
        "names what belongs there."
    ),
    "config-unknown-key": (
        "A key or section of daest.toml is not known; probably it is misspelt. Unknown keys are refused "
        "because a misspelt bound would otherwise be ignored in silence."
    ),
    "config-unknown-parameter": (
        "[parameters] of daest.toml names a parameter that the model does not have, or that the model "
        "computes from others. The message names the nearest ones."
    ),
    "config-value": (
        "A value in daest.toml contradicts another: a start outside its bounds, min above max, both a split "
        "and validation files."
    ),
    "controller-fit": (
        "The model of a controller is tied to the model of the machine by names. Its outputs are called like "
        "the inputs that it moves, its inputs like the variables that it reads; a further input is its "
        "reference, which the experiment plays."
    ),
    "data-all-missing": (
        "An output column holds no value at all in the part of the recording that is used. Remove the "
        "column from the mapping or choose another window."
    ),
    "data-duplicate-column": (
        "Two columns of a file have the same name, so it is unknown which one is meant. Rename or remove one."
    ),
    "data-empty-file": (
        "The file holds no data. A recording needs a header row with names, a column time, and at least two "
        "rows of numbers."
    ),
    "data-encoding": (
        "The file is no text: neither UTF-8, nor UTF-16 with a byte order mark, nor Windows-1252. Save it as "
        "UTF-8; many spreadsheet programs offer this when they write CSV."
    ),
    "data-frame": (
        "A Dataset of several dimensions is no recording: every signal must have one value per time. Select "
        "the variables with the dimension time alone."
    ),
    "data-infinite": "A column holds an infinite number. A missing value is an empty cell.",
    "data-input-gap": (
        "A value of an input is missing. Outputs may be missing, but the model must be driven at every "
        "time, and daest does not invent an input. Fill the gap or cut it off with --from and --to."
    ),
    "data-input-missing": (
        "The recording has no signal for an input of the model. Map a column to it in daest.toml, [data] "
        "inputs, or on the command line."
    ),
    "data-missing-file": (
        "A recording that was named on the command line or in daest.toml does not exist. Paths in "
        "daest.toml count from the folder of that file."
    ),
    "data-needs-h5py": (
        "MATLAB files of version 7.3 are HDF5 files, read with h5py, which is an optional part of the "
        "installation: pip install 'daest[hdf5]'. Files up to version 7 need nothing."
    ),
    "data-needs-openpyxl": (
        "Excel workbooks are read with openpyxl, which is an optional part of the installation: pip install "
        "'daest[excel]'. CSV needs nothing."
    ),
    "data-needs-pyarrow": (
        "Parquet files are read through pandas, which is an optional part of the installation: "
        "pip install 'daest[parquet]'."
    ),
    "data-no-header": (
        "The first row of a CSV file must hold the names of the columns, with the unit behind the name if "
        "it is not the unit of the model: time,u,omega [rad/s]."
    ),
    "data-no-output": (
        "No column of the recording is a measured output of the model. Columns are matched by name; other "
        "names are mapped in daest.toml under [data] outputs."
    ),
    "data-no-time": (
        "A recording needs a column time or time_s in seconds (time_ms, time [ms], time_min and time_h are "
        "converted). Its values must increase; the steps may differ."
    ),
    "data-not-given": "The command needs a recording: name the file, or write [data] estimate in daest.toml.",
    "data-ragged-row": (
        "A row of a CSV file has another number of cells than the header. A missing value is an empty cell, "
        "not a missing separator; text with separators needs quotes."
    ),
    "data-split-too-short": (
        "The split leaves a part with fewer than two rows. Move it, or give a longer recording."
    ),
    "data-text": (
        "A cell of a column that is used holds text. Numbers have a decimal point; a missing value is an "
        "empty cell."
    ),
    "data-time-duplicate": (
        "Two rows have the same time, and no step beside them leaves one out, or too many have. Remove one "
        "of them; rows of two recordings belong in two files."
    ),
    "data-time-missing": "A row of the recording has no time. Every row needs one.",
    "data-time-not-increasing": (
        "The time goes back from one row to the next. Sort the rows; two recordings belong in two files."
    ),
    "data-too-few-rows": "The recording, or what is left of it after cutting and resampling, is too short.",
    "data-two-time-columns": (
        "Several columns are the time by their names (time, time_s, time_ms). Keep one and rename the others."
    ),
    "data-unit-twice": (
        "A unit stands in the header of a column and another one in the row below it, so it is unknown "
        "which one is meant. Keep one of them."
    ),
    "data-unknown-column": (
        "A column that was named, or that an input of the model needs, does not exist in the recording. "
        "Columns are matched with model names; other names are mapped in daest.toml under [data]."
    ),
    "data-unknown-format": (
        "Recordings are read by the ending of their files; the message names the endings that are known. "
        "Save the recording as one of them, CSV for example."
    ),
    "data-unreadable-file": (
        "A MATLAB or Parquet file is damaged or of a version that cannot be read. MATLAB 7.3 files are not "
        "read: save with the option -v7."
    ),
    "data-window-empty": (
        "Fewer than two rows lie between --from and --to. The message names the times of the recording."
    ),
    "design-limit": (
        "A limit of the experiment leaves nothing that could be played: a range that is empty or upside "
        "down, inputs that may not move, a rate that is not positive, or a band without a frequency. Give "
        "--limit NAME=LOW,HIGH, --rate NAME=RATE and --band LOW,HIGH."
    ),
    "design-limit-unknown": (
        "--limit and --rate take names of inputs and of variables of the model, as daest linearize lists "
        "them."
    ),
    "design-limits-unknown": (
        "An experiment needs a length and a period. They are taken from the recording; without one, give "
        "--length and --period, and a --limit for every input."
    ),
    "design-no-input": (
        "The model has no input, so that no experiment could move it. Declare what you can move on the "
        "machine as an input."
    ),
    "design-no-noise": (
        "How much an experiment tells depends on the noise of the sensors. It is known after daest identify, "
        "or from [noise.measurement] in daest.toml; a model without any measured output tells nothing."
    ),
    "design-no-rivals": (
        "--rivals tells models apart that a diagnosis could not. results/diagnosis.json holds no two such "
        "candidates that can be built and driven: run daest diagnose, or design for --parameters or --detect."
    ),
    "design-no-size": (
        "The effect has no size parameter with a start value, so that there is no size that could be seen."
    ),
    "design-nothing": (
        "Within the limits there is no input that the model can be driven with, or that stays in the safe "
        "ranges. Widen them, or make the experiment longer or shorter."
    ),
    "design-one-aim": "An experiment is designed for one aim: --rivals, --parameters or --detect.",
    "design-same-equation": (
        "Two rivals do the same whatever is played: with other parameters one of them is the other one, for "
        "these sensors. No input can tell them apart; a sensor between their places, or a parameter that is "
        "known from elsewhere, may."
    ),
    "design-too-short": (
        "An experiment needs some twenty sample intervals at least. Give a longer --length or a shorter "
        "--period."
    ),
    "design-unsafe": (
        "The model leaves a safe range although nothing is played. Widen the range, move those of the "
        "inputs, or give the controller that holds the machine there (--controller) and design its reference."
    ),
    "design-unstable": (
        "Left to itself the model runs away long before the experiment ends: what is expected of it then "
        "holds for no machine. Give the controller (--controller FILE.mo) and design its reference; or give "
        "safe ranges."
    ),
    "diagnose-fmu-search": (
        "Nothing can be put between the parts of an FMU without equations. Only effects that act at its "
        "inputs or outputs can be tried, those that the library marks `outside`; the message lists them."
    ),
    "diagnose-gaps": (
        "The residual of an FMU without equations is whitened by an autoregression, which needs every "
        "sample. Choose a part of the recording without missing values, or resample it."
    ),
    "diagnose-no-candidate": (
        "No effect of the library fits any of the places that were asked for. daest effects NAME --model "
        "MODEL lists the places of an effect; without --effect and --at everything is tried everywhere."
    ),
    "diagnose-no-place": (
        "A missing effect is looked for as an unknown load first, a force, torque, current or flow at some "
        "place of the model, and none that is admissible would reach the measured outputs. Measure an output "
        "that the model moves; daest noise shows where a load is admissible."
    ),
    "diagnose-too-short": (
        "A missing effect shows as a pattern in prediction errors, and too few samples hold no pattern. "
        "Record longer, through the whole range of the machine, in both directions and through rest; part of "
        "the recording is kept for validation."
    ),
    "diagnose-unseen": (
        "Nothing could be found: either the measured outputs do not change at all, or at the places that "
        "were asked for the parameters that are estimated do the same. Choose a recording in which the "
        "machine moves, measure a motion, force or current nearer to the place, or fix parameters that are "
        "known."
    ),
    "effect-ambiguous": (
        "Several domains have an effect of that name, and the place does not tell which is meant. Write "
        "more of its class name, such as Rotational.CoulombFriction."
    ),
    "effect-annotation": (
        "The vendor annotation __Daest(effect = true, ...) of a class of the effect library is incomplete "
        "or wrong. It needs attach and law, and a parameter of role size at whose null value the effect "
        "vanishes. daest effects -h and the README of the library show an example."
    ),
    "effect-fit": (
        "An effect fits where the model has a connector, input or output of its kind: friction on a flange, "
        "a voltage drop in series with a pin. The message lists the places of this model where it fits; "
        "daest effects NAME MODEL lists them too."
    ),
    "effect-input-used": (
        "An effect on an input or output is written into the Modelica model by breaking the connection of "
        "that signal, or by opening the equations that use it in the copy that is written. Here they "
        "stand in several classes, in a loop, a branch or a package, where nothing can be put in between. "
        "Connect the input to a block or source, or compare the models without writing the extension."
    ),
    "effect-law-outside": (
        "An effect of the library is marked `outside`, so that it is tried at the inputs or outputs of FMUs "
        "without equations, but its equations are not of the form that this needs: one formula of one "
        "variable for what it adds. Write it so, or leave out `outside`."
    ),
    "effect-name": (
        "The extended model needs a name for the effect's component, for a new input or for the class "
        "itself, and the one that was given is taken. Without a name daest chooses a free one."
    ),
    "effect-no-source": (
        "An extended model is written in Modelica and needs the Modelica source of the model. An FMU holds "
        "equations only."
    ),
    "effect-not-writable": (
        "The effect can be attached to the equations, but it cannot be written as an extension of the model: "
        "the place lies inside of a component, or in an equation of a loop, a branch or a package, "
        "or a component of a library takes the parameter. Equations of the model itself, and parameters "
        "of components whose classes stand beside it, are opened for it in the copy that is written."
    ),
    "effect-parameter": (
        "The effect has no parameter of that name. daest effects NAME lists its parameters with their units."
    ),
    "effect-place": (
        "The model has no place of that name. Places are connectors (disc.flange_b), components with two "
        "ends (spring), inputs, outputs and parameters; the message lists those where the effect fits."
    ),
    "effect-present": (
        "A component at that place has exactly the equations of the effect. A second one would be the same "
        "friction, say, under another name, and the data could never tell them apart."
    ),
    "effect-unknown": (
        "The effect library has no class of that name. daest effects lists all of them; -L DIR adds a "
        "folder with classes of one's own."
    ),
    "estimator-nonlinear": (
        "The kalman and the stationary estimator are filters of linear models. daest export --estimator "
        "writes the extended (--kind ekf) or the unscented (--kind ukf) filter of a nonlinear one."
    ),
    "estimator-option": (
        "An option belongs to the export of an estimator and was given without --estimator, or the other "
        "way round; or nothing tells the expected time between two samples: give it with --step."
    ),
    "event-state": (
        "An event (reinit, or an assignment in a when-clause) gives a variable a value that several states "
        "decide together. Restart the variable that is differentiated, or mark it with stateSelect = "
        "StateSelect.always, so that it is a state itself."
    ),
    "events-chatter": (
        "A switch of the model goes to and fro without end: each event undoes the one before. Give the "
        "switch a hysteresis, or a mode that holds the motion, as friction that sticks."
    ),
    "events-do-not-settle": (
        "At an event the switches of the model find no common state: each update of the discrete variables "
        "changes another one. Look for two switches that undo each other, and use pre() of one of them."
    ),
    "events-need-compiler": (
        "Models with events are simulated by compiled code. Install a compiler: pip install daest[compiler]."
    ),
    "events-not-supported": (
        "The model has when-clauses, reinit, pre or sample. Simulation follows them, linearize and noise "
        "take the mode of the start, identify fits the whole simulation (oe); filters follow them, too. "
        "Diagnosis, in rounds too, and comparison judge the whole simulation. Fits of predictions from "
        "sample to sample, exported estimators and loops with a controller of their own do not follow events."
    ),
    "events-sample-interval": (
        "sample(start, interval) was given an interval that is not positive. Give a positive time in seconds."
    ),
    "example-folder-exists": (
        "daest demo copies an example into a new folder and does not overwrite one. Remove it, or call it "
        "elsewhere."
    ),
    "example-unknown": "There is no shipped example of that name; daest demo without a name lists them.",
    "examples-missing": (
        "The folder with the examples is neither in the installed package nor beside its sources."
    ),
    "explain-unknown-code": (
        "daest explain knows the codes that stand in brackets behind the word error; without a code it "
        "lists all of them."
    ),
    "export-suffix": "Other tools know an FMU by the end of its name. Give one that ends in .fmu.",
    "export-to-stdout": "daest export writes a file; an FMU cannot be printed. Name it with -o model.fmu.",
    "file-refused": (
        "The operating system refuses a file or folder that is named: its name is too long, links lead in a "
        "circle, or rights are missing. The message names it and the reason."
    ),
    "files-too-many": (
        "More files were given than the command reads. Models (.mo, .bmo, .fmu) and recordings may stand in "
        "any order; the help of the command (-h) says how many of each it takes."
    ),
    "filter-events": (
        "A linear filter was asked for a model that changes at events (when, reinit, pre, sample). It knows "
        "one linear model, and the events change it. The extended, the unscented and the particle filter "
        "follow the events between samples: --kind ekf, ukf or particle."
    ),
    "filter-initial-state": (
        "The initial state of a filter does not have the size of the model's state, or gives an unknown "
        "state (infinite variance) a covariance with another one. Give one mean and one standard deviation "
        "per state."
    ),
    "filter-kind-unknown": "There is no filter of this name; the message names those that there are.",
    "filter-linear-model": (
        "The extended, unscented and particle filters need the equations of the model, and they were given "
        "its matrices alone. Give them the model that compile_model or load_fmu returns."
    ),
    "filter-no-stationary-gain": (
        "The Riccati equation of the stationary filter has no reliable solution although every state is seen "
        "and driven. Usually the noise covariances differ by too many powers of ten. Check them, or use the "
        "time-varying filter."
    ),
    "filter-noise-correlated": (
        "Filters of nonlinear models take noises that are independent of each other: one intensity per "
        "process noise and one variance per output. The time-varying filter takes full matrices."
    ),
    "filter-noise-unknown": (
        "A filter weighs model against measurement by the sizes of their noises, and one of them is not "
        "known. daest identify estimates them; daest.toml or the annotations of the model can give them."
    ),
    "filter-one-recording": "daest filter runs over one recording at a time; name the file.",
    "filter-singular-innovation": (
        "The model says that an output can be predicted without any error: neither the output nor the states "
        "behind it have noise. Give every measured output a standard deviation above zero."
    ),
    "filter-too-large": (
        "The covariances that this filter keeps, one for each sample, are larger than the memory of this "
        "machine. daest filter --kind stationary keeps one; the time-varying filter does, too, where steps "
        "are equal, no measured value is missing, no smoother is asked for, and there is a stationary filter."
    ),
    "filter-undriven-mode": (
        "A state that never settles by itself (a constant bias, an integrator) has no process noise. A "
        "stationary filter would in the end ignore the measurements about it. Give it a noise intensity, or "
        "use the time-varying filter, whose gain keeps falling as it should."
    ),
    "filter-uneven-samples": (
        "A filter with one sampled model, or a stationary filter, needs equal steps between the samples, and "
        "the record has others. Use the time-varying filter, which takes any steps, or resample the record."
    ),
    "filter-unknown-output": (
        "A filter can use only outputs that the model has and the recording holds. The message names those."
    ),
    "filter-unknown-variable": (
        "A variable that was asked for with --only is neither an internal variable nor an output of the "
        "model. The message names similar ones."
    ),
    "filter-unobservable": (
        "The outputs that are used do not show a combination of states that does not die out by itself, so "
        "that its error would never become bounded. Measure another output, or tie the combination down in "
        "the model."
    ),
    "fleet-empty": (
        "daest fleet takes recordings, one file for each machine, or folders that hold them. There is "
        "none among what was named."
    ),
    "fleet-nothing": (
        "No machine of the fleet could be examined. One broken recording does not stop a fleet, but here "
        "all of them fail, most likely for the same reason; the message has that of the first."
    ),
    "fmu-array-variable": (
        "A state, input or output of the FMU is an array, or belongs to a clock. Only scalar continuous "
        "variables can be used; most tools have an option that exports arrays element by element."
    ),
    "fmu-binary-not-loaded": (
        "The library inside the FMU could not be loaded or did not start. Often it needs another library "
        "that is not on this machine, such as a Fortran runtime. Export the FMU again for this platform."
    ),
    "fmu-call-failed": (
        "The FMU refused a call; the message holds what it said itself. Values outside the range in which "
        "the model can be evaluated are the usual cause."
    ),
    "fmu-clocked": (
        "Some variables of the FMU change at the ticks of a clock that the importing tool has to provide. "
        "Without the ticks they would stand still, and results would be wrong without a message. Export the "
        "FMU with its sampling inside, or as a continuous model."
    ),
    "fmu-co-simulation-only": (
        "An FMU for Co-Simulation integrates its equations by itself and shows no states and no "
        "derivatives. It can be simulated, identified by output error and compared; matrices, noise "
        "verdicts and filters need Model Exchange."
    ),
    "fmu-code-generation": (
        "CasADi could not write C code for the index-reduced model. The message names the operation."
    ),
    "fmu-crashed": (
        "The code inside an FMU crashed. It runs in a process of its own, so that nothing else was "
        "harmed. The message says what it was doing; other parameter values, inputs or an operating point "
        "may help, else the tool that wrote it must mend it."
    ),
    "fmu-dae-not-square": (
        "The fmi-ls-dae manifest of the FMU lists another number of residuals than of unknowns, so it "
        "describes no solvable system."
    ),
    "fmu-damaged": "The archive of the FMU is damaged. Export or copy it again.",
    "fmu-empty-file": "The FMU is a file of length zero; the export or the copy was interrupted.",
    "fmu-exited": (
        "The code inside an FMU ended its process instead of answering. Some tools do so when a licence "
        "or a file is missing; the message shows what it printed last."
    ),
    "fmu-fmi-1": (
        "FMI 1.0 knows no derivatives with respect to inputs and states. Export the FMU as FMI 2.0 or 3.0."
    ),
    "fmu-hangs": (
        "A single call into the FMU did not come back in time. The environment variable DAEST_FMU_SECONDS "
        "sets how long a call may take (60 s by default)."
    ),
    "fmu-headers-missing": (
        "The C headers of FMI are taken from the package fmpy, which is not installed completely."
    ),
    "fmu-inconsistent": (
        "The modelDescription.xml of the FMU contradicts itself: a reference that names nothing, say."
    ),
    "fmu-limit": (
        "DAEST_FMU_SECONDS, DAEST_FMU_TOTAL_SECONDS and DAEST_FMU_MEMORY (in MB) set the limits of the "
        "process that runs an FMU; all are positive numbers."
    ),
    "fmu-memory": (
        "The process that runs the FMU reached its limit of memory. The environment variable "
        "DAEST_FMU_MEMORY sets it, in MB (8590 by default)."
    ),
    "fmu-missing-file": "The FMU that was named does not exist.",
    "fmu-name-twice": (
        "Two variables would have the same name in the FMU. Names such as _residual[1] and der(x) are taken "
        "by the export; rename the variable of the model."
    ),
    "fmu-no-equations": (
        "The FMU was made by another tool and carries no equations, so that nothing can be put between "
        "its parts. daest diagnose tries what can act at its inputs and outputs; extend and improve need "
        "the Modelica source or an FMU of daest export."
    ),
    "fmu-no-symbolic-model": (
        "The command needs the equations as expressions. They travel in FMUs written by daest export; the "
        "FMUs of other tools have matrices alone, which linearize and noise can use."
    ),
    "fmu-not-an-archive": (
        "An FMU is a zip archive, and this file is none. A download that was cut off looks like this."
    ),
    "fmu-not-repeatable": (
        "The same simulation of an FMU, asked for twice, gave different answers, so that no search can "
        "compare parameter values by it. It may draw random numbers, read a clock, or keep values from one "
        "instance to the next."
    ),
    "fmu-not-written": "The FMU could not be written to the place that was named.",
    "fmu-nothing-continuous": (
        "A linear model relates continuous variables, and the description of this FMU names none: it is "
        "purely discrete, or all is hidden."
    ),
    "fmu-platform-unknown": (
        "FMUs are compiled for linux64, win64, darwin64, linux-arm64, win-arm64 and darwin-arm64."
    ),
    "fmu-sandbox": (
        "DAEST_FMU_SANDBOX says how an FMU, which is foreign code, is confined: `on` (the default) as far "
        "as the operating system can, `off` not at all, `require` so that no FMU runs where it cannot be "
        "confined. daest check tells what holds."
    ),
    "fmu-scheduled-only": (
        "The FMU offers Scheduled Execution alone, which has no continuous time. Export it for Model "
        "Exchange."
    ),
    "fmu-source": (
        "The source of the matrices of an FMU is one of symbolic, fmi-ls-dae, directional derivatives and "
        "finite differences."
    ),
    "fmu-too-large": (
        "The archive would unpack to far more data than an FMU holds. Such files are made to fill a disk."
    ),
    "fmu-too-long": (
        "All simulations of an FMU together took longer than DAEST_FMU_TOTAL_SECONDS allows (12 hours by "
        "default)."
    ),
    "fmu-unsafe-path": (
        "The archive holds a file that would be written outside of its own folder. Do not use it unless you "
        "know where it comes from."
    ),
    "fmu-version": (
        "The file says that it follows an FMI version that daest does not know. FMI 2.0 and 3.0 are read."
    ),
    "fmu-without-binary": (
        "The FMU was compiled for other platforms only, or not at all. Export it for this platform: daest "
        "export MODEL.mo --platform ..."
    ),
    "fmu-without-description": (
        "The archive has no modelDescription.xml. Every FMU has one at its top level."
    ),
    "fmu-without-residuals": (
        "The FMU does not carry its equations as residuals (layered standard fmi-ls-dae). Its directional "
        "derivatives can be used instead."
    ),
    "fmu-writes-too-much": (
        "The FMU logged, printed or wrote to a file without end, and was stopped at 67 MB. Switch off its "
        "logging where it is exported."
    ),
    "fmu-xml": (
        "An XML file of the FMU is not well-formed, or declares a document type. No FMU needs one, and "
        "entities can be used to read foreign files."
    ),
    "given-form-without-tangents": (
        "The likelihood by an extended Kalman filter needs derivatives with respect to parameters, and a "
        "particle filter all internal variables at every particle; an FMU without equations gives "
        "neither."
    ),
    "identify-constant-input": (
        "Every input is constant, and no output settles from another state, as it does after a step before "
        "the first sample: nothing that is recorded moves the model, and its parameters leave no trace in "
        "the outputs. Record with an input that varies over the frequencies of interest."
    ),
    "identify-jump": (
        "An equation contains a step (sign, if, floor) that depends on the state. The exact derivatives that "
        "identification works with are blind to it: the size of a Coulomb friction written as sign(w) would "
        "seem to have no influence. Round the step over a width that is small beside the motion: "
        "tanh(w/width); about 1 % of the range of w is enough. Steps that only bend an equation, as an "
        "absolute value or a limit, are allowed."
    ),
    "identify-no-data": ("No recording was given to identify from."),
    "identify-no-influence": (
        "The measured outputs do not depend on a parameter that is to be estimated (their exact derivative "
        "is zero). Fix it to a known value, or measure an output that it moves."
    ),
    "identify-no-output": (
        "No output of the model has a measured value in the recordings. Check the mapping of columns to "
        "outputs, and empty cells."
    ),
    "identify-no-start": (
        "The outputs or their likelihood are not finite at the start values, so the search has nowhere to "
        "begin. A long simulation of an unstable model overflows, or ends in a singularity; the "
        "prediction-error method (pem) with a process noise ([noise.process]) leans on the record. "
        "Otherwise mend the start values."
    ),
    "identify-nothing-to-estimate": (
        "No parameter is marked as unknown. Mark parameters in the model by annotation(__Daest(estimate = "
        "true)), in daest.toml, or by --estimate."
    ),
    "identify-too-few-samples": (
        "There are not more measured values than unknowns (parameters, noises, and the initial states of "
        "every recording). Use a longer recording or estimate fewer parameters."
    ),
    "identify-unidentifiable": (
        "Some parameters enter the outputs only in a combination: they can change together without any "
        "effect, whatever the data. Fix one of them to a known value, or measure something that tells them "
        "apart."
    ),
    "improve-folder": (
        "daest improve writes its models, ledger.json and staircase.png into a folder of its own, and this "
        "one holds other files. A folder with the ledger of an earlier run is used again."
    ),
    "initial-not-solved": (
        "The nonlinear equations for the initial state were not solved from the given start values. Start "
        "values nearer to the solution help; so does fixing the variables that are known."
    ),
    "initial-overdetermined": (
        "Fixed start values and initial equations contradict each other, because constraints of the model "
        "tie the variables together. Leave as many fixed as the model has states, and no two that are tied."
    ),
    "input-derivative-hold": (
        "The model needs the time derivative of an input, and the input is taken as constant between "
        "samples (zero-order hold), which has none: it would jump at every sample. Use first-order hold."
    ),
    "input-derivative-order": (
        "The index reduction needs a second or higher time derivative of an input. From samples only the "
        "slope between two of them is known, so the model cannot be sampled. Make that derivative itself "
        "the input of the model, or feed the input through a lag."
    ),
    "integration-failed": (
        "The simulation or filter of a nonlinear model stopped on the way: its step became too small, or the "
        "model gave no finite value. A search steps back from such parameter values. At values that you "
        "chose, look at the state at the named time, and smooth discontinuities with a width."
    ),
    "internal-error": (
        "A fault of daest itself, not of your files. Set the environment variable DAEST_TRACEBACK=1 and run "
        "the command again to see where it happened; a report with that text helps to mend it."
    ),
    "linearization-not-finite": (
        "A coefficient of the linear model is infinite or undefined: the equation divides by zero, or "
        "takes the root or logarithm of a number out of range, at the operating point or with these "
        "parameters."
    ),
    "model-ambiguous": (
        "A file holds several models and it is not said which one is meant, or a short name fits several "
        "classes. Name the model with --class (or `class` in daest.toml) by its full name."
    ),
    "model-annotation": (
        "A `__Daest(...)` annotation cannot be used: a key or value is unknown, or it stands behind a "
        "declaration where it has no meaning. Parameters take estimate, scale, min, max; inputs noise, "
        "intensity, estimate; outputs std, estimate."
    ),
    "model-arithmetic": (
        "An expression cannot be computed while the model is read: a division by zero, sizes of arrays that "
        "do not fit, an index outside of its array, a size that depends on a variable."
    ),
    "model-break": (
        "A class removes a connection that it inherits, by extends Base(break connect(a, b)), but the "
        "connection cannot be found there, or the base class stands in another file, where it cannot be "
        "removed. Write the base class into the same file."
    ),
    "model-circular": (
        "A parameter or a Boolean is computed from itself, directly or through others. The message shows "
        "the circle; give one of them a value of its own."
    ),
    "model-compile": (
        "The Modelica compiler refused the model for a reason that has no message of its own here. The "
        "message quotes it."
    ),
    "model-compiler": (
        "The Modelica compiler itself broke. The model may be right; leave out parts until it compiles to "
        "find the construct that the compiler cannot do."
    ),
    "model-delay": (
        "delay(e, T) becomes linear equations for what e was over the last T seconds, so T has to be "
        "a positive number that follows from parameters. A time that moves needs a longest one: "
        "delay(e, T, Tmax) keeps the last Tmax seconds and reads at T."
    ),
    "model-der-expression": (
        "der() must be applied to a variable. Introduce a variable for the expression: `Real q = h*A;` and "
        "`der(q)`."
    ),
    "model-der-input": (
        "The derivative of an input or of a Boolean is asked for. An input is known at samples only; "
        "introduce a variable x = u, and its derivative is formed where the model needs it."
    ),
    "model-empty": "The model file holds nothing but white space.",
    "model-encoding": "A Modelica file must be UTF-8 text. Save it as UTF-8.",
    "model-file": (
        "What was named as a model is a folder, or cannot be read. A model is one .mo file; folders of "
        "libraries are given by -L."
    ),
    "model-function": (
        "A Modelica function cannot be executed symbolically: it is external, recurses without end, uses a "
        "variable before it has a value, or loops on a condition that depends on variables. Write it with "
        "assignments, if, and for-loops over constant ranges, or replace the call by its formula. Or it has "
        "the name of an operator of Modelica, as edge or abs: rename it."
    ),
    "model-inner": (
        "Two inner components of one class give different values to a parameter that outer components read, "
        "and that decides branches, sizes or which components there are. The built-in compiler knows one "
        "value in a class. Copy the class under another name for one of the two, or give both the same value."
    ),
    "model-kind": (
        "The class that was named is a package, function, type, connector, record or partial model. Only a "
        "complete model has equations that can be solved."
    ),
    "model-library": (
        "A folder given by -L does not exist, or the installation lacks the bundled library. -L takes the "
        "folder that contains the library's own folder."
    ),
    "model-missing": "The model file that was named on the command line or in daest.toml does not exist.",
    "model-nesting": (
        "An expression nests brackets or chains operators too deeply to be read safely. Split it over "
        "several variables, or use arrays with sum() and for-loops."
    ),
    "model-none": (
        "The file holds no complete model: only packages, partial models, functions or types, or no class "
        "at all."
    ),
    "model-not-given": (
        "The command needs a model: name a .mo or .fmu file, or write [model] source in daest.toml."
    ),
    "model-parameter-value": (
        "A parameter has neither a value nor a start value. daest does not invent one; give it where the "
        "parameter is declared or where its component is used, or by --set."
    ),
    "model-place": (
        "A place for noise or for an effect could not be found or means several equations. A place is a "
        "flow variable, a connector with one flow variable, a variable that one equation defines, or the "
        "index of an equation as `daest noise` lists them."
    ),
    "model-syntax": (
        "The file is not valid Modelica. The message gives file, line and column, and what was expected "
        "there; the cause is often a missing `;` before."
    ),
    "model-table-file": (
        "A table of the model stands in a file that is not there or cannot be read. A relative name means a "
        "file beside that of the model, `modelica://Library/Resources/…` one in the folder of the library. "
        "Text files have `double NAME(ROWS, COLUMNS)` and the numbers behind it, .mat files (of versions 4 "
        "to 7) a matrix of that name, .csv files nothing but the matrix behind nHeaderLines."
    ),
    "model-too-large": (
        "Values cancel what the structure of a large model promises, so its index would have to be found by "
        "dense algebra, which takes too much time and memory at this size. Split the model."
    ),
    "model-type": "Two sides of an equation, or a value and its declaration, differ in type, size or unit.",
    "model-unbalanced": (
        "A model needs as many equations as unknowns. The message names the unknowns that nothing "
        "determines, or the equations that compete for the same unknowns (Dulmage-Mendelsohn "
        "decomposition)."
    ),
    "model-unknown-class": (
        "A class that is mentioned is not in the file, not beside it and not in a library folder. Check the "
        "spelling, or give the library's folder by -L or MODELICAPATH."
    ),
    "model-unknown-format": "A model is a Modelica file (.mo), Base Modelica (.bmo) or an FMU (.fmu).",
    "model-unknown-name": (
        "A name in an equation is not declared. Check its spelling and the component that it belongs to."
    ),
    "model-unsupported": (
        "The model uses clocks, a delay, or an algorithm that cannot be written as equations. The message "
        "names it and its line. A first-order lag may stand for a delay, sample(start, interval) for a "
        "clock; or export the model by your own tool as an FMU, which all commands take."
    ),
    "mqtt-address": (
        "Events are published under a topic of a broker: --mqtt mqtt://HOST:PORT/TOPIC, with "
        "USER:PASSWORD@ before the host where the broker asks for it."
    ),
    "mqtt-unreachable": (
        "No MQTT broker answers at the address of --mqtt. Nothing was watched. Check the address, or "
        "leave the option out: the events stand on stdout as well."
    ),
    "needs-package": (
        "What was asked for needs a package that is an optional part of the installation. The message names "
        "the part: pip install 'daest[...]'."
    ),
    "no-c-compiler": (
        "Exporting an FMU compiles C code. Install a compiler: pip install daest[compiler] brings one "
        "(zig), which also compiles for Windows and macOS; gcc or clang from the system work too."
    ),
    "noise-along-needs-equations": (
        "Verdicts along a trajectory need the equations of the model, at every point of it. This FMU carries "
        "none: take the .mo file, or an FMU that daest exported."
    ),
    "noise-differentiated": (
        "White noise has no time derivative. The constraints of the model force the equation with this noise "
        "to be differentiated, so the noise may not enter there (Theorem 3.1 of the report in structural "
        "form). Let it enter at a balance of forces, torques, currents or flows, or use coloured noise."
    ),
    "noise-intensity-missing": (
        "A simulation with noise, or an estimate, needs the intensity of every white noise: its two-sided "
        "spectral density, in unit squared times seconds. Write intensity = ... in the annotation or in "
        "[noise.process] of daest.toml."
    ),
    "noise-nowhere-regular": (
        "The linearised model is singular at every point of the trajectory that was looked at, so that "
        "nothing can be said about noise. Some equations depend on each other there: look at one point with "
        "daest linearize --at."
    ),
    "noise-place-unknown": (
        "The place named with --at is none of the model's equations (counted from 0), noises, components "
        "or unknowns."
    ),
    "noise-std": (
        "The standard deviation of measurement noise must be a positive number, in the unit of the output."
    ),
    "noise-unknown": (
        "A noise was named that is neither an output (measurement noise) nor a noise of the model."
    ),
    "omc-failed": "OpenModelica did not make the FMU or the Base Modelica text; its own words follow.",
    "omc-missing": (
        "`--compiler omc` needs OpenModelica: its program omc on the path, or named by the environment "
        "variable OMC."
    ),
    "omc-options": "Options that OpenModelica is not told about were given together with `--compiler omc`.",
    "operating-point-unknown-name": (
        "The operating point of --at names a variable that the model does not have. Names are those of "
        "unknowns and inputs, or der(name) for a derivative."
    ),
    "option-assignment": (
        "An option of the form NAME=VALUE was written otherwise. The value is a number in the unit of the "
        "model: --set spring.c=0.04."
    ),
    "option-contradiction": (
        "Two options say different things of one parameter. --fix holds it at a value; --set gives a value, "
        "from which the search starts where the parameter is estimated; --estimate names what is estimated."
    ),
    "option-hold": (
        "--hold, or hold in daest.toml, tells what inputs do between their samples: zoh, all keep their "
        "value; foh, all run on straight lines; smooth, all run on the cubic spline through their samples; "
        "zoh(P, valve), those named keep their value and the others run straight."
    ),
    "option-resample": (
        "The period for --resample must be positive and not shorter than the sampling period of the "
        "recording: nothing is known between the samples."
    ),
    "option-split": (
        "--split is the share of the recording that is used for estimation, a number between 0 and 1."
    ),
    "output-is-input": (
        "The file named with -o is one that the command reads. Nothing of yours is overwritten; choose "
        "another name."
    ),
    "output-unknown": (
        "An output was named that is neither an output nor a variable of the model. The message names the "
        "nearest ones."
    ),
    "output-unwritable": (
        "The result cannot be written where it was asked for: the folder cannot be made or written, or the "
        "disk is full."
    ),
    "output-white-noise": (
        "White noise reaches a measured output without passing a state. Sampled white noise has no finite "
        "variance; the output would carry no information. Hold the noise over a sample, or put a lag (a "
        "noise with a bandwidth) between the noise and the output."
    ),
    "parameter-derived": (
        "The parameter is computed from others in the model, so that it cannot be set by itself. Set what "
        "it is computed from."
    ),
    "parameter-fixed": (
        "The parameter is final, a constant, an array or an element of a component array that decides the "
        "structure of the model; it can be changed in the model only."
    ),
    "parameter-outside-bounds": (
        "The value of a parameter lies outside its bounds. Bounds come from min and max in the model, or "
        "from daest.toml, which overrides them."
    ),
    "parameter-unknown": (
        "The model has no tunable parameter of that name. The message names the nearest ones; Integer, "
        "Boolean and final parameters are fixed when the model is compiled."
    ),
    "particle-collapse": (
        "Not one particle of a particle filter comes near the measurement, so that nothing is left to weigh. "
        "The initial state or the noises are too narrow for the record, or the model cannot follow it. Use "
        "more particles, larger noises, a wider initial state, or the ukf."
    ),
    "pencil-singular": (
        "The linear model has no unique solution: a combination of its equations vanishes, though each "
        "unknown can be assigned to an equation. The message names that combination; one of these "
        "equations repeats or contradicts the others, or a parameter that is zero has removed a term."
    ),
    "plot-format": (
        "A picture was asked for in a format that is not written. Give a name that ends in .png, .svg or "
        ".pdf. Or a result, which is text or JSON, was to go to a file with such a name: -o gives the file "
        "of the result, --plot that of its picture."
    ),
    "prior-mean": (
        "The mean of a prior lies outside the bounds of its parameter, or is not positive although the "
        "parameter is searched on a logarithmic scale, where the mean is the median of a lognormal density."
    ),
    "prior-std": (
        "The standard deviation of a prior is zero, negative or not finite. A parameter that is known "
        "exactly is fixed, not given a prior."
    ),
    "prior-unused": (
        "A prior was given for a parameter that is not among the estimated ones, where it would have no "
        "effect."
    ),
    "profile-not-estimated": (
        "A profile likelihood was asked for a parameter that is not among the estimated ones."
    ),
    "rank-not-finite": (
        "A matrix of the linear model holds an infinite or undefined number, so its rank cannot be "
        "decided. Check the parameter values."
    ),
    "report-nothing": (
        "There is nothing to report on: no daest.toml that names a model, and no result. Run daest report in "
        "the folder of a project, or name its daest.toml with -p."
    ),
    "results-unreadable": (
        "A file in results/ (or one named with --at) is missing, damaged or not of the form that daest "
        "writes. The command that made it writes it anew; for fit.json that is daest identify."
    ),
    "schema-unknown": (
        "A schema describes the JSON document of a command. daest schema lists those that there are."
    ),
    "several-problems": (
        "A file has several problems of different kinds; the message lists them all with their own codes."
    ),
    "simulation-failed": (
        "The integration stopped before the end: a nonlinear equation inside the model had no solution, or "
        "the step size became too small. The message names the time. Inputs out of range, parameters that "
        "make the model unstable, and states at which the choice of states is singular (a pendulum in "
        "Cartesian coordinates passing the horizontal) are usual reasons."
    ),
    "simulation-input": (
        "The inputs of a simulation do not fit the model or the time grid: a missing column, another length, "
        "a time that does not increase."
    ),
    "singular-after-reduction": (
        "Every equation can be matched to an unknown, but for the present values some equations, or their "
        "time derivatives, say the same thing, and some unknowns stay free. Usual reasons: two rigid paths "
        "in parallel, two grounds, a closed kinematic loop, a parameter that is zero."
    ),
    "split-out-of-range": (
        "The split divides every recording into a first part for the estimation and a rest for the "
        "validation; it is the share of the first part, between 0 and 1."
    ),
    "standard-form-ill-conditioned": (
        "The model is so badly scaled that its dynamic and its algebraic part cannot be separated in double "
        "precision: a time constant or a stiffness differs from the others by more than ten orders of "
        "magnitude. Check the units of the parameters, or leave the very fast part out."
    ),
    "start-outside-bounds": (
        "The start value of a parameter lies outside its bounds (min, max). Change one of them; daest does "
        "not move a start value silently."
    ),
    "stream-closed": (
        "A command that follows a stream reads it from stdin, which is closed here. Pipe the samples into "
        "it, or name a file that grows."
    ),
    "stream-empty": (
        "A stream ended, or went wrong, before the first two samples. It begins with a CSV header that "
        "names the time, the inputs and at least one output of the model, or with JSON objects, one a "
        "line, that have these keys. The filter needs the expected step between two samples: the first "
        "two tell it, or --step."
    ),
    "stream-line": (
        "A line of a stream is no sample: it has another number of cells than the header, holds a text "
        "where a number is expected, lacks the time or an input, or its time does not increase. It is "
        "left out, and the filter goes over the gap. A missing output is an empty cell, or null in JSON."
    ),
    "stream-option": (
        "Some options need a whole recording (--smooth, --from, --to, --resample, --detrend, --plot, -o, "
        "the particle filter), others need a stream (--state, --step, --idle). They cannot be mixed."
    ),
    "stream-state": (
        "The file of --state keeps what the filter knew when the stream stopped. It cannot be read, or it "
        "was kept by another model, fit, kind of filter or set of outputs. Remove it to start anew."
    ),
    "structurally-singular": (
        "Some equations compete for too few unknowns, or some unknowns occur in too few equations, so the "
        "equations cannot determine the unknowns whatever the parameter values are. The message lists both "
        "parts. Usual reasons: a missing or doubled connection, no ground, an input that is left out."
    ),
    "symbolic-model-damaged": (
        "The symbolic model inside the FMU was changed or damaged after daest wrote it, so it is not used. "
        "The binary still is: choose the source fmi-ls-dae."
    ),
    "system-jacobian-singular": (
        "The structure of a large model does not tell its index, since values cancel. Equations that repeat "
        "others are the usual reason."
    ),
    "task-not-sendable": (
        "Work for another process travels as bytes, and something in it cannot be written as such, as a "
        "function that is defined inside another one. Run it in one process: without --cluster, and with "
        "--jobs 1."
    ),
    "unit-contradiction": (
        "The model connects two variables whose declared units have different dimensions, a voltage with a "
        "force, say. One of the two units is wrong, or the wrong connectors are joined. The equations are "
        "used as they stand; numbers are printed with the units as they are declared."
    ),
    "unit-incompatible": (
        "A recorded signal has a unit of another dimension than the model variable it is matched with, so "
        "no conversion exists. Either the wrong column is mapped, or the unit in the header or in the model "
        "is wrong. Units are never ignored."
    ),
    "unit-unknown": (
        "A unit is written in a way that is not understood. Units follow Modelica: products with a dot, "
        "powers as digits, one slash, brackets behind it for a product: N.m, kg.m2, W/(m2.K), rad/s2, degC, "
        "1."
    ),
    "unknown-noise": ("The model has no noise input of that name. Names are Modelica names, with dots."),
    "unknown-output": ("The model has no output of that name. Names are Modelica names, with dots."),
    "unknown-parameter": (
        "The name is not a parameter of the model. Names are Modelica names with dots, such as spring.c."
    ),
    "unknown-variable": (
        "The name is not a variable of the model. Names are Modelica names with dots, such as disc.phi."
    ),
    "worker-lost": (
        "A process that worked for this command ended in the middle of a task, again and again: memory ran "
        "out, or somebody ended it. Let fewer work at a time (--jobs), or give them more memory."
    ),
}
