"""Three simulated slides with hidden truth that touch discs and plates, by closed forms of its own.

A tip's centre stops where its way meets the reference grown by the tip's radius: a larger circle, or shifted
faces joined by circles round the corners. Shares with the code under test only what touches are made of.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.finger_fit import ReferencePlacement, TouchArrays
from palpate.calibration.measurements import Reference, ReferenceDisc, ReferencePlate
from palpate.calibration.slide_model import SlideModel
from palpate.config import SlideFingerConfig, load_rig
from palpate.drivers.kinematics import Encoder
from support.commands.repository import EXAMPLES

FRESH = load_rig(EXAMPLES / "fresh-rig.toml")
SPECS = [finger for finger in FRESH.fingers if isinstance(finger, SlideFingerConfig)]

DISC = ReferenceDisc("disc", 25.0)
SQUARE = np.array([[-40.0, -40.0], [40.0, -40.0], [40.0, 40.0], [-40.0, 40.0]])
PLATE = ReferencePlate("plate", SQUARE)
SIGMA_MM = 0.015
OFFSETS_MM = (-13.0, -6.5, 0.0, 6.5, 13.0)

COLUMNS = 15
BASE_X, BASE_Y, HEADING, RADIUS, ZERO, AIM_PLAY, SCALE = range(7)
ENCODERS = slice(7, 15)
# Of the prior: bases and headings as put together from a drawing, slides as homed.
PRIOR_SIGMA = (1.0, 1.0, math.radians(1.0), 0.15, 0.02, math.radians(0.005), 1e-4, *[1e-5] * 8)
# Servos that turn either way, and gears of their own, so that no sign can be missed.
GEARS = (5.0, -4.0, 6.0)
AIM_ZEROS_RAD = (0.0, 0.3, -0.2)
MM_PER_RAD = (16.0, 15.5, -16.5)


@dataclass(frozen=True, eq=False)
class Laid:
    """A reference as it really lies: a circle, or corners (k, 2) counter-clockwise, in W."""

    centre_mm: Floats
    theta_rad: float
    radius_mm: float = 0.0
    corners_mm: Floats | None = None


@dataclass(frozen=True)
class Meeting:
    """Where a way meets a reference: after how far, how oblique (rad), and how far the face goes on (mm)."""

    travel_mm: float
    oblique_rad: float
    room_mm: float


def models(encoder_sigma_rad: float = PRIOR_SIGMA[-1]) -> list[SlideModel]:
    """What is known of the three fingers beforehand."""
    known = (*PRIOR_SIGMA[:7], *[encoder_sigma_rad] * 8)
    found = []
    for spec, gear, zero, per_rad in zip(SPECS, GEARS, AIM_ZEROS_RAD, MM_PER_RAD, strict=True):
        x, y = spec.base_mm
        own = [x, y, math.radians(spec.heading_deg), 5.0, 90.0, math.radians(0.01)]
        prior = np.array([*own, *[0.0] * 9])
        sigma = np.diag(np.square(known))
        found.append(SlideModel(spec, prior, sigma, gear, zero, per_rad))
    return found


def drawn(rng: np.random.Generator, encoder_sigma_rad: float = PRIOR_SIGMA[-1]) -> Floats:
    """True values (3, 15), as likely as the priors say."""
    first = slice(0, ENCODERS.start)
    found = np.array([model.prior for model in models()])
    for own, model in zip(found, models(), strict=True):
        own[first] = rng.multivariate_normal(model.prior[first], model.covariance[first, first])
    found[:, ENCODERS] = rng.spawn(1)[0].normal(0.0, encoder_sigma_rad, (3, 8))
    return found


def laid(reference: Reference, x_mm: float, y_mm: float, theta_rad: float, grown_mm: float = 0.0) -> Laid:
    """A reference at a pose; `grown_mm`: by how much it is really larger all round."""
    centre = np.array([x_mm, y_mm])
    if isinstance(reference, ReferenceDisc):
        return Laid(centre, 0.0, reference.radius_mm + grown_mm)
    corners = SQUARE + np.sign(SQUARE) * grown_mm
    c, s = math.cos(theta_rad), math.sin(theta_rad)
    return Laid(centre, theta_rad, corners_mm=corners @ np.array([[c, s], [-s, c]]) + centre)


def some_places(rng: np.random.Generator, grown_mm: tuple[float, float] = (0.0, 0.0)) -> list[Laid]:
    """Where disc and plate really lie, each twice; `grown_mm`: disc's and plate's error all round."""
    found = []
    for placing in placings():
        x, y = np.array(placing.about_mm) + rng.uniform(-6, 6, 2)
        grown = grown_mm[0] if placing.reference is DISC else grown_mm[1]
        found.append(laid(placing.reference, float(x), float(y), float(rng.uniform(-3, 3)), grown))
    return found


def placings() -> list[ReferencePlacement]:
    """Where they are said to lie."""
    return [
        ReferencePlacement(DISC, (0.0, 0.0)),
        ReferencePlacement(DISC, (35.0, 20.0)),
        ReferencePlacement(PLATE, (0.0, 0.0)),
        ReferencePlacement(PLATE, (-20.0, 20.0)),
    ]


def nearly(where: Sequence[Laid]) -> tuple[Floats, Floats]:
    """What a fit may begin with: values as known beforehand, poses that are a little off.

    Without it plates' orientations are looked for, which takes most of a fit's time.
    """
    poses = np.array([[*place.centre_mm, place.theta_rad] for place in where])
    poses[:, :2] += np.array([0.4, -0.3])
    poses[:, 2] += 0.02 * (poses[:, 2] != 0)
    return np.array([model.prior for model in models()]), poses


def met(start: Floats, direction_rad: float, where: Laid, tip_mm: float) -> Meeting | None:
    """The first contact of a tip's centre that comes from outside; None if it passes."""
    along = np.array([math.cos(direction_rad), math.sin(direction_rad)])
    if where.corners_mm is None:
        travel = _to_circle(start, along, where.centre_mm, where.radius_mm + tip_mm)
        return None if travel is None else _meeting(start, along, travel, where.centre_mm, math.inf)
    first: Meeting | None = None
    for begin, end in zip(where.corners_mm, np.roll(where.corners_mm, -1, axis=0), strict=True):
        first = _nearer(first, _on_face(start, along, begin, end, tip_mm))
        travel = _to_circle(start, along, begin, tip_mm)
        if travel is not None:
            first = _nearer(first, _meeting(start, along, travel, begin, 0.0))
    return first


