"""Prober: the measurements that calibration asks of a rig, real or emulated, without ports or clocks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from palpate.calibration.measurements import (
    IdleMeasurement,
    PressMeasurement,
    StopMeasurement,
    TouchMeasurement,
)
from palpate.calibration.reference import Reference

__all__ = ["Probe", "Prober", "SlideApproach"]


@dataclass(frozen=True)
class SlideApproach:
    """Straight path of a slide: its finger, the servo angle of its aim, and its slide's first and last."""

    finger: int
    aim_rad: float
    start_rad: float
    end_rad: float


@dataclass(frozen=True)
class Probe:
    """An approach, by its number, up to where the slide's servo stands at `end_rad`.

    `side`: +1 for a contact that will be to the left of the way, -1 to the right, 0 if that is not known. The
    aim then comes from where its play is taken up as the contact will push it.
    """

    approach: int
    end_rad: float
    side: int = 0


class Prober(Protocol):
    """A rig that can be measured. Every method raises DeviceError or SafetyStop when a device fails."""

    @property
    def approaches(self) -> Sequence[SlideApproach]:
        """Every free path."""
        ...

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Have a reference put somewhere near a place in W, alone on the table, and kept from moving."""
        ...

    def clear(self) -> None:
        """Have the table cleared."""
        ...

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        """Touch with several fingers at once, each once at most; None for what met nothing."""
        ...

    def press(self, contacts: Sequence[Probe], placing: int) -> list[PressMeasurement]:
        """Press slowly on contacts that are known, with several fingers at once, and go back.

        `end_rad` of each is where its slide's servo stood when it touched there.
        """
        ...

    def stop(self, contacts: Sequence[Probe], speed_mm_s: float) -> list[StopMeasurement]:
        """Run into contacts that are known, at a speed, and stop."""
        ...

    def swing(self) -> list[float]:
        """Current (A) that each finger's aim needs to turn freely, in the mean of both ways."""
        ...

    def idle(self, seconds: float) -> list[IdleMeasurement]:
        """Record every array with nothing touching it."""
        ...

    def home(self, finger: int, stop_mm: float) -> float:
        """Servo angle at which a slide stalls, gently driven against the hard stop at `stop_mm`."""
        ...
