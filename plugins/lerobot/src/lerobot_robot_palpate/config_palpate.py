"""Configuration of the robot, as LeRobot's commands and files take it."""

from dataclasses import dataclass

from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("palpate")
@dataclass(kw_only=True)
class PalpateConfig(RobotConfig):  # type: ignore[misc]  # lerobot has no types
    """A rig and a catalogue.

    `rig`, `objects`: files; None for the emulated bench and the objects that palpate ships. `seed` draws an
    emulated rig's errors and its parts. `unconfirmed`: the wiring of a real rig need not have been proven.
    """

    rig: str | None = None
    objects: str | None = None
    seed: int = 0
    unconfirmed: bool = False
