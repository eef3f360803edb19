"""Result of `palpate setup-motors`: `palpate/setup@1`."""

from enum import StrEnum
from typing import Literal

from palpate.config.results import Out

__all__ = ["ChangeOut", "FoundOut", "SetupOut", "SetupOutcome", "SetupServoOut"]


class SetupOutcome(StrEnum):
    """How it ended for a servo."""

    RIGHT = "right already"
    WRITTEN = "written"
    DECLINED = "declined"
    SKIPPED = "skipped"
    NOT_DONE = "not done"


class FoundOut(Out):
    """Where a servo answered, and its firmware."""

    id: int
    baudrate_bps: int
    firmware: int


class ChangeOut(Out):
    """An item that was written and confirmed: its values before and after."""

    item: str
    found: int
    wanted: int


class SetupServoOut(Out):
    """A servo of the rig file. `problem`: why it is not done, null if nobody got that far."""

    id: int
    owner: str
    model: str
    outcome: SetupOutcome
    found: FoundOut | None
    written: tuple[ChangeOut, ...]
    problem: str | None


class SetupOut(Out):
    """Every servo of the rig file, or those that were chosen."""

    format: Literal["palpate/setup@1"] = "palpate/setup@1"
    rig: str
    port: str
    emulated: bool
    baudrate_bps: int
    servos: tuple[SetupServoOut, ...]
