"""The documents of `daest watch`: one event a line."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict


class WatchDocument(TypedDict):
    """An event of a watch."""

    time: Annotated[float | None, "s, of the stream"]
    event: Literal["started", "alarm", "diagnosis", "ended"]
    output: Annotated[str | None, "whose innovations changed"]
    statistic: Annotated[float | None, "nats"]
    threshold: Annotated[float, "nats"]
    since: Annotated[float | None, "s: when the change began, as the statistic tells it"]
    effect: Annotated[str | None, "what is missing since then, where that was asked for and could be told"]
    change: NotRequired[Annotated[str | None, "what changed in the innovations"]]
    average_run: NotRequired[Annotated[float, "samples between false alarms in the mean"]]
    kind: NotRequired[str]
    outputs: NotRequired[list[str]]
    at: NotRequired[str | None]
    verdict: NotRequired[str | None]
    message: NotRequired[str]
    n_samples: NotRequired[int]
    n_alarms: NotRequired[int]
