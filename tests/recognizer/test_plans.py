"""Plans: sweep, strategy, decisive grips."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from palpate.base.geometry import Floats, Ints, ObjectModel
from palpate.base.vocabulary import Strategy
from palpate.recognizer import (
    Confirmation,
    Grip,
    Recognition,
    Resolution,
    StrangerEvidence,
    confirmation_grip,
    detectable_shift_mm,
    heuristic_grip,
    plan_grip,
    predict,
    recognise,
    twins,
    used_approaches,
)
from palpate.recognizer.approach import Approach, EdgeCapsules, capsules_of, rays_of
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger
from palpate.recognizer.interpretations import Query
from palpate.recognizer.planner import fits_together, predict_approach
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.steps import STEPS
from palpate.recognizer.touch_model import (
    push_hazard,
    sampled_poses,
    similarity,
    touch_outcomes,
    witness_poses,
)
from support.campaign.sampling import sample
from support.commands.repository import SHARED_OUTLINES, needs_shared_outlines
from support.oracles.decisive_grips import checked, drawn, poses_in
from support.oracles.outlines import exact_pockets, hold
from support.oracles.plans import (
    FINGER,
    GOALS,
    RESOLUTION,
    Ring,
    contact_along,
    model_of,
    normal_at,
    ring,
    some_recognition,
    travel_of,
)
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    outlines,
    place,
    stop,
    unit,
    until_touched,
)

# ----------------------------------------------------------------------------------------------------
# Stops over whole cells against touches simulated one configuration at a time.

MODELS = outlines(SHIPPED_OBJECTS)
CATALOGUE = Catalogue(MODELS)
ORIGIN = np.zeros(2)
SQUARE = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])


def sweep(catalogue: Catalogue, cells: Cells, path: Approach) -> EdgeCapsules:
    edges = catalogue.outlines(path.finger)
    rays = rays_of(edges, cells, ORIGIN, [path])
    return capsules_of(edges, catalogue.outline_strips(path.finger), rays)


def cell(state: int, theta: float, width: float, centre: tuple[float, float], size: float) -> Cells:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size + centre
    one = np.zeros(1, dtype=np.int64)
    return Cells(one, one + state, np.array([theta]), np.array([theta + width]), corners[None])


def shape_at(model: ObjectModel, origin: np.ndarray, theta: float, position: np.ndarray) -> shapely.Geometry:
    """The outline of an object whose centroid is at R(θ)·position."""
    outline = shapely.Polygon(model.states[0].sections[0].polygons[0].outer)
    moved = affinity.translate(outline, *(position - origin))
    return affinity.rotate(moved, theta, origin=(0, 0), use_radians=True)


@settings(max_examples=60)
@given(
    st.integers(0, 5),
    st.floats(-4, 4),
    st.sampled_from([0.0, 0.002, 0.02, 0.1]),
    st.tuples(st.floats(-10, 10), st.floats(-10, 10)),
    st.sampled_from([0.0, 0.3, 2.0]),
    st.sampled_from([0.0, 1.0, 5.0]),
    st.sampled_from([0.0, 0.5]),
    st.floats(-math.pi, math.pi),
    st.floats(-25, 25),
    st.integers(0, 2**32 - 1),
)
def test_interval_encloses_simulated_stops(
    state: int,
    theta: float,
    width: float,
    centre: tuple[float, float],
    size: float,
    radius: float,
    bound: float,
    direction: float,
    offset: float,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    cells = cell(state, theta, width, centre, size)
    heading = np.array([math.cos(direction), math.sin(direction)])
    start = -150 * heading + offset * np.array([-heading[1], heading[0]])
    path = Approach(Finger(radius, 10.0), (float(start[0]), float(start[1])), direction, 300.0, bound)
    found = sweep(CATALOGUE, cells, path)
    for _ in range(6):
        t = theta + width * rng.choice([0.0, 1.0, rng.uniform()])
        s = np.array(centre) + size * rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], 2)
        angle = rng.uniform(0, 2 * math.pi)
        error = bound * np.array([math.cos(angle), math.sin(angle)])
        shape = shape_at(MODELS[state], CATALOGUE.states[state].origin_mm, t, s)
        travel = stop(shape, start + error, direction, radius, 300.0)
        assert travel >= found.earliest[0] - 1e-6
        # A ray that just grazes may pass in the simulation; inside the enclosure it is allowed to miss.
        assert travel <= found.latest[0] + 1e-6


def test_one_configuration_is_predicted_sharply() -> None:
    cells = cell(0, 0.0, 0.0, (0.0, 0.0), 0.0)
    path = Approach(Finger(0.0, 10.0), (-100.0, 3.0), 0.0, 200.0, 0.0)
    found = sweep(Catalogue([SQUARE]), cells, path)
    assert found.earliest[0] == pytest.approx(80.0, abs=0.01)
    assert found.latest[0] == pytest.approx(80.0, abs=0.01)


@pytest.mark.parametrize("turn", [k * math.pi / 4 for k in range(8)])
@pytest.mark.parametrize("offset", [-20.0, 0.0, 20.0, 28.284271247461902, -28.284271247461902])
def test_rays_through_corners_and_along_edges(turn: float, offset: float) -> None:
    """Behind the object the ray is outside again, whichever corners it went through."""
    catalogue = Catalogue([SQUARE])
    cells = cell(0, 0.0, 0.0, (0.0, 0.0), 0.0)
    heading = np.array([math.cos(turn), math.sin(turn)])
    start = 100 * heading + offset * np.array([-heading[1], heading[0]])
    path = Approach(Finger(0.0, 10.0), (float(start[0]), float(start[1])), turn, 200.0, 0.0)
    found = sweep(catalogue, cells, path)
    assert math.isinf(found.latest[0])
    assert math.isinf(found.earliest[0])


@pytest.mark.parametrize("model", range(6))
def test_rays_through_every_corner_never_end_inside(model: int) -> None:
    """A ray from beyond the object, pointing away through a vertex behind it, meets nothing."""
    catalogue = Catalogue(MODELS[model : model + 1])
    edges = catalogue.edges(Finger(5.0, 10.0))
    cells = cell(0, 0.0, 0.0, (0.0, 0.0), 0.0)
    for begin, end in zip(edges.start, edges.end, strict=True):
        for through, heading in (
            (begin, (end - begin) / np.linalg.norm(end - begin)),
            (begin, np.array([0.6, 0.8])),
        ):
            start = through + 400 * heading
            direction = math.atan2(heading[1], heading[0])
            path = Approach(Finger(5.0, 10.0), (float(start[0]), float(start[1])), direction, 100.0, 0.0)
            assert math.isinf(sweep(catalogue, cells, path).latest[0])


def test_blocked_only_if_blocked_everywhere() -> None:
    catalogue = Catalogue([SQUARE])
    through = Contact("f", Finger(5.0, 10.0), False, (-100.0, 0.0), (100.0, 0.0), 0.3)
    beside = Contact("f", Finger(5.0, 10.0), False, (-100.0, 26.0), (100.0, 26.0), 0.3)
    sharp = cell(0, 0.0, 0.0, (0.0, 0.0), 0.1)
    wide = cell(0, 0.0, 0.0, (0.0, 0.0), 30.0)
    assert not STEPS.free_cells(Query(catalogue, [through], ORIGIN), sharp, None)[0]
    assert STEPS.free_cells(Query(catalogue, [through], ORIGIN), wide, None)[0]
    assert STEPS.free_cells(Query(catalogue, [beside], ORIGIN), sharp, None)[0]


@given(
    st.lists(
        st.tuples(st.integers(0, 5), st.floats(-20, 20), st.floats(0, 2 * math.pi)), min_size=1, max_size=5
    )
)
def test_by_normal_is_a_scan(queries: list[tuple[int, float, float]]) -> None:
    edges = CATALOGUE.edges(Finger(1.0, 10.0))
    state, lo, width = (np.array(column) for column in zip(*queries, strict=True))
    owner, edge = edges.by_normal(state.astype(np.int64), lo, width)
    found = set(zip(owner.tolist(), edge.tolist(), strict=True))
    assert len(found) == len(owner)
    for query in range(len(queries)):
        past = (edges.normal_rad - lo[query]) % (2 * math.pi)
        same = edges.state == state[query]
        certain = same & (past > 1e-9) & (past < width[query] - 1e-9)
        possible = same & ((past <= width[query] + 1e-9) | (past >= 2 * math.pi - 1e-9))
        got = {e for o, e in found if o == query}
        assert set(np.flatnonzero(certain).tolist()) <= got <= set(np.flatnonzero(possible).tolist())


# ----------------------------------------------------------------------------------------------------
# Predictions and plans against touches simulated by shapely.

L_SHAPE = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 40), (0, 40)]


@pytest.mark.parametrize("seed", range(8))
def test_predictions_enclose_simulated_stops_and_normals(seed: int) -> None:
    rng = np.random.default_rng(seed)
    models, found = some_recognition(seed)
    assert found.hypotheses
    approaches = [ring().approaches[k] for k in rng.integers(0, 72, 6)]
    predictions = predict(found.catalogue, found.hypotheses, found.anchor_mm, approaches)
    stopped = 0
    for number, item in enumerate(found.hypotheses):
        for pose in poses_in(found, item, model_of(models, item), rng, 8):
            for row, approach in enumerate(approaches):
                foretold = predictions.of(row, number)
                travel = travel_of(pose, approach)
                assert foretold.earliest_mm - 1e-6 <= travel <= foretold.latest_mm + 1e-6
                if math.isfinite(travel):
                    stopped += 1
                    assert travel <= foretold.furthest_mm + 1e-6
                    assert foretold.normal_rad is not None
                    lo, hi = foretold.normal_rad
                    past = (normal_at(pose, approach, travel) - lo + 1e-4) % (2 * math.pi)
                    assert past <= hi - lo + 2e-4
    assert stopped > 20


def test_a_prediction_that_ends_is_in_the_exact_pockets_of_its_edge() -> None:
    """Where one edge must be met, the approach is in the exact pocket of the point met (memo §3.2)."""
    checked = 0
    for seed in range(12):
        models, found = some_recognition(seed)
        edges = found.catalogue.outlines(FINGER)
        for number, item in enumerate(found.hypotheses):
            own = item.configuration
            pose = Placed(model_of(models, item), own.x_mm, own.y_mm, own.theta_rad)
            for approach in ring(12).approaches:
                foretold = predict(found.catalogue, found.hypotheses, found.anchor_mm, [approach]).of(
                    0, number
                )
                if foretold.latest_mm - foretold.earliest_mm > 4.0:
                    continue
                travel = travel_of(pose, approach)
                centre = np.asarray(approach.start_mm) + travel * np.array(
                    [math.cos(approach.direction_rad), math.sin(approach.direction_rad)]
                )
                turn = np.array(
                    [
                        [math.cos(own.theta_rad), math.sin(own.theta_rad)],
                        [-math.sin(own.theta_rad), math.cos(own.theta_rad)],
                    ]
                )
                seen = turn @ (centre - [own.x_mm, own.y_mm]) - item.state.origin_mm
                block = np.arange(edges.first[item.state_index], edges.first[item.state_index + 1])
                gap = np.abs(np.sum((seen - edges.start[block]) * edges.normal[block], axis=1))
                along = np.sum((seen - edges.start[block]) * edges.direction[block], axis=1)
                on = block[(gap < 0.15) & (along > 0.5) & (along < edges.length[block] - 0.5)]
                if len(on) != 1:
                    continue
                pockets = exact_pockets(edges, on, seen[None], 0.0)
                heading = approach.direction_rad - own.theta_rad
                assert hold(pockets, np.array([0]), np.array([heading])).all()
                checked += 1
    assert checked > 50


def test_felt_agrees_with_simulated_stops() -> None:
    rng = np.random.default_rng(3)
    models, found = some_recognition(2, half_deg=40.0)
    approaches = ring().approaches
    outcome = touch_outcomes(
        found.catalogue, witness_poses(found.hypotheses).cells, found.anchor_mm, approaches
    )
    hits = 0
    for number, item in list(enumerate(found.hypotheses))[:5]:
        own = item.configuration
        pose = Placed(model_of(models, item), own.x_mm, own.y_mm, own.theta_rad)
        for row in rng.integers(0, len(approaches), 25):
            travel = travel_of(pose, approaches[row])
            margin = abs(float(outcome.margin[row, number]))
            if margin < 1.0:
                continue  # a graze: facets decide whether it hits
            assert outcome.hit[row, number] == math.isfinite(travel)
            if math.isfinite(travel):
                hits += 1
                assert outcome.travel[row, number] == pytest.approx(travel, abs=1.0)
    assert hits > 10


def test_likeness_is_one_for_equal_poses_and_small_for_perceptible_ones() -> None:
    _, found = some_recognition(1, half_deg=40.0)
    poses = witness_poses(found.hypotheses)
    approaches = ring().approaches
    outcome = touch_outcomes(found.catalogue, poses.cells, found.anchor_mm, approaches)
    rows = np.arange(len(approaches))
    same = np.arange(len(found.hypotheses))
    assert np.all(similarity(outcome, same, same, RESOLUTION, rows) == 1.0)
    first, second = np.triu_indices(len(same), 1)
    alike = similarity(outcome, first, second, RESOLUTION, rows)
    both = outcome.hit[:, first] & outcome.hit[:, second]
    clear = np.minimum(outcome.facing[:, first], outcome.facing[:, second]) * np.abs(
        outcome.travel[:, first] - outcome.travel[:, second]
    )
    assert np.all(alike[both & (clear > RESOLUTION.distance_mm)] < math.exp(-1))
    assert np.any(both & (clear > RESOLUTION.distance_mm))


def test_a_plan_promises_what_its_predictions_say() -> None:
    decisive = planned = 0
    for seed in range(30):
        _, found = some_recognition(seed, half_deg=20.0)
        chosen = plan_grip(found, ring(), RESOLUTION, GOALS)
        if chosen is None or len(found.hypotheses) < 2:
            continue
        planned += 1
        assert 0.0 <= chosen.remaining <= 1.0
        fingers = [item.finger_index for item in chosen.approaches]
        assert len(set(fingers)) == len(fingers) <= 3
        for row, (candidate, travel) in enumerate(zip(chosen.approaches, chosen.travels_mm, strict=True)):
            furthest = max(item.furthest_mm for item in chosen.predictions.of_approach(row))
            assert min(furthest, candidate.travel_mm) <= travel <= candidate.travel_mm
        apart = chosen.predictions.apart(RESOLUTION.normal_half_rad)
        np.fill_diagonal(apart, val=True)
        assert chosen.decisive == bool((apart | twins(found, ring(), RESOLUTION)).all())
        decisive += chosen.decisive
    assert planned >= 15
    assert 5 <= decisive < planned


def test_where_contacts_may_be_spurious_nothing_is_decisive() -> None:
    rng = np.random.default_rng(3)
    models = outlines(SHIPPED_OBJECTS)
    contacts = grip(place(models[0], rng), rng, fingers=5)
    found = recognise(Catalogue(models), contacts, max_spurious=1)
    chosen = plan_grip(found, ring(), RESOLUTION, GOALS)
    assert chosen is not None
    assert not chosen.decisive


def hypotheses_for(models: list[ObjectModel], placed: Placed) -> Recognition:
    return recognise(Catalogue(models), grip(placed, np.random.default_rng(4), fingers=4, bound=0.1))


def all_twins(found: Recognition, reachable: Ring) -> bool:
    return bool(twins(found, reachable, RESOLUTION).all())


def test_exact_twins_cannot_be_told_apart() -> None:
    models = [flat("one", L_SHAPE), flat("other", L_SHAPE)]
    found = hypotheses_for(models, Placed(models[0], 3.0, 4.0, 0.7))
    assert {item.state.object_name for item in found.hypotheses} == {"one", "other"}
    assert all_twins(found, ring())


def test_a_grip_that_leaves_only_twins_is_decisive() -> None:
    """One class is left whatever happens, though two objects are."""
    models = [flat("one", L_SHAPE), flat("other", L_SHAPE)]
    decisive = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        placed = Placed(models[0], 0.0, 0.0, rng.uniform(-3.0, 3.0))
        found = recognise(Catalogue(models), grip(placed, rng, half_range=math.radians(25)))
        chosen = plan_grip(found, ring(), RESOLUTION, GOALS)
        if chosen is None or all_twins(found, ring()):
            continue
        apart = chosen.predictions.apart(RESOLUTION.normal_half_rad)
        np.fill_diagonal(apart, val=True)
        assert not apart.all()
        assert chosen.decisive == bool((apart | twins(found, ring(), RESOLUTION)).all())
        decisive += chosen.decisive
    assert decisive >= 2


def test_a_twin_turned_in_its_file_is_still_a_twin() -> None:
    outline = np.array(L_SHAPE, dtype=float) @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + (100.0, -30.0)
    models = [flat("one", L_SHAPE), flat("other", outline)]
    found = hypotheses_for(models, Placed(models[0], 3.0, 4.0, 0.7))
    assert {item.state.object_name for item in found.hypotheses} == {"one", "other"}
    assert all_twins(found, ring())


def test_a_symmetric_copy_is_one_hypothesis() -> None:
    square = flat("square", [(0, 0), (40, 0), (40, 40), (0, 40)])
    found = hypotheses_for([square], Placed(square, -20.0, -20.0, 0.0))
    assert len(found.hypotheses) == 1
    assert found.hypotheses[0].state.symmetry_order == 4
    assert all_twins(found, ring())


def test_a_longer_brother_can_be_told_apart_until_all_approaches_are_used() -> None:
    longer = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 46), (0, 46)]
    models = [flat("one", L_SHAPE), flat("longer", longer)]
    placed = Placed(models[0], 0.0, 0.0, 0.0)
    rng = np.random.default_rng(1)
    contacts = [replace(c, normal=None) for c in grip(placed, rng, fingers=2, bound=0.5, half_range=None)]
    found = recognise(Catalogue(models), [contact for contact in contacts if contact.touched])
    assert len(found.hypotheses) > 1
    assert not all_twins(found, ring())
    every = np.ones(len(ring().approaches), dtype=bool)
    assert twins(found, ring(), RESOLUTION, every).all()
    assert plan_grip(found, ring(), RESOLUTION, GOALS, every) is None


def test_no_candidates_give_no_grip() -> None:
    models = [flat("one", L_SHAPE)]
    found = hypotheses_for(models, Placed(models[0], 0.0, 0.0, 0.0))
    nothing = Ring([])
    for strategy in Strategy:
        assert next_grip(strategy, found, nothing, 0) is None
    assert confirmation_grip(found, nothing, RESOLUTION, 2) is None
    assert all_twins(found, nothing)


# ----------------------------------------------------------------------------------------------------
# The memo's strategies, checks of an answer, and what speaks for it.


def next_grip(strategy: Strategy, found: Recognition, reachable: Ring, seed: int) -> Grip | None:
    if strategy is Strategy.PLANNED:
        return plan_grip(found, reachable, RESOLUTION, GOALS)
    return heuristic_grip(strategy, found, reachable, RESOLUTION, np.random.default_rng(seed))


def wanted(shift_mm: float) -> Confirmation:
    return Confirmation(2, shift_mm, StrangerEvidence.none(), 1.0)


def test_used_candidates_are_those_along_a_path_and_no_others() -> None:
    candidates = ring().approaches
    for k in (0, 7, 40):
        used = used_approaches([contact_along(candidates[k], 90.0)], candidates)
        assert np.flatnonzero(used).tolist() == [k]
    other = replace(contact_along(candidates[7], 90.0), finger=Finger(4.0, 10.0))
    assert not used_approaches([other], candidates).any()
    assert not used_approaches([], candidates).any()


def test_the_strategies_choose_what_their_names_say() -> None:
    _, found = some_recognition(4, half_deg=20.0)
    reachable = ring(96)
    grips = {
        strategy: [next_grip(strategy, found, reachable, seed) for seed in range(3)] for strategy in Strategy
    }
    for several in grips.values():
        for chosen in several:
            assert chosen is not None
            fingers = [item.finger_index for item in chosen.approaches]
            assert len(set(fingers)) == len(fingers)
    planned = grips[Strategy.PLANNED]
    assert planned[0] is not None
    assert all(item is not None and item.approaches == planned[0].approaches for item in planned)
    drawn = {item.approaches for item in grips[Strategy.RANDOM] if item is not None}
    assert len(drawn) > 1


def test_rotate_stays_beside_the_last_touch_of_each_finger() -> None:
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[3], np.random.default_rng(8))
    reachable = ring(72)
    first = [24, 75, 117]
    contacts = []
    for k in first:
        travel = travel_of(placed, reachable.approaches[k])
        assert math.isfinite(travel)
        contacts.append(contact_along(reachable.approaches[k], travel))
    found = recognise(Catalogue(models), contacts)
    chosen = next_grip(Strategy.ROTATE, found, reachable, 0)
    assert chosen is not None
    assert len(chosen.approaches) == 3
    for candidate in chosen.approaches:
        angle, start = candidate.direction_rad, np.asarray(candidate.start_mm)
        asides = [
            abs(math.cos(angle) * (c.end_mm[1] - start[1]) - math.sin(angle) * (c.end_mm[0] - start[0]))
            for c in contacts
        ]
        assert 3.0 <= min(asides) < 12.0


def test_a_check_meets_the_answer_where_nothing_was_touched() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        models = outlines(SHIPPED_OBJECTS)
        placed = place(models[seed], rng)
        found = recognise(Catalogue(models), grip(placed, rng, fingers=7, half_range=math.radians(8)))
        known = np.array([contact.end_mm for contact in found.contacts if contact.touched])
        counts = []
        for shift_mm in (50.0, 0.1):
            chosen = confirmation_grip(found, ring(), RESOLUTION, wanted(shift_mm))
            assert chosen is not None
            counts.append(len(chosen.approaches))
            for row, candidate in enumerate(chosen.approaches):
                assert math.isfinite(chosen.predictions.of(row, 0).latest_mm)
                travel = travel_of(placed, candidate)
                end = contact_along(candidate, travel).end_mm
                assert np.linalg.norm(known - end, axis=1).min() > 3.0
        assert counts == [2, 3]  # a smaller shift takes more touches to notice


def test_a_shift_goes_unnoticed_within_what_is_foretold_and_no_further() -> None:
    """A part with straight sides, shifted in every direction before two touches: brute force."""
    models = [flat("slab", [(0, 0), (60, 0), (60, 24), (0, 24)])]
    placed = Placed(models[0], -30.0, -12.0, 0.3)
    found = recognise(
        Catalogue(models), grip(placed, np.random.default_rng(2), fingers=7, half_range=math.radians(8))
    )
    chosen = confirmation_grip(found, ring(), RESOLUTION, wanted(50.0))
    assert chosen is not None
    approaches = chosen.approaches
    normals = np.array([normal_at(placed, item, travel_of(placed, item)) for item in approaches])
    limit = detectable_shift_mm(
        chosen.predictions, normals, np.array([item.direction_rad for item in approaches])
    )
    assert 1.0 < limit < 30.0
    hidden = 0
    for bearing in np.arange(0, 2 * math.pi, 0.1):
        for size in (0.2 * limit, limit * 1.001):
            moved = replace(
                placed,
                x=placed.x + size * math.cos(bearing),
                y=placed.y + size * math.sin(bearing),
            )
            agrees = all(
                chosen.predictions.of(row, 0).earliest_mm
                <= travel_of(moved, item)
                <= chosen.predictions.of(row, 0).latest_mm
                for row, item in enumerate(approaches)
            )
            assert not (agrees and size > limit)
            hidden += agrees
    assert hidden


def test_a_candidate_fits_only_beside_other_fingers() -> None:
    _, found = some_recognition(0)
    one, same, other = (predict_approach(found, ring(), k) for k in (0, 1, 3))
    assert fits_together(ring(), one, [])
    assert not fits_together(ring(), one, [same])
    assert fits_together(ring(), one, [other])


class Unsteady:
    """Limits of states that may only be pushed towards +x and +y of the object's frame."""

    def safe_heights_mm(self, states: Ints) -> Floats:
        angle = np.radians(np.arange(360))
        row = np.where((np.cos(angle) > -0.4) & (np.sin(angle) > -0.4), np.inf, 0.0)
        return np.tile(row, (len(states), 1))

    def slide_shares(self, states: Ints) -> Floats:
        return np.zeros((len(states), 2))

    def touch_mm_s(self, states: Ints) -> float:
        del states
        return 5.0


