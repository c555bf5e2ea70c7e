"""Numbers that the command line names in its help, kept apart from the numerical code that uses them so that
a help page or a completion loads none of it."""

from __future__ import annotations

PARTICLES = 1000
"""Particles of a filter if nothing else is asked for."""

LEAST_REFITS = 39
"""Refits of a bootstrap: fewer have no value beyond the percentiles of a 95 % interval."""

LEAST_NULL_RECORDS = 99
"""Records without fault of `daest compare`: fewer cannot tell the level of its tests, 1 %."""

MOST_EFFECTS = 6
"""Effects that `daest improve` adds."""

TIME_LIMIT = 300.0
"""Seconds after which `daest diagnose` begins no further refit and `daest improve` no further round."""
