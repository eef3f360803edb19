"""Prober: the measurements that calibration asks of a rig, real or emulated, without ports or clocks."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.calibration.measurements import (
    IdleMeasurement,
    PressMeasurement,
    StopMeasurement,
    TouchMeasurement,
)
from palpate.calibration.reference import Reference

__all__ = ["ApproachTable", "Probe", "Prober", "ServoPath"]


@dataclass(frozen=True, eq=False)
class ServoPath:
    """Straight approach of a finger, as its servos carry it out: they stand at `servos_rad` (m, 2) along it.

    The rows are evenly spaced over `length_mm` of travel; between them, servos move evenly. Two are enough
    for a slide, whose aim stays where it is. `stage_rad`: angle of the turning stage, 0 without one.
    """

    finger: int
    servos_rad: Floats
    length_mm: float
    stage_rad: float = 0.0

    def servos_at(self, travel_mm: Floats) -> Floats:
        """Servo angles (n, 2) after travels (n,)."""
        at = np.linspace(0.0, self.length_mm, len(self.servos_rad))
        return np.column_stack([np.interp(travel_mm, at, angles) for angles in self.servos_rad.T])


class ApproachTable:
    """All paths of a rig as arrays, to be asked at once."""

    def __init__(self, paths: Sequence[ServoPath]) -> None:
        self._paths = paths
        self.finger = np.array([item.finger for item in paths], dtype=np.int64)
        self.length_mm = np.array([item.length_mm for item in paths])
        self.stage_rad = np.array([item.stage_rad for item in paths])

    @cached_property
    def _alike(self) -> list[tuple[Ints, Floats]]:
        """Paths with as many rows each: their numbers (k,), their servo angles (k, m, 2)."""
        count = np.array([len(item.servos_rad) for item in self._paths])
        return [
            (own, np.stack([self._paths[k].servos_rad for k in own.tolist()]))
            for own in (np.flatnonzero(count == rows) for rows in np.unique(count))
        ]

    def servos_at(self, travel_mm: Floats) -> Floats:
        """Servo angles (n, 2) of each path after its travel (n,); beyond its ends as it goes on there."""
        result = np.empty((len(self._paths), 2))
        share = travel_mm / self.length_mm
        for own, servos in self._alike:
            last = servos.shape[1] - 1
            place = share[own] * last
            row = np.clip(np.floor(place).astype(np.int64), 0, last - 1)
            part = (place - row)[:, None]
            k = np.arange(len(own))
            result[own] = (1 - part) * servos[k, row] + part * servos[k, row + 1]
        return result


@dataclass(frozen=True)
class Probe:
    """An approach, by its number, up to `end_mm` of travel.

    `side`: +1 for a contact that will be to the left of the way, -1 to the right, 0 if that is not known. An
    aim then comes from where its play is taken up as the contact will push it.
    """

    approach: int
    end_mm: float
    side: int = 0


class Prober(Protocol):
    """A rig that can be measured. Every method raises DeviceError or SafetyStop when a device fails."""

    @property
    def approaches(self) -> Sequence[ServoPath]:
        """Every free path with the turning stage, if there is one, where it is nearest to 0."""
        ...

    @property
    def turned(self) -> "Prober":
        """The same rig, with paths at all angles of its turning stage, fewer at each.

        A grip is of paths at one angle. Those of a slide whose aim stays where it waits are left out: the
        side of its play would not be known.
        """
        ...

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Have a reference put somewhere near a place in W, alone on the table, and kept from moving."""
        ...

    def clear(self) -> None:
        """Have the table cleared."""
        ...

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        """Touch with several fingers, each once at most; None for what met nothing."""
        ...

    def press(self, contacts: Sequence[Probe], placing: int) -> list[PressMeasurement]:
        """Press slowly on contacts that are known, with several fingers, and go back.

        `end_mm` of each is how far it had gone when it touched there.
        """
        ...

    def stop(self, contacts: Sequence[Probe], speed_mm_s: float) -> list[StopMeasurement]:
        """Run into contacts that are known, at a speed, and stop."""
        ...

    def swing(self) -> list[float]:
        """Current (A) that each finger's aim needs to turn freely, in the mean of both ways; 0 for arms."""
        ...

    def idle(self, seconds: float) -> list[IdleMeasurement]:
        """Record every array with nothing touching it."""
        ...

    def home(self, finger: int, stop_mm: float) -> float:
        """Servo angle at which a slide stalls, gently driven against the hard stop at `stop_mm`."""
        ...
