"""A tip pressed on a reference step by step, with friction, an aim that gives way, and play that goes.

For the simulated prober: every step is brought to equilibrium, without servos and time. Truth and skin are
those of an emulated finger.
"""

import cmath
import math

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.measurements import ServoPath
from palpate.drivers.emulators.mechanics import ArmTruth, FingerTruth
from palpate.drivers.emulators.skin import Shear, shear_skin
from palpate.drivers.emulators.tip import PartSection, TipLoad, tip_load
from palpate.drivers.kinematics import TICK_RAD, Servos

_ROUNDS = 12


def bends_of_arm(truth: ArmTruth, links_rad: tuple[float, float], force_n: Floats) -> tuple[float, float]:
    """By how much a force (2,) on the tip turns both joints, with the links in these directions."""
    upper, fore = cmath.rect(truth.upper_mm, links_rad[0]), cmath.rect(truth.fore_mm, links_rad[1])
    force = complex(*force_n)
    turns = []
    for joint, arm in ((truth.shoulder, upper + fore), (truth.elbow, fore)):
        softness = 0.0 if joint.yields is None else joint.yields.rad_per_nmm
        turns.append(softness * (arm.conjugate() * force).imag)
    return turns[0], turns[1]


class LoadedTip:
    """A tip at an aim (`travel_rad` with the play in the middle) whose slide is put from place to place."""

    def __init__(
        self, truth: FingerTruth, outline: PartSection, friction: float, travel_rad: float, way: int
    ) -> None:
        self._truth, self._outline, self._friction, self._travel = truth, outline, friction, travel_rad
        self._in_play, self._bend = -way * truth.aim_play_rad, 0.0
        self._shear: Shear | None = None

    @property
    def travel_rad(self) -> float:
        return self._travel + self._in_play + self._bend

    def centre_mm(self, distance_mm: float) -> Floats:
        x, y = self._truth.base_mm
        angle = self.travel_rad
        return np.array([x + distance_mm * math.cos(angle), y + distance_mm * math.sin(angle)])

    def put(self, distance_mm: float) -> tuple[TipLoad | None, Floats]:
        """Put it at a distance from its base: what the skin feels there, and the force (2,) on the tip."""
        before = self._shear
        for _ in range(_ROUNDS):
            load, shear, force = self._load(distance_mm, before)
            if load is None:
                self._bend = 0.0
            elif self._give_way(distance_mm, force) < 1e-9:
                break
        self._shear = shear
        if load is not None and shear is not None:
            load = load.rotate(load.force_n, shear.angle_rad)
        return load, force

    def _load(self, distance_mm: float, before: Shear | None) -> tuple[TipLoad | None, Shear | None, Floats]:
        truth, centre = self._truth, self.centre_mm(distance_mm)
        load = tip_load(self._outline, centre, truth.tip_radius_mm, truth.stiffness_n_per_mm)
        if load is None:
            return None, None, np.zeros(2)
        shear = shear_skin(
            before,
            load,
            centre,
            0.0,
            radius_mm=truth.tip_radius_mm,
            stiffness_n_per_mm=truth.stiffness_n_per_mm,
            friction=self._friction,
        )
        return load, shear, load.force_n + shear.force_n

    def _give_way(self, distance_mm: float, force: Floats) -> float:
        """Let the aim give way to a force; by how much, rad."""
        gives = self._truth.aim_yield
        if gives is None:
            return 0.0
        angle, stiffness = self.travel_rad, self._truth.stiffness_n_per_mm
        across = float(force[1]) * math.cos(angle) - float(force[0]) * math.sin(angle)
        missing = gives.rad_per_nmm * distance_mm * across - self._bend
        change = missing / (1 + stiffness * gives.rad_per_nmm * distance_mm**2)
        self._bend += change
        beyond = math.copysign(max(abs(across) - gives.play_holds_n, 0.0), across) / stiffness / distance_mm
        play = self._truth.aim_play_rad
        moved = min(max(self._in_play + beyond, -play), play) - self._in_play
        self._in_play += moved
        return abs(change) + abs(moved)