class Light:
    """Limits of states that slide under a touch further than 10 mm off their middle."""

    def safe_heights_mm(self, states: Ints) -> Floats:
        return np.full((len(states), 360), np.inf)

    def slide_shares(self, states: Ints) -> Floats:
        return np.tile([0.5, 0.05], (len(states), 1))

    def touch_mm_s(self, states: Ints) -> float:
        del states
        return 1.0


def test_the_hazard_of_sliding_grows_with_the_distance_from_the_middle() -> None:
    models = [flat("bar", [(0, 0), (80, 0), (80, 12), (70, 20), (0, 20)])]
    catalogue = Catalogue(models)
    rng = np.random.default_rng(5)
    placed = Placed(models[0], -40.0, -10.0, 0.4)
    found = recognise(catalogue, grip(placed, rng, fingers=6, half_range=math.radians(8)))
    poses, approaches = sampled_poses(found.hypotheses), ring().approaches
    outcome = touch_outcomes(catalogue, poses.cells, found.anchor_mm, approaches)
    hazard = push_hazard(Light(), approaches, poses, found.anchor_mm, outcome)
    rows = np.flatnonzero(outcome.hit.all(axis=1))
    off = []
    for row in rows.tolist():
        item = approaches[row]
        at = np.array(item.start_mm) + travel_of(placed, item) * unit(item.direction_rad)
        off.append(float(np.hypot(*(at - placed.on_table(catalogue.origins_mm[0])))))
    expected = 1 - 1 / np.maximum(0.5 + 0.05 * np.array(off), 1.0)
    assert hazard[rows] == pytest.approx(expected, abs=0.06)
    assert not hazard[~outcome.hit.any(axis=1)].any()


