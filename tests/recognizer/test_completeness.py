"""Completeness: the truth is never lost, whatever the errors within their bounds."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import LEAST_BUDGET
from palpate.recognizer import (
    STANDARD_BUDGET,
    Budget,
    Catalogue,
    Motion,
    Recognition,
    contact_after_motion,
    contact_in_motion,
    recognise,
)
from palpate.recognizer.contact import Contact
from support.campaign.sampling import sample
from support.commands.repository import SHARED_OUTLINES, needs_shared_outlines
from support.oracles.shapely_touches import (
    MOST_DRAWS,
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
    touch,
    turned,
    unit,
    until_touched,
)

# ----------------------------------------------------------------------------------------------------
# The recogniser's promise: the truth is never lost while every error is within its bound.
#
# Touches are simulated by shapely. Every seed is fixed, so a failure names a case that can be run again.

RADII = (0.0, 1.0, 5.0, 8.0)
BOUNDS = (0.0, 0.01, 0.3, 1.0)
NORMALS = (math.radians(1), math.radians(10), math.radians(45))


@cache
def shipped() -> Catalogue:
    return Catalogue(outlines(SHIPPED_OBJECTS))


def assert_kept(found: Recognition, placed: Placed, note: object) -> None:
    assert holding_truth(found, placed) is not None, (placed.model.name, placed.theta, note)


@pytest.mark.parametrize("seed", sample(range(24), range(8)))
def test_shipped_models(seed: int) -> None:
    rng = np.random.default_rng(seed)
    models = outlines(SHIPPED_OBJECTS)
    for trial in range(8):
        radius, bound = RADII[rng.integers(4)], BOUNDS[rng.integers(4)]
        half, fingers = NORMALS[rng.integers(3)], int(rng.integers(2, 7))
        placed = place(models[(seed + trial) % 6], rng)
        contacts = until_touched(
            grip,
            placed,
            rng,
            fingers=fingers,
            radius=radius,
            bound=bound,
            half_range=half,
            at_bound=bool(trial % 2),
        )
        assert_kept(recognise(shipped(), contacts), placed, (seed, trial, radius, bound, half))


@pytest.mark.parametrize("theta", [math.pi, -math.pi, math.pi - 1e-4, -math.pi + 1e-4, 0.0, math.pi / 2])
def test_across_the_cut(theta: float) -> None:
    rng = np.random.default_rng(8)
    for model in outlines(SHIPPED_OBJECTS):
        placed = replace(place(model, rng), theta=theta)
        contacts = grip(placed, rng, fingers=4, at_bound=True)
        assert_kept(recognise(shipped(), contacts), placed, theta)


@pytest.mark.parametrize("seed", range(10))
def test_grip_after_grip(seed: int) -> None:
    """Extending keeps the truth and never knows less about it than the grips did before."""
    rng = np.random.default_rng(200 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)
    first = until_touched(grip, placed, rng, fingers=2 + seed % 2)
    further = [grip(placed, rng, fingers=2 + seed % 2, at_bound=bool(k % 2)) for k in (1, 2)]
    grips = [
        [replace(contact, name=f"{contact.name}.{k}") for contact in drawn]
        for k, drawn in enumerate([first, *further])
    ]
    found = recognise(shipped(), grips[0])
    assert_kept(found, placed, 0)
    for k in (1, 2):
        found = found.extend(grips[k])
        assert_kept(found, placed, k)
        assert found.contacts == tuple(contact for part in grips[: k + 1] for contact in part)
    at_once = recognise(shipped(), [contact for part in grips for contact in part])
    assert_kept(at_once, placed, "at once")
    stepwise = {(item.state_index) for item in found.hypotheses}
    for item in at_once.hypotheses:
        if item.verified:  # what satisfies all contacts exactly cannot have been lost on the way
            assert item.state_index in stepwise


@pytest.mark.parametrize("seed", range(8))
def test_misses_are_evidence(seed: int) -> None:
    rng = np.random.default_rng(300 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)
    contacts = until_touched(grip, placed, rng, fingers=3)
    misses: list[Contact] = []
    for _ in range(MOST_DRAWS):
        at = rng.uniform(0, 2 * math.pi)
        start = 140 * np.array([math.cos(at), math.sin(at)])
        aim = at + math.pi + rng.choice([-1, 1]) * rng.uniform(0.2, 0.5)
        tried = touch(
            placed.shape, rng, radius=5.0, bound=0.3, half_range=None, direction=aim, start=start, reach=280.0
        )
        if not tried.touched:
            misses.append(replace(tried, name=f"m{len(misses)}"))
        if len(misses) == 3:
            break
    assert len(misses) == 3
    without, found = recognise(shipped(), contacts), recognise(shipped(), [misses[0], *contacts, *misses[1:]])
    assert_kept(without, placed, seed)
    assert_kept(found, placed, seed)
    assert found.cells.volume.sum() <= without.cells.volume.sum() * (1 + 1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_fingers_of_different_radii(seed: int) -> None:
    rng = np.random.default_rng(400 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)

    def draw() -> list[Contact]:
        grips = [grip(placed, rng, fingers=4, radius=radius, bound=0.2, at_bound=True) for radius in RADII]
        return [contacts[k] for k, contacts in enumerate(grips)]

    assert_kept(recognise(shipped(), until_touched(draw)), placed, seed)


def test_a_finger_above_the_object_touches_nothing_of_it() -> None:
    rng = np.random.default_rng(9)
    low, high = (
        flat("low", [(-25, -15), (25, -15), (25, 15)], 12.0),
        flat("high", [(-25, -15), (25, -15), (25, 15)]),
    )
    placed = Placed(high, 0.0, 0.0, 0.4)
    contacts = [replace(c, finger=replace(c.finger, height_mm=15.0)) for c in grip(placed, rng)]
    found = recognise(Catalogue([low, high]), contacts)
    assert {item.state.object_name for item in found.hypotheses} == {"high"}


@pytest.mark.parametrize("seed", range(10))
def test_start_points_inside_the_convex_hull(seed: int) -> None:
    """A finger that comes down in the mouth of a U and moves outwards feels the mouth's own walls."""
    rng = np.random.default_rng(600 + seed)
    mouth = flat(
        "mouth", [(-40, -30), (40, -30), (40, 30), (24, 30), (24, -10), (-22, -14), (-22, 30), (-40, 30)]
    )
    placed = place(mouth, rng)
    catalogue = Catalogue([*outlines(SHIPPED_OBJECTS), mouth])

    def outwards() -> list[Contact]:
        return [
            touch(
                placed.shape,
                rng,
                radius=5.0,
                bound=0.3,
                half_range=math.radians(10),
                direction=float(direction),
                start=placed.on_table(np.array([1.0, 8.0])),
                reach=150.0,
                at_bound=bool(seed % 2),
                name=f"f{k}",
            )
            for k, direction in enumerate(rng.uniform(-math.pi, math.pi, 4))
        ]

    assert_kept(recognise(catalogue, until_touched(outwards)), placed, seed)


