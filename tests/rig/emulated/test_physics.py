"""Physics of the emulated rig: engines, friction of tips, tips under load."""

import json
import math
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import palpate
from palpate.base.geometry import Floats
from palpate.config import RigFile, SlideFingerConfig
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.drivers.emulators.mujoco_parts import MassDistribution, MujocoBody, MujocoParts
from palpate.drivers.emulators.part import (
    Displacement,
    Displacements,
    FrictionSupport,
    Parts,
    PointForce,
    QuasiStaticPart,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.skin import Shear, shear_skin
from palpate.drivers.emulators.tip import PartSection, tip_load
from palpate.rig.conversion import deflection_mm, deflection_rad, shear_rad
from palpate.rig.emulated.devices import emulate
from support.benches.rigs import quick_bench, small_rig
from support.campaign.sampling import sample

# ----------------------------------------------------------------------------------------------------
# Engines of the emulated part against the theory of sliding: Coulomb, Mason, and Goyal's limit surface.
#
# Shares by which they may differ stand beside each test. Loads of the feet are given, so that both engines
# have
# the same ones.

MASS_KG, FRICTION = 0.15, 0.3
SLIP_N = MASS_KG * FRICTION * 9.80665
R = 25.0
STEP_S = 1e-3
STANDS_MM, MOVES_MM = 0.001, 0.02
"""In 0.2 s, at the rim."""
SHARE = 0.05
"""By how much the start of motion may differ from an integral: for few feet, and steps of load."""


def quasi_static(support: FrictionSupport) -> Parts:
    return QuasiStaticPart(support)


def in_mujoco(support: FrictionSupport) -> Parts:
    x, y = support.centre_mm.tolist()
    return MujocoParts([MujocoBody(support, MassDistribution((x, y), 10.0, (2 * R, 2 * R, 20.0)))])


ENGINES = pytest.mark.parametrize("engine", [quasi_static, in_mujoco])


def even(feet: Floats) -> FrictionSupport:
    return FrictionSupport(feet, np.full(len(feet), 1 / len(feet)), MASS_KG, FRICTION)


def disc(count: int) -> Floats:
    """Points that share a disc's area evenly."""
    k = np.arange(count)
    radius, angle = R * np.sqrt((k + 0.5) / count), k * math.pi * (3 - math.sqrt(5))
    feet: Floats = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return feet - feet.mean(axis=0)


def ring(count: int) -> Floats:
    angle = np.arange(count) * 2 * math.pi / count
    return R * np.column_stack([np.cos(angle), np.sin(angle)])


def pushed(
    part: Parts, forces: list[tuple[tuple[float, float], tuple[float, float]]], seconds: float
) -> float:
    """How far a part moves (mm, turn times R) under forces at points of it, at table height."""

    def tips(displacements: Displacements) -> list[list[PointForce]]:
        (moved,) = displacements
        return [[PointForce(moved.place(np.array(at)), 0.0, np.array(force)) for at, force in forces]]

    for _ in range(round(seconds / STEP_S)):
        part.step(tips, True, STEP_S)
    (moved,) = part.displacements
    return float(np.hypot(*moved.shift_mm)) + R * abs(moved.turn_rad)


def test_mujocos_block_slides_at_the_angle_of_friction() -> None:
    """A force of weight times tan α at table height, 2 % about tan α = μ."""
    support = even(disc(12))
    assert pushed(in_mujoco(support), [((0, 0), (0.98 * SLIP_N, 0))], 0.3) < 0.005
    assert pushed(in_mujoco(support), [((0, 0), (1.02 * SLIP_N, 0))], 0.3) > 0.5


def test_mujocos_part_on_unequal_feet_does_not_drift_sideways() -> None:
    """Feet of any loads that balance about the middle: a push through it does not turn the part."""
    feet = np.array([[-28, -15], [-5, 18], [22, -4], [15, 15], [-20, 8], [9, -18]], dtype=np.float64)
    load = np.array([0.3, 0.25, 0.05, 0.1, 0.05, 0.25])
    support = FrictionSupport(feet - load @ feet, load, MASS_KG, FRICTION)
    corners = np.array([[-30, -20], [30, -20], [30, 20], [-30, 20]], dtype=np.float64)
    tip = Tip(PartSection(corners, np.roll(corners, -1, axis=0), 20.0), 0.0)
    moved = tip.push(in_mujoco(support), np.array([-35.1, 0.0]), np.array([-33.0, 0.0]), 0.15)
    assert moved.shift_mm[0] > 1.5
    assert abs(moved.shift_mm[1]) < 0.02
    assert abs(moved.turn_rad) < math.radians(0.1)


def test_mujocos_part_does_not_creep_under_half_the_load() -> None:
    part = in_mujoco(even(disc(12)))
    force = [((0.0, 0.0), (0.5 * SLIP_N, 0.0))]
    before = pushed(part, force, 0.3)
    assert abs(pushed(part, force, 0.5) - before) < 0.5e-3


@ENGINES
@pytest.mark.parametrize(("feet", "mean"), [(disc(30), 2 / 3), (ring(24), 1.0)])
def test_the_moment_that_turns_a_disc_and_a_ring(
    engine: Callable[[FrictionSupport], Parts], feet: Floats, mean: float
) -> None:
    """About the centre: 2/3 μ m g R and μ m g R."""

    def turned(share: float) -> float:
        push = share * mean * SLIP_N / 2
        return pushed(engine(even(feet)), [((R, 0), (0, push)), ((-R, 0), (0, -push))], 0.2)

    assert turned(1 - SHARE) < STANDS_MM
    assert turned(1 + SHARE) > MOVES_MM


def starts_at_n(lever_mm: float) -> float:
    """Force across a lever that starts a uniform disc.

    The least, over all centres of rotation, of what friction takes by what the force gives (Goyal 1991).
    """
    radius = R * np.sqrt((np.arange(200) + 0.5) / 200)[:, None]
    angle = (np.arange(200) + 0.5)[None, :] * 2 * math.pi / 200
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    centres = -np.geomspace(0.01, 1000, 400)
    return min(SLIP_N * float(np.hypot(x - c, y).mean()) / (lever_mm - c) for c in centres)


@ENGINES
@pytest.mark.parametrize("lever_mm", sample([0.3 * R, 0.9 * R], [0.9 * R]))
def test_a_force_beside_the_centre_starts_a_disc_on_its_limit_surface(
    engine: Callable[[FrictionSupport], Parts], lever_mm: float
) -> None:
    def moved(share: float) -> float:
        return pushed(engine(even(disc(30))), [((lever_mm, 0), (0, share * starts_at_n(lever_mm)))], 0.2)

    assert moved(1 - SHARE) < STANDS_MM
    assert moved(1 + SHARE) > MOVES_MM


class Tip:
    """A tip that is moved along a line, and the skin on it."""

    RADIUS, STIFFNESS = 5.0, 3.0

    def __init__(self, outline: PartSection, friction: float) -> None:
        self.outline, self.friction = outline, friction
        self.centre = np.zeros(2)
        self.skin: Shear | None = None
        self.tried: Shear | None = None

    def forces(self, displacement: Displacement) -> list[PointForce]:
        centre = displacement.back(self.centre)
        load = tip_load(self.outline, centre, self.RADIUS, self.STIFFNESS)
        self.tried = load and shear_skin(
            self.skin,
            load,
            centre,
            displacement.turn_rad,
            radius_mm=self.RADIUS,
            stiffness_n_per_mm=self.STIFFNESS,
            friction=self.friction,
        )
        if load is None or self.tried is None:
            return []
        drag = displacement.rotate(self.tried.force_n)
        return [
            PointForce(self.centre, 5.0, -displacement.rotate(load.force_n)),
            PointForce(displacement.place(self.tried.point_mm), 5.0, -drag),
        ]

    def push(self, part: Parts, start: Floats, end: Floats, seconds: float) -> Displacement:
        steps = round(seconds / STEP_S)
        for k in range(steps):
            self.centre = start + (end - start) * (k + 1) / steps
            touched = bool(self.forces(part.displacements[0]))
            part.step(lambda moved: [self.forces(moved[0])], touched, STEP_S)
            self.forces(part.displacements[0])
            self.skin = self.tried
        return part.displacements[0]


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("seed", sample([1, 2, 3], [1]))
def test_the_engines_agree_over_pushes_of_2_mm(friction: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = np.array([[-30, -20], [30, -20], [30, 20], [-30, 20]], dtype=np.float64)
    outline = PartSection(corners, np.roll(corners, -1, axis=0), 20.0)
    feet = rng.uniform([-30, -20], [30, 20], (9, 2))
    support = even(feet)
    start = np.array([-35.1, rng.uniform(-12, 12)])
    angle = rng.uniform(-0.4, 0.4)
    end = start + 2.1 * np.array([math.cos(angle), math.sin(angle)])
    one, other = (
        Tip(outline, friction).push(engine(support), start, end, 0.12) for engine in (quasi_static, in_mujoco)
    )
    assert np.hypot(*one.shift_mm) + 30 * abs(one.turn_rad) > 1
    assert math.dist(one.shift_mm, other.shift_mm) < 0.6
    assert abs(one.turn_rad - other.turn_rad) < math.radians(2)


def test_a_part_that_is_pushed_and_let_go_takes_energy_and_gives_none_back() -> None:
    corners = np.array([[-30, -20], [30, -20], [30, 20], [-30, 20]], dtype=np.float64)
    outline = PartSection(corners, np.roll(corners, -1, axis=0), 20.0)
    part, tip = quasi_static(even(disc(30))), Tip(outline, 0.4)
    apart, pressed = np.array([-35.1, 4.0]), np.array([-33.5, 4.6])
    work, force = 0.0, np.zeros(2)
    for start, end in ((apart, pressed), (pressed, apart)):
        for k in range(60):
            before, held = start + (end - start) * k / 60, force
            tip.push(part, before, start + (end - start) * (k + 1) / 60, STEP_S)
            felt = [item.force_n for item in tip.forces(part.displacements[0])]
            force = np.sum(felt or [np.zeros(2)], axis=0)
            work += float((force + held) / 2 @ (tip.centre - before))
    slid = float(np.hypot(*part.displacements[0].shift_mm))
    assert slid > 0.5
    assert work > 0.9 * SLIP_N * slid


@pytest.mark.parametrize("seed", sample([0, 1, 2], [0]))
def test_a_part_that_is_said_to_stand_still_changes_nothing(tmp_path: Path, seed: int) -> None:
    rig, parts = quick_bench(tmp_path)
    text = re.sub(r"max_grips = \d+", "max_grips = 1", rig.read_text(encoding="utf-8"))
    rig.write_text(text, encoding="utf-8")
    other = tmp_path / "still.toml"
    still = '[emulation.part]\nengine = "still"\n\n[[fingers]]'
    other.write_text(text.replace("[[fingers]]", still, 1), encoding="utf-8")

    def answer(file: Path) -> object:
        with palpate.open_rig(file, seed=seed) as opened:
            found = json.loads(opened.identify(palpate.load_objects(parts), sessions=None).to_json())
        return {key: value for key, value in found.items() if key != "wall_seconds"}

    assert answer(other) == answer(rig)


# ----------------------------------------------------------------------------------------------------
# Skin that sticks, shears and slips: against Coulomb's law, and no path in contact gives energy back.

RADIUS, STIFFNESS = 5.0, 3.0
ALONG = 0.7 * STIFFNESS
SQUARE = [[0, 0], [40, 0], [40, 40], [0, 40]]
NOTCH = [[0, 0], [40, 0], [40, 40], [28, 40], [20, 30], [12, 40], [0, 40]]
KNIFE = [[0, 0], [20, 3], [0, 6]]


def section(corners: list[list[float]]) -> PartSection:
    start = np.array(corners, dtype=np.float64)
    return PartSection(start, np.roll(start, -1, axis=0), 20.0)


def forces(outline: PartSection, path: Floats, friction: float) -> tuple[Floats, list[Shear | None]]:
    """Force (n, 2) on a tip along a path (n, 2) beside a part at rest, and how the skin is sheared."""
    found, skin = [], list[Shear | None]()
    state: Shear | None = None
    for centre in path:
        load = tip_load(outline, centre, RADIUS, STIFFNESS)
        state = load and shear_skin(
            state, load, centre, 0.0, radius_mm=RADIUS, stiffness_n_per_mm=STIFFNESS, friction=friction
        )
        skin.append(state)
        found.append(np.zeros(2) if load is None or state is None else load.force_n + state.force_n)
    return np.array(found), skin


def given_back_mj(path: Floats, force: Floats) -> float:
    """Work of the forces on a tip along a path."""
    return float(np.sum((force[1:] + force[:-1]) / 2 * np.diff(path, axis=0)))


def straight(*corners: tuple[float, float], step_mm: float = 0.005) -> Floats:
    legs = [
        np.linspace(a, b, max(2, round(math.dist(a, b) / step_mm)), endpoint=False)
        for a, b in pairwise(corners)
    ]
    return np.vstack([*legs, corners[-1:]])


def test_skin_sticks_shears_and_slips_on_a_wall() -> None:
    path = straight((10, 45.5), (10, 44.8), (11, 44.8))
    force, skin = forces(section(SQUARE), path, 0.5)
    normal = force[-1][1]
    assert normal == pytest.approx(STIFFNESS * 0.2, rel=0.05)
    at = np.searchsorted(path[:, 0], 10.05)
    assert force[at][0] == pytest.approx(-ALONG * (path[at][0] - 10), rel=0.01)
    assert force[-1][0] == pytest.approx(-0.5 * normal)
    last = skin[-1]
    assert last is not None
    assert last.point_mm == pytest.approx([11, 40], abs=0.01)
    assert abs(last.angle_rad) == pytest.approx(0.5 * normal / ALONG / RADIUS)
    # The wall is below the tip, at −π/2; the skin that sticks there was further to the right before.
    assert last.angle_rad > 0


def test_a_part_that_turns_under_a_tip_carries_the_skin_along() -> None:
    outline, centre = section(SQUARE), np.array([10.0, 44.8])
    load = tip_load(outline, centre, RADIUS, STIFFNESS)
    assert load is not None
    keys = {"radius_mm": RADIUS, "stiffness_n_per_mm": STIFFNESS, "friction": 0.5}
    before = shear_skin(None, load, centre, 0.0, **keys)
    # In the part's frame the tip's axis stays where it is, and the tip turns against the wall.
    after = shear_skin(before, load, centre, 0.01, **keys)
    assert abs(after.shear_mm) == pytest.approx(0.01 * 4.8, rel=0.01)


@settings(max_examples=300, deadline=None)
@given(st.floats(0.0, 360.0), st.floats(10.0, 120.0), st.floats(90.0, 170.0), st.floats(0.2, 2.5))
def test_what_pushes_a_tip_is_on_its_skin(turn: float, wedge: float, aside: float, dent_mm: float) -> None:
    """By the corner of a wedge, too, of which the tip sees one face alone: no ray need meet the corner."""
    angles = np.radians([turn + aside, turn + aside + wedge])
    outline = section([[0, 0], *(60 * np.column_stack([np.cos(angles), np.sin(angles)])).tolist()])
    centre = (RADIUS - dent_mm) * np.array([math.cos(math.radians(turn)), math.sin(math.radians(turn))])
    load = tip_load(outline, centre, RADIUS, STIFFNESS)
    assert load is not None
    felt = load.on_skin_n @ np.column_stack([np.cos(load.angle), np.sin(load.angle)])
    assert np.hypot(*felt) == pytest.approx(np.hypot(*load.force_n))


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.6])
@pytest.mark.parametrize(
    ("corners", "at"),
    [(SQUARE, (10.0, 44.6)), (SQUARE, (43.3, 43.2)), (NOTCH, (20.0, 37.0)), (KNIFE, (24.6, 3.4))],
)
def test_closed_loops_give_back_no_energy(
    corners: list[list[float]], at: tuple[float, float], friction: float
) -> None:
    """From free space into contact, about in it at random, and back the same way."""
    rng = np.random.default_rng(1)
    middle = np.array(at)
    out = middle + (middle - np.mean(corners, axis=0)) * 0.2
    points = [tuple(middle + rng.uniform(-0.35, 0.35, 2)) for _ in range(5)]
    path = straight(tuple(out), *points, tuple(out))
    force, _ = forces(section(corners), path, friction)
    assert np.hypot(*force.T).max() > 0.3
    assert given_back_mj(path, force) < 1e-3
    if friction == 0:
        assert given_back_mj(path, force) > -1e-3


