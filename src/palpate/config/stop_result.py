"""Result of `palpate stop`: `palpate/stop@1`."""

from typing import Literal

from palpate.config.results import Out

__all__ = ["StopOut", "StoppedServoOut"]


class StoppedServoOut(Out):
    """A servo of the rig file, or one that answers. `off`: it has confirmed that torque is off."""

    id: int
    owner: str | None
    off: bool
    problem: str | None


class StopOut(Out):
    """What was told, and what confirmed it.

    `told`: how often everybody was told to switch torque off. `taken`: another program had the port all the
    time, so that nobody could be asked; `servos` is empty then.
    """

    format: Literal["palpate/stop@1"] = "palpate/stop@1"
    port: str
    emulated: bool
    baudrate_bps: int
    told: int
    taken: bool
    confirmed: bool
    servos: tuple[StoppedServoOut, ...]
