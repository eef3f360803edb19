"""Result of `palpate scan`: `palpate/scan@1`."""

from typing import Literal

from palpate.config.results import Out

__all__ = ["ScanOut", "ScannedServoOut"]


class ScannedServoOut(Out):
    """What answers to an id at a baud rate.

    `model` is null for a model number that nobody knows, `model_number` and `firmware` also where every
    answer came broken. `crowded`: two servos or more seem to share the id. `owner`: what the rig file calls
    the servo.
    """

    baudrate_bps: int
    id: int
    model: str | None
    model_number: int | None
    firmware: int | None
    crowded: bool
    owner: str | None


class ScanOut(Out):
    """Every servo that was found, and what is wrong."""

    format: Literal["palpate/scan@1"] = "palpate/scan@1"
    port: str
    emulated: bool
    baudrates_bps: tuple[int, ...]
    ids: tuple[int, ...]
    servos: tuple[ScannedServoOut, ...]
    warnings: tuple[str, ...]