@pytest.mark.parametrize("seed", range(40))
def test_corners_of_a_notch_without_error(seed: int) -> None:
    """A disc that rests on both lips of a notch narrower than itself, or next to it, measured exactly."""
    rng = np.random.default_rng(700 + seed)
    notched = flat("notched", [(0, 0), (60, 0), (60, 30), (34, 30), (30, 12), (25, 30), (0, 30)])
    placed = place(notched, rng)
    into = np.array([29.5 + rng.uniform(-0.3, 0.3), 90.0])
    contacts = [
        touch(
            placed.shape,
            rng,
            radius=5.0,
            bound=0.0,
            half_range=math.radians(1),
            direction=placed.theta + angle,
            start=placed.on_table(point),
            reach=300.0,
            name=f"f{k}",
        )
        for k, (angle, point) in enumerate(
            [
                (-math.pi / 2, into),
                (0.0, np.array([-90.0, 15.0 + rng.uniform(-9, 9)])),
                (math.pi / 2, np.array([30 + rng.uniform(-20, 20), -90.0])),
            ]
        )
    ]
    assert_kept(recognise(Catalogue([notched]), contacts), placed, seed)


# ----------------------------------------------------------------------------------------------------
# A part that moves between grips, or within one, by no more than its bound is never lost.

MOTIONS = ((0.0, 0.02), (0.1, 0.005), (0.4, 0.03), (1.5, 0.0))
"""Shift in mm and turn in rad."""