def touches(
    values: Floats,
    where: Sequence[Laid],
    rng: np.random.Generator,
    *,
    sigma_mm: float = SIGMA_MM,
    offsets_mm: Sequence[float] = OFFSETS_MM,
) -> TouchArrays:
    """Touches of everything by everyone, their distances off by `sigma_mm`; only faces, well inside.

    Each finger passes its reference's centre at every offset, its aim coming from either side.
    """
    rows = []
    for number, place in enumerate(where):
        for finger, offset in ((f, o) for f in range(len(values)) for o in offsets_mm):
            own = values[finger]
            to = place.centre_mm - own[:2]
            direction = math.atan2(to[1], to[0]) + offset / math.hypot(*to)
            way, dent = float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.05, 0.3))
            tip = own[RADIUS] - dent + rng.normal(0.0, sigma_mm)
            found = met(own[:2], direction, place, tip)
            if found is None or abs(found.oblique_rad) > math.radians(48.0) or found.room_mm < 2.0:
                continue
            aim, slide = servos_rad(own, finger, direction, found.travel_mm, way)
            rows.append((finger, number, aim, slide, way, dent))
    table = np.array(rows)
    whole = table[:, :2].astype(np.int64)
    spread, used = np.full(len(table), sigma_mm), np.ones(len(table), dtype=bool)
    ways = np.column_stack([table[:, 4], np.zeros(len(table))])
    return TouchArrays(whole[:, 0], whole[:, 1], table[:, 2:4], ways, table[:, 5], spread, used)


def servos_rad(
    own: Floats, finger: int, direction_rad: float, distance_mm: float, way: float
) -> tuple[float, float]:
    """Angles of aim and slide of a finger whose tip is so far from its base in a direction."""
    aim = math.remainder(direction_rad - own[HEADING], 2 * math.pi) + way * own[AIM_PLAY]
    slide = (distance_mm - own[ZERO]) / (MM_PER_RAD[finger] * (1 + own[SCALE]))
    near, far = (Encoder(tuple(waves)) for waves in own[ENCODERS].reshape(2, 4).tolist())
    return near.read_rad(AIM_ZEROS_RAD[finger] + GEARS[finger] * aim), far.read_rad(float(slide))


def spoilt(given: TouchArrays, number: int, off_mm: float) -> TouchArrays:
    """The same, with the slide of one touch off."""
    servos = given.servos_rad.copy()
    servos[number, 1] += off_mm / MM_PER_RAD[int(given.finger[number])]
    return replace(given, servos_rad=servos)


def _to_circle(start: Floats, along: Floats, middle: Floats, radius: float) -> float | None:
    rel = middle - start
    ahead, aside = float(rel @ along), float(along[0] * rel[1] - along[1] * rel[0])
    return ahead - math.sqrt(radius**2 - aside**2) if abs(aside) < radius and ahead > radius else None


def _on_face(start: Floats, along: Floats, begin: Floats, end: Floats, tip: float) -> Meeting | None:
    length = math.dist(begin, end)
    edge = (end - begin) / length
    normal = np.array([edge[1], -edge[0]])
    towards = float(along @ normal)
    if towards >= 0:
        return None
    travel = (tip - float((start - begin) @ normal)) / towards
    at = float((start + travel * along - begin) @ edge)
    if travel < 0 or not 0 <= at <= length:
        return None
    return Meeting(travel, _oblique(along, normal), min(at, length - at))


def _meeting(start: Floats, along: Floats, travel: float, middle: Floats, room: float) -> Meeting:
    away = start + travel * along - middle
    return Meeting(travel, _oblique(along, away / math.hypot(*away)), room)


def _oblique(along: Floats, normal: Floats) -> float:
    """From the way to what points into the surface, counter-clockwise."""
    return math.atan2(-along[0] * normal[1] + along[1] * normal[0], -float(along @ normal))


def _nearer(one: Meeting | None, other: Meeting | None) -> Meeting | None:
    known = [meeting for meeting in (one, other) if meeting is not None]
    return min(known, key=lambda meeting: meeting.travel_mm, default=None)
