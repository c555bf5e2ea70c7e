"""Dates and clock times as loggers write them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta
from itertools import pairwise

_ANY_DAY = "2000-01-01T"  # of clock times without a date
_CLOCK = re.compile(r"\d{2}:")
_DAY = timedelta(days=1)
_WRITTEN = re.compile(
    r"(?P<a>\d{1,4})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<c>\d{4}|\d{2})"
    r"(?:[ T,]+(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2})(?:[.,](?P<f>\d{1,9}))?)?)?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)


def seconds_of(texts: Sequence[str]) -> list[float] | None:
    """Seconds from the first one, of dates or clock times: `2026-11-21 08:15:00.25`, `08:15:00`,
    `21.11.2026 08:15:00`, `11/21/2026 8:15:00 AM`. None where one is anything else, or where days and months
    between slashes may be either and that matters. A clock without a date that goes back by more than half a
    day has passed midnight.

    Dates without a zone are taken as they stand.
    """
    if not texts or (_iso(texts[0]) is None and not _WRITTEN.fullmatch(texts[0].strip())):
        return None  # of a long column of words no other one is looked at
    stamps = [_iso(text) for text in texts]
    known = [stamp for stamp in stamps if stamp is not None]
    if known and len(known) == len(stamps):
        if len({stamp.tzinfo is None for stamp in known}) > 1:
            return None
        return _from_first(_past_midnight(known) if all(map(_CLOCK.match, texts)) else known)
    written = [found for text in texts if (found := _WRITTEN.fullmatch(text.strip()))]
    if not written or len(written) != len(texts):
        return None
    read = [_read(written, order) for order in _orders(written)]
    counted = [_from_first(dates) for dates in read if dates is not None]
    return counted[0] if counted and all(one == counted[0] for one in counted) else None


def _iso(text: str) -> datetime | None:
    for form in (text, f"{_ANY_DAY}{text}"):
        try:
            return datetime.fromisoformat(form)
        except ValueError:
            continue
    return None


def _past_midnight(clock: Sequence[datetime]) -> list[datetime]:
    """The times of a clock without a date, each on the day that it belongs to."""
    found, days = [clock[0]], 0
    for before, now in pairwise(clock):
        days += before - now > _DAY / 2
        found.append(now + days * _DAY)
    return found


def _orders(written: Sequence[re.Match[str]]) -> tuple[str, ...]:
    """The orders of year, month and day that dates of this form may have: between points the day comes first,
    between slashes and strokes the month may."""
    if len(written[0]["a"]) > 2:
        return ("ymd",)
    return ("dmy",) if written[0]["mark"] == "." else ("dmy", "mdy")


def _read(written: Sequence[re.Match[str]], order: str) -> list[datetime] | None:
    try:
        return [_date(one, order) for one in written]
    except ValueError:  # no such day
        return None


def _date(written: re.Match[str], order: str) -> datetime:
    of = dict(zip(order, (int(written[name]) for name in "abc"), strict=True))
    year = of["y"] if of["y"] > 99 else 2000 + of["y"]
    hour = int(written["h"] or 0)
    if written["half"]:
        if not 1 <= hour <= 12:
            raise ValueError(f"no hour {hour} of half a day")
        hour = hour % 12 + 12 * (written["half"] in "pP")
    whole = datetime(year, of["m"], of["d"], hour, int(written["m"] or 0), int(written["s"] or 0))
    return whole + timedelta(seconds=float(f"0.{written['f'] or 0}"))


def _from_first(stamps: Sequence[datetime]) -> list[float]:
    return [(stamp - stamps[0]).total_seconds() for stamp in stamps]