def by_at_most(catalogue: Catalogue, shift_mm: float, turn_rad: float) -> Motion:
    count = len(catalogue.states)
    return Motion(np.full(count, shift_mm), np.full(count, turn_rad))


def state_of(catalogue: Catalogue, placed: Placed) -> int:
    return [item.object_name for item in catalogue.states].index(placed.model.name)


def pushed(placed: Placed, centre: np.ndarray, shift_mm: float, turn_rad: float, bearing: float) -> Placed:
    """The part turned about its centroid, which is shifted."""
    at = placed.on_table(centre) + shift_mm * unit(bearing)
    theta = placed.theta + turn_rad
    x, y = at - turned(centre, theta)
    return replace(placed, x=float(x), y=float(y), theta=theta)


def pushed_by(catalogue: Catalogue, placed: Placed, motion: Motion, rng: np.random.Generator) -> Placed:
    """The part after a motion: at its bound in both ways most of the time, in any direction."""
    row = state_of(catalogue, placed)
    share, turn = (1.0, rng.choice([-1.0, 1.0])) if rng.random() < 0.7 else (rng.random(), rng.uniform(-1, 1))
    return pushed(
        placed,
        catalogue.origins_mm[row],
        share * float(motion.shift_mm[row]),
        turn * float(motion.turn_rad[row]),
        rng.uniform(0, 2 * math.pi),
    )


def assert_followed(
    catalogue: Catalogue, model: ObjectModel, rng: np.random.Generator, note: object, **how: object
) -> None:
    """Three grips with a motion before each but the first: the part is where the bounds say, every time."""
    motion = by_at_most(catalogue, *MOTIONS[rng.integers(len(MOTIONS))])
    placed = place(model, rng)

    def draw(where: Placed) -> list[Contact]:
        return grip(where, rng, **how)  # type: ignore[arg-type]

    found = recognise(catalogue, until_touched(draw, placed))
    for number in range(2):
        placed = pushed_by(catalogue, placed, motion, rng)
        moved = found.move(motion)
        assert holding_truth(moved, placed) is not None, (note, number, "moved")
        further, states = draw(placed), np.unique(found.interpretations.state)
        back = [contact_after_motion(motion, catalogue, item, states) for item in further]
        assert found.allows(back), (note, number, "seen from where it was")
        found = found.extend(further, motion)
        assert holding_truth(found, placed) is not None, (note, number)


@pytest.mark.parametrize("seed", sample(range(20), [0, 8]))
def test_shipped_parts_that_move_between_grips(seed: int) -> None:
    rng = np.random.default_rng([20, seed])
    models = outlines(SHIPPED_OBJECTS)
    for trial in range(4):
        half = (None, math.radians(2), math.radians(10), math.radians(30))[int(rng.integers(4))]
        fingers = 4 if half is None else int(rng.integers(2, 5))
        assert_followed(
            shipped(),
            models[int(rng.integers(len(models)))],
            rng,
            (seed, trial),
            fingers=fingers,
            radius=float(rng.choice([0.0, 2.0, 5.0])) if half is None else 5.0,
            bound=float(rng.choice([0.0, 0.05, 0.3])),
            half_range=half,
            at_bound=bool(trial % 2),
            aim=0.3,
        )


@needs_shared_outlines
@pytest.mark.parametrize("seed", sample(range(6), [1, 4]))
def test_cut_parts_that_move_between_grips(seed: int) -> None:
    models = outlines(SHARED_OUTLINES)
    catalogue = Catalogue(models)
    rng = np.random.default_rng([21, seed])
    for trial in range(6):
        model = models[int(rng.integers(len(models)))]
        assert_followed(catalogue, model, rng, (seed, trial), fingers=3, bound=0.2, at_bound=bool(trial % 2))


@pytest.mark.parametrize("seed", sample(range(20), range(0, 20, 4)))
def test_free_ways_of_a_part_that_moved_while_fingers_travelled(seed: int) -> None:
    """Half of the fingers go past, or up to, the part before it is pushed; the others meet it afterwards."""
    rng = np.random.default_rng([22, seed])
    models = outlines(SHIPPED_OBJECTS)
    motion = by_at_most(shipped(), 1.0, 0.02)
    for trial in range(6):
        before = place(models[int(rng.integers(len(models)))], rng)
        after = pushed_by(shipped(), before, motion, rng)
        for _ in range(MOST_DRAWS):
            contacts = [item for item in grip(after, rng, fingers=4, aim=0.1) if item.touched]
            misses = [item for item in grip(before, rng, fingers=6, aim=0.6) if not item.touched]
            if len(contacts) >= 2 and misses:
                break
        felt = [contact_in_motion(motion, shipped(), item, np.arange(6)) for item in (*misses, *contacts)]
        assert holding_truth(recognise(shipped(), felt), after) is not None, (seed, trial)


