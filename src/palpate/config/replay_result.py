"""Result of `palpate replay`: `palpate/replay@1`."""

from typing import Literal

from palpate.config.results import Out

__all__ = ["DifferenceOut", "EndOut", "ReplayOut"]


class DifferenceOut(Out):
    """Where a replay first differs: the line of the log, counted from 1, and what is different."""

    line: int
    message: str


class EndOut(Out):
    """How the recorded run ended: `how` is "done" or the kind of error, `message` its text."""

    how: str
    message: str | None


class ReplayOut(Out):
    """Answer of `palpate replay`.

    `same`: as far as the log goes, every byte sent and every value is as recorded. `events`: lines of the log
    that came about again. `end` is null if the log was cut off; `object` and `state` are null if nothing
    was identified. `recorded_by`: palpate's version then.
    """

    format: Literal["palpate/replay@1"] = "palpate/replay@1"
    same: bool
    events: int
    sent_bytes: int
    received_bytes: int
    end: EndOut | None
    verdict: str | None
    object: str | None
    state: str | None
    difference: DifferenceOut | None
    recorded_by: str
    session: str
