from __future__ import annotations
def matched_start(problem, experiment):
    return None