def test_contacts_that_no_edge_is_near_are_not_allowed() -> None:
    rng = np.random.default_rng(25)
    placed = place(outlines(SHIPPED_OBJECTS)[1], rng)
    found = recognise(shipped(), until_touched(grip, placed, rng))
    elsewhere = [item for item in grip(replace(placed, x=placed.x + 90.0), rng) if item.touched]
    assert elsewhere
    assert not found.allows(elsewhere)


def test_without_motion_nothing_changes() -> None:
    rng = np.random.default_rng(23)
    placed = place(outlines(SHIPPED_OBJECTS)[2], rng)
    still = Motion.none(shipped())
    found = recognise(shipped(), until_touched(grip, placed, rng))
    further = grip(placed, rng)
    assert found.move(still) is found
    one, other = found.extend(further, still), found.extend(further)
    assert [item.bounds for item in one.hypotheses] == [item.bounds for item in other.hypotheses]
    assert np.array_equal(one.cells.polygon, other.cells.polygon)
    assert contact_in_motion(still, shipped(), further[0], np.arange(6)) is further[0]


def test_a_carried_contact_holds_at_the_bound_of_the_motion() -> None:
    """The farthest corner of a part that is shifted and turned by just its bounds is within the new bound."""
    corner = flat("corner", [(-30, -10), (30, -10), (30, 10), (-30, 10)])
    catalogue = Catalogue([corner])
    contact = Contact(
        "f", grip(Placed(corner, 0, 0, 0), np.random.default_rng(0))[0].finger, True, (140, 20), (35, 10), 0.0
    )
    motion = by_at_most(catalogue, 0.3, 0.01)
    carried = contact_after_motion(motion, catalogue, contact, np.array([0]))
    moved = turned(np.array(contact.end_mm), 0.01) + 0.3 * unit(math.atan2(36.4, -10))
    assert 0.3 < math.dist(moved, contact.end_mm) <= carried.position_bound_mm < 0.3 + 0.01 * 37
    assert carried.turn_bound_rad == 0.01
    twice = contact_after_motion(motion + motion, catalogue, contact, np.array([0]))
    assert twice.position_bound_mm == pytest.approx(2 * carried.position_bound_mm)


# ----------------------------------------------------------------------------------------------------
# Contacts that would only multiply interpretations are not paired; the truth stays, and they still count.

SMALL = Budget(50_000)
"""Suffices for 100 interpretations of a further contact, if these are more than there were."""


def round_part(seed: int) -> tuple[Catalogue, Placed, list[Contact]]:
    """A coin of many facets, and eight touches of it."""
    rng = np.random.default_rng([31, seed])
    angle = np.arange(40) * 2 * math.pi / 40
    model = replace(flat("coin", 18.0 * np.column_stack([np.cos(angle), np.sin(angle)])), tolerance_mm=0.1)
    placed = place(model, rng)
    contacts = [
        contact
        for _ in range(4)
        for contact in grip(placed, rng, fingers=2, bound=0.3, half_range=0.2, aim=0.05, at_bound=True)
        if contact.touched
    ]
    return Catalogue([model]), placed, contacts


def in_steps(catalogue: Catalogue, contacts: list[Contact], budget: Budget = STANDARD_BUDGET) -> Recognition:
    found = recognise(catalogue, contacts[:3], budget=budget)
    for contact in contacts[3:]:
        found = found.extend([contact])
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_round_part_keeps_its_truth_however_often_it_is_touched(seed: int) -> None:
    catalogue, placed, contacts = round_part(seed)
    found = in_steps(catalogue, contacts, SMALL)
    assert found.unpaired
    assert found.interpretations.edges.shape[1] == len(contacts) - len(found.unpaired)
    assert len(found.levels) == len(contacts) - len(found.unpaired)
    item = holding_truth(found, placed)
    assert item is not None
    assert item.verified
    at_once = recognise(catalogue, contacts)
    assert holding_truth(at_once, placed) is not None


