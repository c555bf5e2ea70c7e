"""Faults of a recording are told where nothing was found that explains it."""

import numpy as np

from daest.diagnosis.recordings.faulty import (
    EMPTY,
    faults_beside,
    faults_counted,
    faults_in_errors,
    faults_told,
    pauses_told,
)
from daest.model.experiment import Experiment

TIME = 0.01 * np.arange(2000)


def recording(held=None, column=0):
    """A noisy signal; one column may hold its value in the samples `held`."""
    rng = np.random.default_rng(0)
    both = np.column_stack([np.sin(TIME), np.cos(TIME)]) + 0.01 * rng.normal(size=(2000, 2))
    if held is not None:
        both[held, column] = both[held.start, column]
    return Experiment("run", TIME, both[:, :1], both[:, 1:], ("u",), ("y",))


def test_a_sound_recording_has_no_faults():
    assert faults_told([recording()]) == ""


def test_a_sensor_that_stands_still_is_told_once():
    stuck = recording(slice(500, 560), 1)
    told = faults_told([stuck, stuck])
    assert told.startswith(" It may be faults of the recording: y stands still at ")
    assert told.count("stands still") == 1


def test_values_between_the_readings_of_a_slower_logger_are_told():
    sound, rows = recording(), np.arange(2000)
    sound.outputs[:, 0] = np.interp(rows, rows[::7], sound.outputs[::7, 0])
    told = faults_told([sound])
    assert told.startswith(
        " It may be faults of the recording: y runs on straight lines between every 7 samples"
    )


def test_beside_a_law_its_errors_count_the_faults():
    told = faults_beside([recording(slice(500, 560), 1)])
    assert told.startswith(" Its sizes and errors count faults of the recording: y stands still at ")
    assert told.endswith(EMPTY) and faults_beside([recording()]) == ""


def test_where_nothing_is_missing_its_errors_count_the_faults():
    told = faults_in_errors([recording(slice(500, 560), 1)])
    assert told.startswith(" The errors count faults of the recording: y stands still at ")
    assert told.endswith(EMPTY) and faults_in_errors([recording()]) == ""


def test_a_fault_of_unseen_data_is_no_load_in_those_of_the_fit():
    """One reading of a kiln that was 3 K off had been all that was said to be done about a load before it."""
    sound, stuck = recording(), recording(slice(500, 560), 1)
    assert faults_counted("external disturbance", [sound], [stuck]) == faults_in_errors([stuck])
    assert faults_counted("external disturbance", [stuck], [sound]) == ""
    assert faults_counted("supported", [stuck], [sound]) == faults_beside([stuck])


def test_a_command_that_keeps_its_value_is_no_fault():
    assert faults_told([recording(slice(500, 560), 0)]) == ""


def test_a_pause_in_which_inputs_may_have_moved_is_told():
    whole = recording()
    left = np.r_[0:600, 660:2000]
    paused = Experiment("run", TIME[left], whole.inputs[left], whole.outputs[left], ("u",), ("y",))
    told = pauses_told([paused, paused])
    assert told.startswith(" It may be what the inputs did unseen: the clock jumps by 0.61 s")
    assert told.count("jumps") == 1 and pauses_told([whole]) == ""
    still = Experiment("run", TIME[left], 0.0 * whole.inputs[left], whole.outputs[left], ("u",), ("y",))
    assert pauses_told([still]) == ""
