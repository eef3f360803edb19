"""Hidden truth of emulated servos and parts, drawn within what a rig file's `[emulation]` allows.

Friction, cogging and lost torque, which are each servo's own, and a supply
with a resistance, which all share (`[emulation.mechanics]`); and where fingers stand when they are switched
on: as a person has put them, or anywhere, drawn again while fingers would cross, or one would stand in a
part or in an obstacle.

*Part.* The centre of mass is that of the state's sections, as of one material. On its whole base the part
stands as a stiff body on an elastic foundation that cannot pull: the pressure grows linearly with the place,
so that it balances about the centre of mass.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.optional_imports import import_extra
from palpate.config import RigFile
from palpate.config.emulation import EmulatedPartConfig, MechanicsConfig, Range
from palpate.drivers.emulators import (
    GRAVITY_M_S2,
    Bench,
    Displacements,
    EmulatedServo,
    FrictionSupport,
    Parts,
    QuasiStaticPart,
    QuasiStaticParts,
    StillParts,
)
from palpate.drivers.kinematics import FingerBody, Servos, Turn
from palpate.rig.emulated.finger_truth import draw
from palpate.rig.emulated.scene import Placement, displace, shape_of
from palpate.rig.emulated.table import overlap
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.mechanisms.swept_volume import is_apart

_SUPPORT_POINTS = 100  # on a whole base
_MUJOCO_SUPPORT_POINTS = 25  # for MuJoCo, which takes its time for each
_MIN_POINTS_ACROSS = 4
_MAX_SUPPORT_DRAWS = 3000
_MIN_FOOT_SHARE = 0.3  # of what a foot bears on average
_MIN_FEET_SPREAD_MM = 2.0  # across the feet: on less, feet that yield by 0.1 mm let a part of 20 mm fall over
_MIN_MARGIN_SHARE = 0.3  # of the way from under the centre of mass to the base's edge


@dataclass(frozen=True)
class PartTruth:
    """Truth of how the emulated part moves: `seed` decides where its feet are."""

    engine: str
    mass_kg: float
    friction: float
    tip_friction: float
    feet: int
    seed: int

    @property
    def slip_n(self) -> float:
        """Force through the centre of friction at which the part slides."""
        return self.friction * self.mass_kg * GRAVITY_M_S2


def draw_parts(
    config: EmulatedPartConfig | None, placements: Sequence[Placement], seed: int
) -> tuple[PartTruth, ...]:
    """Draw what a rig file leaves open; what a placement says of its part goes before it."""
    if config is None:
        return ()
    tip_friction = draw_tip_friction(config, seed)
    return tuple(
        _draw_part(config, placement, tip_friction, np.random.default_rng([seed, 6, number]))
        for number, placement in enumerate(placements)
    )


def _draw_part(
    config: EmulatedPartConfig, placement: Placement, tip_friction: float, rng: np.random.Generator
) -> PartTruth:
    mass_share, friction_share, _ = rng.uniform(size=3)
    return PartTruth(
        config.engine,
        placement.mass_kg or _draw(config.mass_kg, float(mass_share), logarithmic=True),
        placement.friction or _draw(config.friction, float(friction_share)),
        tip_friction,
        config.feet,
        int(rng.integers(2**31)),
    )


def draw_tip_friction(config: EmulatedPartConfig | None, seed: int) -> float:
    """Draw the friction between tips and whatever they touch: the third number of the first part's draw."""
    if config is None:
        return 0.0
    return _draw(config.tip_friction, float(np.random.default_rng([seed, 6]).uniform(size=3)[2]))


def _draw(value: float | Range, share: float, *, logarithmic: bool = False) -> float:
    if not isinstance(value, tuple):
        return value
    lo, hi = value
    return lo * (hi / lo) ** share if logarithmic else lo + share * (hi - lo)