class Steady(Light):
    """The same limits, of states that do not slide."""

    def slide_shares(self, states: Ints) -> Floats:
        return np.zeros((len(states), 2))


def test_more_fingers_touch_what_may_slide_while_much_is_confused() -> None:
    """Contacts of one grip are of the part as it lay then; a later grip's motion widens them."""
    blunt = Resolution(12.0, math.radians(60))
    fingers: dict[bool, list[int]] = {False: [], True: []}
    for seed in range(6):
        _, found = some_recognition(seed)
        if len(found.hypotheses) < 2:
            continue
        for light in (False, True):
            limits = Light() if light else Steady()
            chosen = plan_grip(found, ring(), blunt, GOALS, limits=limits)
            assert chosen is not None
            fingers[light].append(len(chosen.approaches))
            assert not light or chosen.remaining <= 0.1 or len(chosen.approaches) > 1
    assert sum(fingers[True]) > sum(fingers[False]), fingers


def test_fingers_that_may_move_the_part_do_not_go_on_for_the_few_poses_that_are_far() -> None:
    """They stop beyond what four poses in five meet; while hypotheses are wide, all three go together."""
    shorter, more = 0, 0
    for seed in range(6):
        rng, models = np.random.default_rng([61, seed]), outlines(SHIPPED_OBJECTS)
        contacts = until_touched(grip, place(models[seed], rng), rng, fingers=2, bound=1.0)
        found = recognise(Catalogue(models), contacts)
        light = plan_grip(found, ring(), RESOLUTION, GOALS, limits=Light())
        assert light is not None
        more += len(light.approaches) == 3
        for row, index in enumerate(light.indices):
            whole = predict_approach(found, ring(), index)
            far = light.travels_mm[row]
            assert far <= whole.travel_mm
            latest = light.predictions.latest[row]
            assert (latest[np.isfinite(latest)] <= far).all()
            shorter += far < whole.travel_mm
    assert shorter
    assert more >= 5


