"""Touches of pads on drawn outlines."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import Floats
from palpate.base.tips import TipShape
from palpate.config import TipConfig
from palpate.drivers.emulators.pad import PadFace
from palpate.drivers.emulators.part import IN_PLACE
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.tip import PartSection
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, TipCalibration
from palpate.recognizer import Approach, Contact, Finger
from palpate.rig.motion.touch import dent_range_mm
from palpate.rig.pads import PadTouch, face_points_of, touched_points
from support.oracles.array_contacts import describe
from support.oracles.shapely_touches import Placed

# ----------------------------------------------------------------------------------------------------
# Touches of pads, simulated: where a face stops by shapely, what its array shows by the emulated taxels.
#
# The truth beside them, and what the host makes of it, with places and directions off within their bounds.

FAR_MM = 220.0
_ROWS, _PER_N, _SPREAD, _HARD_N = 4, 2000.0, 0.2, 8.0


def seen_along(shape: shapely.Geometry, from_mm: Floats, angle_rad: float) -> shapely.Geometry:
    """A shape of W in a frame with x along a direction and y to its left, from a place (2,)."""
    moved = affinity.translate(shape, -from_mm[0], -from_mm[1])
    return affinity.rotate(moved, -angle_rad, origin=(0, 0), use_radians=True)


def face_stop_mm(
    part: shapely.Geometry, start_mm: Floats, angle_rad: float, half_mm: float, tilt_rad: float = 0.0
) -> float:
    """Travel at which a face, turned by a tilt, first meets a part; infinite if it passes by."""
    # In a sheared frame the face is upright: what it meets first is what of its strip is least far along.
    own = affinity.affine_transform(
        seen_along(part, start_mm, angle_rad), [1.0, math.tan(tilt_rad), 0.0, 1.0, 0.0, 0.0]
    )
    half = half_mm * math.cos(tilt_rad)
    met = shapely.intersection(own, shapely.box(0.0, -half, FAR_MM, half))
    return float(shapely.bounds(met)[0]) if not met.is_empty else math.inf


def outline_of(part: shapely.Geometry) -> PartSection:
    """The same as the emulated bench has it."""
    rings = [
        np.asarray(ring.coords)[:-1]
        for piece in shapely.get_parts(part)
        for ring in (piece.exterior, *piece.interiors)
    ]
    return PartSection(np.vstack(rings), np.vstack([np.roll(ring, -1, axis=0) for ring in rings]), 50.0)


@dataclass(frozen=True, eq=False)
class PadTrial:
    """One approach: what points of the face met, by the host, and where they really went.

    `true_start_mm`, `true_free_mm` (2,): of the face's middle, where it began and where it was still free;
    `left` (2,): along the face. `deepest_mm`: really; `patch`: None for a miss.
    """

    points: tuple[Contact, ...]
    true_start_mm: Floats
    true_free_mm: Floats
    left: Floats
    deepest_mm: float
    patch: ContactPatch | None


class DrawnPad:
    """A pad with its array, drawn: width, pitch, stiffness, gains, noise; and its bounds."""

    def __init__(self, rng: np.random.Generator, height_mm: float = 10.0) -> None:
        self._rng = rng
        self.width_mm = float(rng.choice([4.0, 10.0, 16.0, 30.0]))
        cols = max(round(self.width_mm / float(rng.choice([0.5, 1.0, 2.0, 3.4]))), 2)
        self.tip = TipConfig(
            shape="pad",
            width_mm=self.width_mm,
            radius_bound_mm=float(rng.choice([0.0, 0.3])),
            stiffness_n_per_mm=6.0,
            stiffness_spread=_SPREAD,
        )
        self._half_mm = self.width_mm / 2 + self.tip.radius_bound_mm * float(rng.uniform(-1, 1))
        self.finger = Finger(self.width_mm / 2, height_mm, shape=TipShape.PAD)
        self.bound_mm = float(rng.choice([0.02, 0.15, 0.5]))
        self.tilt_rad = float(rng.choice([0.0005, 0.02]))
        self._face = PadFace(self._half_mm, 6.0 * (1 + _SPREAD * rng.uniform(-1, 1)))
        pitch = (self.width_mm + 2 * self.tip.radius_bound_mm) / cols
        description = describe(Shape.FLAT, _ROWS, cols, pitch, 4.0, counts_per_n=_PER_N)
        self._columns = np.asarray(description.columns)
        noise, crosstalk = float(rng.choice([0.5, 2.0])), float(rng.uniform(0.04, 0.1))
        self._taxels = Taxels(
            description,
            seed=int(rng.integers(2**32)),
            noise_counts=noise,
            gain_spread=_SPREAD,
            offset_counts=20.0,
            crosstalk=crosstalk,
        )
        shape = (_ROWS, cols)
        self._extractor = ContactExtractor(
            description, TipCalibration(gain=np.ones(shape), gain_spread=_SPREAD, contact_force_n=0.2)
        )
        self._extractor.tare(self._frames(np.zeros(shape), 64))

    def _frames(self, force_n: Floats, count: int) -> list[TactileFrame]:
        return [TactileFrame(k, 0.0, 0.0, self._taxels.counts(force_n)) for k in range(count)]

    def trial(self, part: shapely.Geometry, middle_mm: Floats) -> PadTrial:
        """An approach from anywhere that passes near a place (2,) of W."""
        rng = self._rng
        angle, tilt = float(rng.uniform(-math.pi, math.pi)), self.tilt_rad / 2 * float(rng.uniform(-1, 1))
        ahead = np.array([math.cos(angle), math.sin(angle)])
        start = middle_mm + rng.uniform(-25, 25) * np.array([-ahead[1], ahead[0]]) - 110.0 * ahead
        half = self._half_mm
        left = np.array([-math.sin(angle + tilt), math.cos(angle + tilt)])
        travel = face_stop_mm(part, start, angle, half, tilt)
        patch, dent = None, 0.0
        if math.isfinite(travel):
            dent, patch = self._pressed(part, start + travel * ahead, ahead, angle + tilt)
        far = min(travel, 200.0)
        said = self._off()
        facing = angle + tilt + self.tilt_rad / 2 * float(rng.uniform(-1, 1))
        if patch is None:
            way = Contact(
                "f", self.finger, False, _pair(start + said), _pair(start + far * ahead + said), self.bound_mm
            )
            points = face_points_of(way, self.tip, facing, self.tilt_rad)
            return PadTrial(points, start, start + far * ahead, left, 0.0, None)
        force = max(patch.force_n, 0.4)
        touch = PadTouch(
            "f",
            self.finger,
            _pair(start + said),
            _pair(start + (travel + dent) * ahead + self._off()),
            facing,
            self.tilt_rad,
            dent_range_mm(force, patch.force_bound_n, self.tip, _HARD_N)[1],
            self.bound_mm,
            self.bound_mm,
        )
        points = (
            *touched_points(touch, patch, self.tip),
            *face_points_of(touch.way, self.tip, facing, self.tilt_rad),
        )
        return PadTrial(points, start, start + travel * ahead, left, dent, patch)

    def _pressed(
        self, part: shapely.Geometry, at_mm: Floats, ahead: Floats, facing_rad: float
    ) -> tuple[float, ContactPatch | None]:
        """How far the face presses on until it bears a drawn force, and what its array shows then."""
        outline, wanted = outline_of(part), float(self._rng.uniform(0.4, 2.5))
        low, high = 0.0, 3.0
        for _ in range(30):
            dent = (low + high) / 2
            press = self._face.press(outline, at_mm + dent * ahead, facing_rad, IN_PLACE)
            bears = 0.0 if press is None else float(press.load.on_skin_n.sum())
            low, high = (dent, high) if bears < wanted else (low, dent)
        press = self._face.press(outline, at_mm + high * ahead, facing_rad, IN_PLACE)
        assert press is not None
        force = np.repeat(press.load.by_column_n(self._columns)[None] / _ROWS, _ROWS, axis=0)
        return high, self._extractor.extract(self._frames(force, 8))

    def _off(self) -> Floats:
        around = float(self._rng.uniform(-math.pi, math.pi))
        away = self.bound_mm * math.sqrt(self._rng.uniform())
        return away * np.array([math.cos(around), math.sin(around)])


def _pair(point: Floats) -> tuple[float, float]:
    x, y = point.tolist()
    return x, y


# ----------------------------------------------------------------------------------------------------
# Grips of pads, simulated by shapely alone, without arrays: errors as large as approaches allow.

_DENT_MM, _DEEPEST_MM = 0.05, 0.1


def pad_contacts(
    placed: Placed, approaches: Sequence[Approach], rng: np.random.Generator, pitch_mm: float = 0.5
) -> list[Contact]:
    """What points of faces meet of a part: one column presses, the one where the part is met first."""
    return [contact for approach in approaches for contact in _touch(placed.shape, approach, rng, pitch_mm)]


def _touch(
    part: shapely.Geometry, approach: Approach, rng: np.random.Generator, pitch_mm: float
) -> tuple[Contact, ...]:
    angle, half = approach.direction_rad, approach.finger.tip_radius_mm
    bound = approach.position_bound_mm - math.hypot(pitch_mm, _DEEPEST_MM) / 2
    assert bound > 0
    around = angle + float(rng.choice([0.0, math.pi, rng.uniform(-math.pi, math.pi)]))
    off = bound * np.array([math.cos(around), math.sin(around)])
    ahead = np.array([math.cos(angle), math.sin(angle)])
    start = np.array(approach.start_mm) + off
    said = start - off
    tip = TipConfig(shape="pad", width_mm=2 * half, stiffness_n_per_mm=6.0, stiffness_spread=0.2)
    stop = face_stop_mm(part, start, angle, half)
    if stop > approach.travel_mm:
        end = said + approach.travel_mm * ahead
        way = Contact("f", approach.finger, False, _pair(said), _pair(end), bound)
        return face_points_of(way, tip, angle, 0.0)
    met = shapely.intersection(seen_along(part, start, angle), shapely.box(0.0, -half, stop + 1e-6, half))
    across = float(shapely.get_coordinates(met)[0, 1])
    column = min(max(math.floor((across + half) / pitch_mm), 0), math.ceil(2 * half / pitch_mm) - 1)
    pressed = -half + column * pitch_mm, -half + (column + 1) * pitch_mm
    touch = PadTouch(
        "f",
        approach.finger,
        _pair(said),
        _pair(said + (stop + _DENT_MM) * ahead),
        angle,
        0.0,
        _DEEPEST_MM,
        bound,
        bound,
    )
    patch = ContactPatch(*[math.nan] * 4, *[(0.0, 0.0, 0.0)] * 2, *[math.nan] * 6, (pressed, pressed))
    return (*touched_points(touch, patch, tip), *face_points_of(touch.way, tip, angle, 0.0))
