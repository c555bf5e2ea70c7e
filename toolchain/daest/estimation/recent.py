"""The last samples of a stream as a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daest.data.prepare import regular_times
from daest.estimation.online import OnlineFilter
from daest.model.experiment import Experiment
from daest.model.stream import Sample


def recording_of(samples: Sequence[Sample], online: OnlineFilter) -> Experiment:
    """The samples, in the names of the filter that they came to."""
    time, notes = regular_times(np.array([sample.time for sample in samples]))
    return Experiment(
        "stream",
        time,
        np.array([sample.inputs for sample in samples]),
        np.array([sample.outputs for sample in samples]),
        online.input_names,
        online.output_names,
        {},
        tuple(notes),
    )