# ----------------------------------------------------------------------------------------------------
# Emulated tips against parts that are pushed about: bent and sheared no further than the rule says.
#
# Contacts on the bench leave slack for other errors; here nothing else is wrong, so that the rule stands
# alone.

MM_PER_N, TIP_FRICTION = 0.5, 1.0
_SETTLED = 60  # ms, several lags of the joint


def extended_finger(friction: float, seed: int) -> tuple[SlideFingerConfig, EmulatedFinger]:
    """A finger whose tip sticks and whose aim yields, as far out as it goes: there its lever is longest."""
    data = small_rig().model_dump(mode="json", exclude_unset=True)
    data["emulation"] |= {
        "deflection_mm_per_n": MM_PER_N,
        "aim_backlash_deg": 0.0,
        "part": {"engine": "still", "tip_friction": friction},
    }
    del data["fingers"][1:]
    data["fingers"][0]["tip"]["max_friction"] = TIP_FRICTION
    data["fingers"][0]["bounds"] |= {"deflection_mm_per_n": MM_PER_N, "deflection_deg_per_n": 0.15}
    rig = RigFile.model_validate(data)
    spec, emulated = rig.fingers[0], emulate(rig, (), seed).bench.fingers[0]
    truth = emulated.truth
    assert isinstance(spec, SlideFingerConfig)
    assert isinstance(truth, FingerTruth)
    slide = EmulatedServo(2, start_rad=(spec.slide.range_mm[1] - truth.zero_mm) / truth.mm_per_rad)
    aim = EmulatedServo(1, start_rad=truth.aim_zero_rad)
    return spec, EmulatedFinger(truth, (aim, slide), emulated.array, [None], tip_friction=friction)