def test_touches_of_one_part_do_not_multiply_its_interpretations() -> None:
    catalogue, placed, contacts = round_part(2)
    begun, found = recognise(catalogue, contacts[:3]), in_steps(catalogue, contacts)
    assert len(found.constraints.nodes) <= max(len(begun.constraints.nodes), STANDARD_BUDGET.worthwhile)
    assert STANDARD_BUDGET.worthwhile < 500
    assert holding_truth(found, placed) is not None


@pytest.mark.parametrize("seed", sample(range(12), range(4)))
def test_without_pairings_nothing_is_left_out_that_is_there_with_them(seed: int) -> None:
    rng = np.random.default_rng([32, seed])
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed % 6], rng)
    contacts = [c for c in grip(placed, rng, fingers=6, bound=0.5, half_range=0.3, aim=0.3) if c.touched]
    catalogue = Catalogue(models)
    paired = in_steps(catalogue, contacts)
    loose = in_steps(catalogue, contacts, Budget(LEAST_BUDGET))
    assert holding_truth(loose, placed) is not None
    for item in paired.hypotheses:
        if item.verified:
            assert any(
                other.state_index == item.state_index
                and other.bounds.x_mm[0] <= item.configuration.x_mm <= other.bounds.x_mm[1]
                and other.bounds.y_mm[0] <= item.configuration.y_mm <= other.bounds.y_mm[1]
                for other in loose.hypotheses
            )


def test_an_unpaired_contact_rules_out_what_does_not_satisfy_it() -> None:
    catalogue, _, contacts = round_part(0)
    found = in_steps(catalogue, contacts, SMALL)
    last = contacts[-1]
    away = (
        last.end_mm[0] + 30.0 * math.cos(last.direction_rad),
        last.end_mm[1] + 30.0 * math.sin(last.direction_rad),
    )
    assert not found.extend([replace(last, end_mm=away)]).hypotheses


@pytest.mark.parametrize("seed", range(2))
def test_an_unpaired_contact_rules_out_interpretations_that_have_no_edge_for_it(seed: int) -> None:
    angle = np.arange(40) * 2 * math.pi / 40
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    models = [replace(flat(f"coin {r}", r * ring), tolerance_mm=0.1) for r in (18.0, 19.0)]
    rng = np.random.default_rng([33, seed])
    placed = place(models[0], rng)
    vague = grip(placed, rng, bound=1.0, half_range=0.2, aim=0.05)
    sharp = grip(placed, rng, bound=0.02, half_range=0.2, aim=0.05)
    before = recognise(Catalogue(models), vague, budget=SMALL)
    found = recognise(Catalogue(models), [*vague, *sharp], budget=SMALL)
    assert found.unpaired == {3, 4, 5}
    assert len(found.constraints.nodes) < len(before.constraints.nodes)
    assert holding_truth(found, placed) is not None


def test_a_motion_widens_unpaired_contacts_too() -> None:
    catalogue, placed, contacts = round_part(1)
    found = in_steps(catalogue, contacts, SMALL)
    motion = Motion(np.array([0.2]), np.array([0.01]))
    moved = found.move(motion)
    assert moved.unpaired == found.unpaired
    assert holding_truth(moved, placed) is not None


# ----------------------------------------------------------------------------------------------------
# States are listed before hypotheses are worked out; none is left out that turns out to have one.


@pytest.mark.parametrize("seed", sample(range(60), range(8)))
def test_every_hypothesis_is_of_a_possible_state(seed: int) -> None:
    rng = np.random.default_rng([71, seed])
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed % len(models)], rng)
    fingers = 2 + seed % 3
    contacts = grip(placed, rng, fingers=fingers, bound=0.3, half_range=math.radians(15))
    assert any(contact.touched for contact in contacts)
    found = recognise(Catalogue(models), contacts)
    possible = {item.state.object_name: item.interpretations for item in found.possible_states}
    assert "hypotheses" not in vars(found)
    assert placed.model.name in possible
    assert {item.state.object_name for item in found.hypotheses} <= set(possible)
    assert list(possible.values()) == sorted(possible.values(), reverse=True)
    assert sum(possible.values()) == len(found.constraints.nodes)
