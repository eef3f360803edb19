"""Measurements of a rig during calibration, the `Prober` that makes them, and the run record.

Touches of references, presses, stops, idle arrays; the estimators are pure functions of them. A prober
stands for a rig, real or emulated, without exposing ports or clocks. Servo angles count from Goal Position
2048, the servo next to the base first. The record, `palpate/calibration-run@1`, is JSON beside the rig file
by which a run can be resumed.

*References.* Each has a `name`, the `radius_mm` of the smallest circle round its origin that holds it,
`tolerance_mm` by which its surface may be elsewhere, `turns`, whether its orientation can be measured, and
`repeats`, how many orientations look the same. Its frame has its origin at the centre; mm.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
import shapely
from pydantic import Field

from palpate.base.geometry import Counts, Floats, Ints
from palpate.base.geometry.plane import rotation_matrix
from palpate.config.calibration_file import CalibrationDevice
from palpate.config.calibration_finger import Actuators, TactileCalibration
from palpate.config.fields import FileModel, Items


@dataclass(frozen=True)
class ReferenceDisc:
    """A round reference."""

    name: str
    radius_mm: float
    tolerance_mm: float = 0.0
    turns: bool = False
    repeats: int = 1

    def curvature_per_mm(self) -> float:
        """Curvature of its rim."""
        return 1 / self.radius_mm

    def distance_mm(self, points_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """Signed distance (n,) from the rim, outward normal (n, 2), and room (n,), inf: it has no corner.

        `points_mm` (n, 2); inside counts negative.
        """
        away = np.hypot(points_mm[:, 0], points_mm[:, 1])
        normal = points_mm / np.maximum(away, 1e-9)[:, None]
        return away - self.radius_mm, normal, np.full(len(points_mm), np.inf)


class ReferencePlate:
    """A convex polygon, its corners counter-clockwise; `repeats`: its rotational symmetry.

    ValueError if it is not convex.
    """

    def __init__(self, name: str, outline_mm: Floats, tolerance_mm: float = 0.0) -> None:
        corners = np.asarray(outline_mm, dtype=np.float64)
        along = np.roll(corners, -1, axis=0) - corners
        turn = along[:, 0] * np.roll(along, -1, axis=0)[:, 1] - along[:, 1] * np.roll(along, -1, axis=0)[:, 0]
        if (turn < 0).all():
            corners, turn = corners[::-1], -turn[::-1]
        headings = np.arctan2(along[:, 1], along[:, 0])
        round_it = np.angle(np.exp(1j * (np.roll(headings, -1) - headings))).sum()
        if not (turn > 0).all() or abs(abs(round_it) - 2 * math.pi) > 1e-6:
            raise ValueError("is not convex; a plate's corners go round it, all turning the same way")
        self.name = name
        self.tolerance_mm = tolerance_mm
        self.turns = True
        self._start: Floats = corners - shapely.get_coordinates(shapely.centroid(shapely.Polygon(corners)))
        along = np.roll(self._start, -1, axis=0) - self._start
        self._length = np.hypot(along[:, 0], along[:, 1])
        self._along = along / self._length[:, None]
        self._normal = np.column_stack([self._along[:, 1], -self._along[:, 0]])
        self.radius_mm = float(np.hypot(self._start[:, 0], self._start[:, 1]).max())
        self.repeats = _symmetry(self._start)

    @property
    def corners_mm(self) -> Floats:
        """Corners (k, 2), counter-clockwise, round the centre of area."""
        return self._start

    def curvature_per_mm(self) -> float:
        """Curvature of its faces, which are flat."""
        return 0.0

    def distance_mm(self, points_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """Signed distance (n,) from the surface, outward normal (n, 2), and room to the next corner (n,).

        `points_mm` (n, 2); inside counts negative. The room is how far the nearest point of the surface is
        from where its face ends, 0 at a corner.
        """
        rel = points_mm[:, None, :] - self._start
        out = np.einsum("nkj,kj->nk", rel, self._normal)
        at = np.einsum("nkj,kj->nk", rel, self._along)
        beyond = at - np.clip(at, 0.0, self._length)
        gap = np.where(out > 0, np.hypot(out, beyond), np.inf)
        inside = (out <= 0).all(axis=1)
        face = np.where(inside, out.argmax(axis=1), gap.argmin(axis=1))
        rows = np.arange(len(points_mm))
        distance = np.where(inside, out[rows, face], gap[rows, face])
        away = out[rows, face, None] * self._normal[face] + beyond[rows, face, None] * self._along[face]
        normal = np.where(inside[:, None], self._normal[face], away / np.maximum(distance, 1e-9)[:, None])
        room = np.minimum(at[rows, face], self._length[face] - at[rows, face])
        return distance, normal, np.maximum(room, 0.0)


Reference = ReferenceDisc | ReferencePlate


def _symmetry(corners: Floats) -> int:
    """Rotational symmetry of corners round the origin."""
    count = len(corners)
    for order in range(count, 1, -1):
        if count % order:
            continue
        turned = corners @ rotation_matrix(2 * math.pi / order).T
        if np.allclose(turned, np.roll(corners, -count // order, axis=0), atol=1e-6):
            return order
    return 1


LEG_FREE, LEG_IN, LEG_OUT = 0, 1, 2
"""Legs of a press: before contact, pressing on, going back."""


@dataclass(frozen=True)
class TouchMeasurement:
    """Contact of a finger at rest with a reference, after a slow touch.

    `placing`: number of the placing of a reference that was touched. `servos_rad`: aim and slide, or shoulder
    and elbow. `aim_way`: +1 if the aim or shoulder came to its angle from below, -1 from above, 0 if unknown:
    it determines the side of its backlash; `elbow_way` likewise. `angle_rad` ± `angle_half_rad`: direction
    from the tip's axis to the contact, from the array's middle. `force_n` ± `force_bound_n`: by the array,
    with its gains as known then. `facing_rad`: where the finger faces, from its direction of travel: 0 for a
    slide. `stage_rad`: angle of the turning stage, by its servo; `stage_way`: from which side it came.
    """

    finger: str
    placing: int
    servos_rad: tuple[float, float]
    aim_way: int
    angle_rad: float
    angle_half_rad: float
    force_n: float
    force_bound_n: float
    elbow_way: int = 0
    facing_rad: float = 0.0
    stage_rad: float = 0.0
    stage_way: int = 0


@dataclass(frozen=True, eq=False)
class PressMeasurement:
    """Slow press along one way and back, n samples in the order of time.

    `travel_mm` (n,): how far along its way the tip's servos have brought it; `aside_mm` (n,): how far to the
    left of it. `push_n` (n,): force along the way that the servos' currents stand for, positive if they push
    the tip on, friction in it. `facing_rad` (n,): where the finger faces, from the direction of travel.
    `leg` (n,): FREE, IN or OUT. `counts` (n, rows, cols): the array's counts less the mean of what it read
    untouched just before. `step_mm`, `push_step_n`: by what an encoder step moves the tip along, and what a
    step of the currents is worth. `newton_per_a` (2,): what each servo's current pushes along the way.
    `free_a` (2,): current of each servo on the free way, positive if it turns the servo the way that it
    moves; nan of one that does not move. `friction_sigma_n`: by what friction along the way may be another
    under load, besides what it differs by from place to place; joints that move step by step rest on it.
    """

    finger: str
    placing: int
    travel_mm: Floats
    push_n: Floats
    leg: Ints
    counts: Floats
    step_mm: float
    push_step_n: float
    aside_mm: Floats
    facing_rad: Floats
    newton_per_a: tuple[float, float]
    free_a: tuple[float, float] = (math.nan, math.nan)
    friction_sigma_n: float = 0.0


@dataclass(frozen=True, eq=False)
class IdleMeasurement:
    """An untouched array: counts (n, rows, cols) as read, at `time_s` (n,)."""

    finger: str
    counts: Counts
    time_s: Floats


@dataclass(frozen=True)
class StopMeasurement:
    """Stop of a finger that met a contact at a speed, in mm along its way.

    `felt_mm`: where it was when the contact had been detected and the stop was sent; `stood_mm`: where it
    came to stand; `contact_mm`: where a slow touch of the same way stood. `samples_s`: time between two looks
    at the array.
    """

    finger: str
    speed_mm_s: float
    felt_mm: float
    stood_mm: float
    contact_mm: float
    samples_s: float


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


class RunRecord(FileModel):
    """Results of a calibration so far; steps that are not done are left out."""

    format: Literal["palpate/calibration-run@1"] = "palpate/calibration-run@1"
    steps: Items[str] = Field(description="Steps that were asked for.")
    geometry_sha256: str = Field(description="Of the rig as described.")
    references_sha256: str = Field(description="Of the references.")
    places: Items[tuple[str, float, float]] = Field(description="What is put where: name, x, y (mm).")
    devices: Items[CalibrationDevice] = Field(description="Every device that takes part.")
    actuators: Items[Actuators] | None = Field(default=None, description="By finger.")
    tactile: Items[TactileCalibration] | None = Field(default=None, description="By finger.")
    touched: Items[Items[TouchMeasurement]] = Field(
        default=[], description="Touches of every placing that is done."
    )
    stage: Items[TouchMeasurement] | None = Field(
        default=None, description="Touches of the disc at several angles of the turning stage."
    )

    def is_for(self, other: "RunRecord") -> bool:
        """True if this is about the same rig, references, devices and steps as another one."""
        return (
            self.steps == other.steps
            and self.geometry_sha256 == other.geometry_sha256
            and self.references_sha256 == other.references_sha256
            and self.places == other.places
            and self.devices == other.devices
        )