def wall(centre: Floats, towards_rad: float, gap_mm: float) -> PartSection:
    """A square with a face at `gap_mm` from a point, which looks back at it."""
    ahead = np.array([math.cos(towards_rad), math.sin(towards_rad)])
    aside = np.array([-ahead[1], ahead[0]])
    face = centre + gap_mm * ahead
    start = np.array([face - 40 * aside, face + 40 * ahead - 40 * aside, face + 40 * ahead + 40 * aside])
    start = np.vstack([start, face + 40 * aside])
    return PartSection(start, np.roll(start, -1, axis=0), 20.0)


def shares(friction: float, seed: int, way: list[tuple[float, float]]) -> Floats:
    """A part is pushed to places (along its face, towards the tip; mm), and rests at each.

    The tip's largest bend, turn and shear (3,), as shares of what is allowed.
    """
    spec, finger = extended_finger(friction, seed)
    centre, facing = finger.centre_mm, finger.facing_rad
    towards = facing + math.radians(80)
    finger.put([wall(centre, towards, finger.truth.tip_radius_mm + 0.01)])
    turn = np.array([[math.cos(towards), -math.sin(towards)], [math.sin(towards), math.cos(towards)]])
    largest = np.zeros(3)
    at = np.zeros(2)
    for target in way:
        path = np.vstack([np.linspace(at, target, 30), np.tile(target, (_SETTLED, 1))])
        for along, ahead in path:
            finger.touch((Displacement(np.zeros(2), turn @ np.array([-ahead, along]), 0.0),))
            finger.step(1e-3)
        at = np.array(target)
        if finger.press is None:
            continue
        pressing = float(finger.press.by_ray_n.sum())
        bent = math.dist(finger.centre_mm, centre) / deflection_mm(spec, pressing)
        turned = abs(finger.facing_rad - facing) / deflection_rad(spec, pressing)
        sheared = abs(float(finger.press.angle[0])) / shear_rad(spec.tip, pressing)
        largest = np.maximum(largest, [bent, turned, sheared])
    return largest


@settings(max_examples=8, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(
    st.floats(0.0, TIP_FRICTION),
    st.integers(0, 10**6),
    st.lists(st.tuples(st.floats(-0.4, 0.4), st.floats(0.0, 0.4)), min_size=2, max_size=4),
)
def test_no_tip_is_bent_or_sheared_further_than_its_rule_says(
    friction: float, seed: int, way: list[tuple[float, float]]
) -> None:
    assert shares(friction, seed, way).max() <= 1.0


def test_the_rule_allows_hardly_more_than_there_is() -> None:
    found = np.max([shares(TIP_FRICTION, seed, [(0.0, 0.3), (0.8, 0.3)]) for seed in range(4)], axis=0)
    assert found[0] > 0.5, "bent"
    assert found[1] > 0.3, "turned"
    assert found[2] > 0.8, "sheared"