def parts_of(truths: Sequence[PartTruth], placements: Sequence[Placement]) -> Parts:
    """The parts in their engine; without truths they stand still.

    Raises InputError for one whose centre of mass is not above its base, and if MuJoCo is not installed;
    where they slide without inertia, also in the run, once one is pushed into another.
    """
    if not truths or truths[0].engine == "still":
        return StillParts(len(placements))
    supports = [support_of(truth, lies) for truth, lies in zip(truths, placements, strict=True)]
    if truths[0].engine == "quasi-static":
        parts = [QuasiStaticPart(support) for support in supports]
        return parts[0] if len(parts) == 1 else QuasiStaticParts(parts, partial(_check_apart, placements))
    import_extra("mujoco", "physics", 'the rig file\'s emulation.part.engine = "mujoco"')
    from palpate.rig.emulated.mujoco_bodies import mujoco_parts  # noqa: PLC0415  # an extra

    return mujoco_parts(supports, placements)


def _check_apart(placements: Sequence[Placement], displacements: Displacements) -> None:
    """Raise InputError if a part was pushed into another."""
    lying = [displace(lies, by) for lies, by in zip(placements, displacements, strict=True)]
    for one, other in combinations(lying, 2):
        if overlap(one, other):
            raise InputError(
                'emulation.part.engine: is "quasi-static", which has no rule for parts that push each other, '
                f'and "{one.model.name}" was pushed into "{other.model.name}"; let it be "mujoco"'
            )


def support_of(truth: PartTruth, placement: Placement) -> FrictionSupport:
    """Points on which the part stands, with loads that balance about its centre of mass."""
    base = shape_of(placement, placement.state.sections[0])
    centre, _ = centre_of_mass(placement)
    margin = _margin_mm(base.convex_hull, centre)
    if margin <= 0:
        raise InputError(
            f"{placement.model.name}, {placement.state.name}: its centre of mass is not above its base, so "
            "it cannot stand so on an emulated table where parts move; check the sections' heights, or set "
            'emulation.part.engine = "still"'
        )
    if truth.feet:
        feet, share = _feet(base, centre, margin, truth.feet, np.random.default_rng(truth.seed))
    else:
        feet = _grid(base, _MUJOCO_SUPPORT_POINTS if truth.engine == "mujoco" else _SUPPORT_POINTS)
        feet, share = _without_pull(feet, centre)
    return FrictionSupport(feet, share, truth.mass_kg, truth.friction)


def centre_of_mass(placement: Placement) -> tuple[Floats, float]:
    """Centre of mass in W (2,), and its height above the table, mm."""
    shapes = [shape_of(placement, section) for section in placement.state.sections]
    lows, highs = np.array([section.z_mm for section in placement.state.sections]).T
    volume = shapely.area(shapes) * (highs - lows)
    centres = shapely.get_coordinates(shapely.centroid(shapes))
    return volume @ centres / volume.sum(), float(volume @ (lows + highs) / 2 / volume.sum())


def _margin_mm(hull: shapely.Geometry, point: Floats) -> float:
    """Distance of a point from the edge of a convex region; negative outside of it."""
    at = shapely.Point(*point)
    away = float(shapely.distance(shapely.boundary(hull), at))
    return away if shapely.contains(hull, at) else -away


def _grid(base: shapely.Geometry, count: int) -> Floats:
    """About `count` points (n, 2), spread evenly over the base in rows along its length."""
    corner, along, across = _box(base)
    pitch = math.sqrt(base.area / count)
    rows, columns = (
        max(_MIN_POINTS_ACROSS, round(float(np.hypot(*side)) / pitch)) for side in (across, along)
    )
    while True:
        u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
        points: Floats = corner + u.reshape(-1, 1) * along + v.reshape(-1, 1) * across
        points = points[shapely.contains_xy(base, *points.T)]
        if len(points) >= count / 2:
            return points
        rows, columns = 2 * rows, 2 * columns  # thin walls between the rows


def _box(base: shapely.Geometry) -> tuple[Floats, Floats, Floats]:
    """A rectangle round the base, the smallest as a rule: a corner (2,), and two of its sides from there."""
    box = shapely.minimum_rotated_rectangle(base)
    if shapely.area(box) >= shapely.area(base):
        corner, along, across = shapely.get_coordinates(box)[[0, 1, 3]]
        return corner, along - corner, across - corner
    # GEOS (3.14.1) gives 1 of some 6,000 placements one without width: take that along its longest side.
    ring = shapely.get_coordinates(shapely.convex_hull(base))
    sides = np.diff(ring, axis=0)
    length = np.hypot(*sides.T)
    x, y = sides[np.argmax(length)] / length.max()
    axes = np.array([[x, y], [-y, x]])
    low, high = (ring @ axes.T).min(axis=0), (ring @ axes.T).max(axis=0)
    return low @ axes, (high - low)[0] * axes[0], (high - low)[1] * axes[1]