def test_approaches_that_may_tip_the_part_are_the_last_to_be_taken() -> None:
    """A block that can be touched from anywhere, and may be from two sides only."""
    models = [flat("block", [(0, 0), (50, 0), (50, 30), (38, 40), (0, 40)])]
    catalogue, limits = Catalogue(models), Unsteady()
    risky = {False: 0, True: 0}
    for seed in range(4):
        rng = np.random.default_rng(seed)
        placed = Placed(models[0], -20.0, -15.0, 0.4)
        found = recognise(catalogue, grip(placed, rng, fingers=6, half_range=math.radians(8)))
        for limited in (False, True):
            some = limits if limited else None
            for chosen in (
                plan_grip(found, ring(), RESOLUTION, GOALS, limits=some),
                confirmation_grip(found, ring(), RESOLUTION, wanted(50.0), some),
            ):
                assert chosen is not None
                for item in chosen.approaches:
                    normal = normal_at(placed, item, travel_of(placed, item)) - placed.theta
                    risky[limited] += math.cos(normal) > 0.4 or math.sin(normal) > 0.4
    assert risky[True] < risky[False] / 2, risky


# ----------------------------------------------------------------------------------------------------
# A grip that is called decisive is: carried out for every hypothesis, it leaves one class.


@pytest.mark.parametrize("trials", sample([60, 150], [60]))
@pytest.mark.parametrize(
    ("path", "per_cent"),
    [(SHIPPED_OBJECTS, 5), pytest.param(SHARED_OUTLINES, 8, marks=needs_shared_outlines)],
    ids=["six", "outlines"],
)
def test_decisive_grips_decide(path: Path, per_cent: int, trials: int) -> None:
    decisive = 0
    for index in range(trials):
        trial = drawn(path, 11, index)
        if trial is None:
            continue
        decisive += 1
        found = checked(path, trial, 11, 3)
        assert found.outcomes >= 2 * found.hypotheses
        assert found.undecided == 0, f"trial {index}"
        assert found.unforeseen == 0, f"trial {index}"
    assert 100 * decisive >= per_cent * trials