# ----------------------------------------------------------------------------------------------------
# Where the tips of a simulated rig really are: its truth, with plays taken up, and what forces bend.

Truth = FingerTruth | ArmTruth
Ways = tuple[float, float]
"""From which side each joint came, 1 from below, -1 from above: that end of its play it is at."""


def whole_step_rad(angle_rad: float) -> float:
    return round(angle_rad / TICK_RAD) * TICK_RAD


def servos_stood(truth: Truth, item: ServoPath, travel: float) -> Servos:
    """Servo angles after a travel; an aim stands at a whole step."""
    near, far = item.servos_at(np.array([travel]))[0].tolist()
    return (whole_step_rad(near) if isinstance(truth, FingerTruth) else near), far


def slide_distance_mm(truth: FingerTruth, slide_rad: float) -> float:
    """From the base to the tip's centre, with the play taken up as in a touch."""
    return truth.zero_mm + truth.mm_per_rad * slide_rad - truth.slide_play_mm


def gives_way(truth: Truth) -> bool:
    return isinstance(truth, ArmTruth) and truth.elbow.yields is not None


def pushed_tip(
    truth: Truth, servos: Servos, ways: Ways, outline: PartSection | None, force_n: float
) -> tuple[Floats, float]:
    """As `true_tip`, with an arm pushed back from what is nearest with a force."""
    bends = (0.0, 0.0)
    for _ in range(3 if force_n and gives_way(truth) else 0):
        assert isinstance(truth, ArmTruth)
        towards = direction_to(outline, true_tip(truth, servos, ways, bends)[0])
        back = -force_n * np.array([math.cos(towards), math.sin(towards)])
        bends = bends_of_arm(truth, link_directions_rad(truth, servos, ways), back)
    return true_tip(truth, servos, ways, bends)


def link_directions_rad(
    truth: ArmTruth, servos: Servos, ways: Ways, bends: Ways = (0.0, 0.0)
) -> tuple[float, float]:
    """Directions of both links."""
    first, bend = (
        (servo - joint.zero_rad) / joint.gear_ratio - way * joint.play_rad + bent
        for servo, joint, way, bent in zip(servos, (truth.shoulder, truth.elbow), ways, bends, strict=True)
    )
    return truth.heading_rad + first, truth.heading_rad + first + bend


def true_tip(truth: Truth, servos: Servos, ways: Ways, bends: Ways = (0.0, 0.0)) -> tuple[Floats, float]:
    """True centre (2,) with the play taken up as in a touch, and where the finger faces.

    `bends`: by how much a force has turned an arm's joints.
    """
    base = complex(*truth.base_mm)
    if isinstance(truth, FingerTruth):
        facing = truth.heading_rad + (servos[0] - truth.aim_zero_rad) / truth.gear_ratio
        facing -= ways[0] * truth.aim_play_rad
        tip = base + cmath.rect(slide_distance_mm(truth, servos[1]), facing)
    else:
        first, facing = link_directions_rad(truth, servos, ways, bends)
        tip = base + cmath.rect(truth.upper_mm, first) + cmath.rect(truth.fore_mm, facing)
    return np.array([tip.real, tip.imag]), facing


def travel_direction_rad(truth: Truth, item: ServoPath, ways: Ways, travel: float) -> float:
    """True direction of travel there."""
    near, far = (true_tip(truth, servos_stood(truth, item, travel + by), ways)[0] for by in (-2.0, 2.0))
    return math.atan2(far[1] - near[1], far[0] - near[0])


def direction_to(outline: PartSection | None, centre: Floats) -> float:
    """Direction from a point to the nearest point of an outline."""
    assert outline is not None
    rel = centre - outline.start
    share = np.clip(np.einsum("ij,ij->i", rel, outline.along) / outline.square, 0.0, 1.0)
    away = rel - share[:, None] * outline.along
    nearest = away[np.einsum("ij,ij->i", away, away).argmin()]
    return math.atan2(-nearest[1], -nearest[0])