def _without_pull(points: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Points that bear something, and what they bear (n,)."""
    while True:
        share = _balance_loads(points, np.ones(len(points)), centre)
        if share.min() >= 0:
            return points, share
        points = points[share > 0]


def _feet(
    base: shapely.Geometry, centre: Floats, margin_mm: float, count: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Feet drawn in the base, none of them nearly free, with the centre of mass well between them."""
    low, high = np.array(shapely.bounds(base)).reshape(2, 2)
    for _ in range(_MAX_SUPPORT_DRAWS):
        points = rng.uniform(low, high, (8 * count, 2))
        points = points[shapely.contains_xy(base, *points.T)][:count]
        load = rng.uniform(0.3, 1.0, count)
        if len(points) < count:
            continue
        share = _balance_loads(points, load, centre)
        hull = shapely.MultiPoint(points).convex_hull
        stands = (
            _margin_mm(hull, centre) >= _MIN_MARGIN_SHARE * margin_mm
            and _spread_mm(points, share) >= _MIN_FEET_SPREAD_MM
        )
        if share.min() >= _MIN_FOOT_SHARE / count and stands:
            return points, share
    raise InputError(
        f"emulation.part.feet: is {count}; the part would fall over on nearly any such feet; "
        "draw more of them, or let it stand on its whole base (0)"
    )


def _spread_mm(points: Floats, share: Floats) -> float:
    """Standard deviation of the load's place across the line along which it is widest."""
    off = points - share @ points
    least = float(np.linalg.eigvalsh(off.T @ (share[:, None] * off))[0])
    return math.sqrt(max(least, 0.0))


def _balance_loads(points: Floats, load: Floats, centre: Floats) -> Floats:
    """Loads (n,) that sum up to 1 and balance about `centre`: `load` times a linear function of the place."""
    lever = np.column_stack([np.ones(len(points)), points - centre])
    moments = lever.T @ (load[:, None] * lever)
    result: Floats = load * (lever @ np.linalg.lstsq(moments, np.array([1.0, 0.0, 0.0]))[0])
    return result


_COGS_PER_TURN = 60  # along a turn of the output shaft
_LEAST_CHANGE_V = 0.05


def add_imperfections(bench: Bench, rig: RigFile, seed: int) -> None:
    """Let servos, supply and screws of a bench be as they are drawn."""
    if rig.emulation is not None and rig.emulation.encoder_error_deg:
        _add_encoder_errors(bench, math.radians(rig.emulation.encoder_error_deg), seed)
    drawn = None if rig.emulation is None else rig.emulation.mechanics
    if drawn is None:
        return
    rng = np.random.default_rng([seed, 13])
    for servo in bench.servos:
        _add_servo_imperfections(servo, drawn, rng)
    ohm = draw(drawn.supply_ohm, 0.0, rng)
    if ohm:
        bench.supply = _SharedSupply(bench.servos, ohm).sag
    slipping = bench.fingers[int(rng.integers(len(bench.fingers)))]
    at, by = float(rng.uniform(*drawn.slip_after_s)), draw(drawn.slip_mm, 0.0, rng)
    if by:
        bench.happenings.append((at, partial(slipping.slip, by)))


def _add_encoder_errors(bench: Bench, most_rad: float, seed: int) -> None:
    """Let magnets of fingers' servos sit off centre: waves of one and two periods, `most_rad` together."""
    rng = np.random.default_rng([seed, 16])
    for finger in bench.fingers:
        for servo in finger.servos:
            size, share = most_rad * rng.uniform(0.3, 1), rng.uniform()
            first, second = rng.uniform(0, 2 * math.pi, 2).tolist()
            servo.set_encoder((size * share, first), (size * (1 - share), second))


def _add_servo_imperfections(servo: EmulatedServo, drawn: MechanicsConfig, rng: np.random.Generator) -> None:
    model_nm = servo.motion.friction_nm
    servo.motion.set_mechanics(
        draw(drawn.friction, 1.0, rng),
        draw(drawn.rest_friction, 1.0, rng),
        1.0 - draw(drawn.torque_loss, 0.0, rng),
    )
    cogging_nm, phase = draw(drawn.cogging, 0.0, rng) * model_nm, float(rng.uniform(0, 2 * math.pi))
    if cogging_nm:
        servo.hold(lambda rad, _rad_s: cogging_nm * math.sin(_COGS_PER_TURN * rad + phase))


class _SharedSupply:
    """A supply whose voltage drops by its resistance times what all motors take."""

    def __init__(self, servos: list[EmulatedServo], ohm: float) -> None:
        self._servos, self._ohm = servos, ohm
        self._full_v = self._now_v = min(servo.nominal_v for servo in servos)

    def sag(self) -> None:
        """Set the voltage that is left."""
        taken_a = sum(servo.motor_power_w for servo in self._servos) / max(self._now_v, 1.0)
        left_v = max(self._full_v - self._ohm * taken_a, 0.0)
        if abs(left_v - self._now_v) < _LEAST_CHANGE_V:
            return
        self._now_v = left_v
        for servo in self._servos:
            servo.set_supply(left_v)


_MAX_DRAWS = 10_000
_MIN_GAP_MM = 3.0  # more than the truth may differ from the description, on any rig that is used


def start_stage_rad(rig: RigFile, rng: np.random.Generator) -> float:
    """Angle at which the stage stands at first; 0 without one, or where nothing starts anywhere."""
    if rig.stage is None or rig.emulation is None or rig.emulation.start == "waiting":
        return 0.0
    return math.radians(rng.uniform(*rig.stage.range_deg))


def start_postures(
    rig: RigFile, placements: Sequence[Placement], stage_rad: float, rng: np.random.Generator
) -> list[Servos]:
    """Shaft angles (rad) of each finger's servos, turns counted, with the stage at an angle.

    Raises InputError if no posture is found in which fingers are apart.
    """
    mechanisms = [mechanism_of(finger) for finger in rig.fingers]
    if rig.emulation is None or rig.emulation.start == "waiting":
        return [item.start_rad(rig.clear_radius_mm) for item in mechanisms]
    turn = Turn(Stage.of(rig).centre_mm, stage_rad)
    parts = [shape_of(lies, section) for lies in placements for section in lies.state.sections]
    posts: list[shapely.Geometry] = [shapely.Polygon(item.outline_mm) for item in rig.obstacles]
    for _ in range(_MAX_DRAWS):
        drawn = [item.draw_posture(rng) for item in mechanisms]
        if _is_free(mechanisms, drawn, turn, parts, posts):
            return drawn
    raise InputError(
        'emulation.start: is "anywhere", and no posture was found in which fingers stand apart; '
        'let it be "waiting"'
    )


def _is_free(
    fingers: Sequence[Mechanism],
    postures: Sequence[Servos],
    turn: Turn,
    parts: Sequence[shapely.Geometry],
    posts: Sequence[shapely.Geometry],
) -> bool:
    """True if fingers are apart, and clear of parts, above which links of arms pass, and of posts."""
    bodies = [
        finger.kinematics.body(angles, finger.spec.tip.radius_mm)
        for finger, angles in zip(fingers, postures, strict=True)
    ]
    apart = all(is_apart(one, two, _MIN_GAP_MM) for k, one in enumerate(bodies) for two in bodies[:k])
    return (
        apart
        and all(
            _clear_mm(body, k, turn, part) > _MIN_GAP_MM
            for finger, body in zip(fingers, bodies, strict=True)
            for k in (range(len(body.start)) if math.isinf(finger.lowest_link_mm) else (len(body.start) - 1,))
            for part in parts
        )
        and all(
            _clear_mm(body, k, turn, post) > _MIN_GAP_MM
            for body in bodies
            for k in range(len(body.start))
            for post in posts
        )
    )


def _clear_mm(body: FingerBody, piece: int, turn: Turn, part: shapely.Geometry) -> float:
    ends = [turn.point_mm((float(x), float(y))) for x, y in (body.start[piece], body.end[piece])]
    return float(shapely.LineString(ends).distance(part) - body.half_width[piece])
