"""Symmetric and round states."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.recognizer import Catalogue, Contact, Finger, Motion, recognise
from palpate.recognizer.symmetry import Symmetry, centroid, rotational_symmetry, symmetrise
from support.campaign.sampling import sample
from support.oracles.shapely_touches import (
    Placed,
    exact_contact,
    flat,
    grip,
    holding_truth,
    place,
    unit,
    until_touched,
)

# ----------------------------------------------------------------------------------------------------
# Rotational symmetry, with shapes made to be mistaken for symmetric ones.


def state(*sections: list[tuple[float, float]] | np.ndarray) -> State:
    return State(
        "flat",
        tuple(
            Section((10.0 * k, 10.0 * (k + 1)), (Polygon(np.asarray(ring, dtype=float)),))
            for k, ring in enumerate(sections)
        ),
    )


def order(of: State) -> int:
    return symmetry(of).order


def symmetry(of: State) -> Symmetry:
    return rotational_symmetry(of, centroid(of), 1e-3)


def regular(sides: int, radius: float = 30.0, turn: float = 0.3) -> np.ndarray:
    angle = turn + 2 * math.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + (7.0, -4.0)


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 12])
def test_regular_polygons(sides: int) -> None:
    assert order(state(regular(sides))) == sides


def test_rectangle_with_split_edges() -> None:
    assert order(state([(0, 0), (13, 0), (40, 0), (40, 20), (0, 20)])) == 2


def test_mirror_symmetry_is_none() -> None:
    assert order(state([(0, 0), (40, 0), (30, 20), (10, 20)])) == 1


def test_hourglass_whose_vertices_turn_onto_each_other() -> None:
    # All vertices of an X-shaped part lie on a square; the edges between them do not turn by 90°.
    hourglass = [(-20, -20), (20, -20), (5, 0), (20, 20), (-20, 20), (-5, 0)]
    assert order(state(hourglass)) == 2
    square_vertices = [(-20, -20), (0, -6), (20, -20), (6, 0), (20, 20), (0, 6), (-20, 20), (-6, 0)]
    assert order(state(square_vertices)) == 4
    without_one = [(-20, -20), (20, -20), (6, 0), (20, 20), (0, 6), (-20, 20), (-6, 0)]
    assert order(state(without_one)) == 1


def test_all_sections_count() -> None:
    square = [(-20, -20), (20, -20), (20, 20), (-20, 20)]
    assert order(state(square, [(-10, -5), (10, -5), (10, 5), (-10, 5)])) == 2
    assert order(state(square, [(0, 0), (10, 0), (0, 10)])) == 1


def test_a_displaced_boss_breaks_symmetry() -> None:
    square = np.array([(-20, -20), (20, -20), (20, 20), (-20, 20)], dtype=float)
    assert order(state(square, square / 4)) == 4
    assert order(state(square, square / 4 + (3.0, 0.0))) == 1


def test_a_hole_counts() -> None:
    outer = np.array([(-20, -20), (20, -20), (20, 20), (-20, 20)], dtype=float)
    hole = np.array([(-8, -3), (8, -3), (8, 3), (-8, 3)], dtype=float)
    holed = State("flat", (Section((0.0, 10.0), (Polygon(outer, (hole,)),)),))
    assert order(holed) == 2


def test_two_parts_that_change_places() -> None:
    part = np.array([(10, 0), (20, 0), (10, 15)], dtype=float)
    both = State("flat", (Section((0.0, 10.0), (Polygon(part), Polygon(-part))),))
    assert order(both) == 2


def test_off_by_more_than_the_tolerance() -> None:
    assert order(state([(0, 0), (40, 0), (40, 20.01), (0, 20)])) == 1
    assert order(state([(0, 0), (40, 0), (40, 20.0004), (0, 20)])) == 2


def test_centroid_of_several_sections_is_that_of_area() -> None:
    of = state([(0, 0), (2, 0), (2, 2), (0, 2)], [(10, 0), (14, 0), (14, 3), (10, 3)])
    assert centroid(of) == pytest.approx([(4 * 1 + 12 * 12) / 16, (4 * 1 + 12 * 1.5) / 16])


def wavy(vertices: int, lobes: int, depth: float) -> np.ndarray:
    """A round of many vertices whose radius goes up and down by `depth`, as often as there are lobes."""
    angle = 0.2 + 2 * math.pi * np.arange(vertices) / vertices
    radius = 30.0 + depth * np.cos(lobes * angle)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]) + (3.0, 11.0)


@pytest.mark.parametrize("lobes", [2, 3, 5])
@pytest.mark.parametrize("vertices", [600, 2400])
def test_steps_that_are_each_within_the_tolerance_and_together_are_not(lobes: int, vertices: int) -> None:
    assert order(state(wavy(vertices, lobes, 0.1))) == lobes
    assert order(state(wavy(vertices, lobes, 4e-4))) == vertices


def test_a_round_of_many_vertices_keeps_its_order() -> None:
    found = symmetry(state(regular(6000)))
    assert found.order == 6000
    assert found.off_mm < 1e-9


@pytest.mark.parametrize("sides", [5, 8, 12])
def test_every_turn_is_off_by_no_more_than_is_said(sides: int) -> None:
    """Coordinates as files have them, with three decimals."""
    ring = np.round(regular(sides), 3)
    found = symmetry(state(ring))
    assert found.order == sides
    outline = shapely.Polygon(ring).exterior
    off = [
        shapely.hausdorff_distance(
            affinity.rotate(outline, 360 * k / sides, origin=tuple(centroid(state(ring)))), outline
        )
        for k in range(1, sides)
    ]
    assert max(off) <= found.off_mm <= 1e-3
    assert found.lean_rad <= 2 * found.off_mm / 10


def touching(placed: Placed, name: str, radius: float, point: np.ndarray, normal: float) -> Contact:
    """Square onto a point (2,) of the outline, where its outward normal is the given one: without errors."""
    at, out = placed.on_table(point), unit(normal + placed.theta)
    start, end = (at + (radius + far) * out for far in (90.0, 0.0))
    return exact_contact(name, radius, start, end, normal + placed.theta, 1e-6)


@pytest.mark.parametrize("askew", [0, 1])
@pytest.mark.parametrize("first", range(4))
def test_notches_that_are_a_little_askew_on_two_sides(askew: int, first: int) -> None:
    """A finger that they are too narrow for meets a plain square; a point in one feels the difference."""
    nick = np.array([(-20.0, -20.0), (-1.5, -20.0), (-1.5, -18.0), (1.5, -18.0), (1.5, -20.0)])
    sides = [nick.copy() for _ in range(4)]
    sides[askew][2, 1] = sides[askew + 2][2, 1] = -18.0 + 9e-4
    ring = np.vstack([points @ np.array(_turn(k)).T for k, points in enumerate(sides)])
    model = flat("nicked", ring)
    assert order(model.states[0]) == 4
    placed = Placed(model, 4.0, -7.0, 0.6)
    begin, end = ring[5 * first + 2], ring[5 * first + 3]
    out = (first - 1) * math.pi / 2
    beside, next_side = 20 * unit(out) + 11 * unit(out + math.pi / 2), out + math.pi / 2
    contacts = [
        touching(placed, "side", 6.0, beside, out),
        touching(placed, "next", 6.0, 20 * unit(next_side) + 9 * unit(out), next_side),
        touching(placed, "floor", 0.0, (begin + end) / 2, math.atan2(begin[0] - end[0], end[1] - begin[1])),
    ]
    assert holding_truth(recognise(Catalogue([model]), contacts), placed) is not None


def _turn(quarters: int) -> list[list[float]]:
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    return [[cos, -sin], [sin, cos]]


def test_an_oval_lies_as_it_does() -> None:
    """Its answers are turned by no more than their bounds say, but for half a turn."""
    angle = 2 * math.pi * np.arange(1800) / 1800
    model = flat("oval", np.column_stack([20.2 * np.cos(angle), 19.95 * np.sin(angle)]))
    catalogue = Catalogue([model])
    for seed in (0, 2, 6, 8):
        rng = np.random.default_rng(seed)
        placed = place(model, rng)
        contacts = grip(placed, rng, radius=3.0, bound=0.01, half_range=math.radians(1), aim=0.02)
        bounds = [item.bounds.theta_rad for item in recognise(catalogue, contacts).hypotheses]
        assert any((placed.theta - lo) % math.pi <= hi - lo for lo, hi in bounds)


def shaken(ring: np.ndarray, size: float, seed: int) -> np.ndarray:
    """Every vertex off by at most a size, as a mesh has it that was stored in single precision."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * math.pi, len(ring))
    return ring + size * np.sqrt(rng.random(len(ring)))[:, None] * np.column_stack(
        [np.cos(turn), np.sin(turn)]
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_state_made_symmetric_is_so_and_hardly_off(seed: int) -> None:
    outer, hole = shaken(regular(24), 2e-4, seed), shaken(regular(8, 12.0), 2e-4, seed + 100)
    given = State("flat", (Section((0.0, 20.0), (Polygon(outer, (hole[::-1],)),)),))
    before, about = symmetry(given), centroid(given)
    assert before.order == 8
    made = symmetrise(given, about, before.order, 1e-3)
    assert made is not None
    after = rotational_symmetry(made, about, 1e-3)
    assert after.order == 8
    assert after.off_mm < 1e-12
    assert before.off_mm > 1e-5
    for ring, other in zip(made.sections[0].rings, given.sections[0].rings, strict=True):
        assert np.hypot(*(ring - other).T).max() <= before.off_mm


def test_what_has_vertices_on_straight_lines_is_left_as_it_is() -> None:
    ring = np.insert(regular(6), 1, regular(6)[:2].mean(axis=0), axis=0)
    given = state(shaken(ring, 1e-10, 0))
    assert symmetry(given).order == 6
    assert symmetrise(given, centroid(given), 6, 1e-3) is None


@pytest.mark.parametrize("seed", range(6))
def test_one_edge_of_each_orbit_is_enough_for_a_round_part_of_some_tolerance(seed: int) -> None:
    rng = np.random.default_rng([5, seed])
    outline = shaken(regular(32, float(rng.uniform(10, 30))), 1e-6, seed)
    model = replace(flat("round", outline), tolerance_mm=0.05)
    catalogue = Catalogue([model])
    item, edges = catalogue.states[0], catalogue.edges(Finger(5.0, 10.0))
    assert item.symmetry_order == 32
    assert np.count_nonzero(edges.representative) * 32 == len(edges.state)
    assert 0.05 < item.tolerance_mm < 0.0501
    true = flat(
        "round", outline + 0.05 * np.column_stack([np.cos(turn := rng.uniform(0, 7, 32)), np.sin(turn)])
    )
    placed = place(true, rng)
    found = recognise(catalogue, grip(placed, rng, bound=0.1, half_range=math.radians(10), at_bound=True))
    assert holding_truth(found, placed) is not None


# ----------------------------------------------------------------------------------------------------
# Round states: circles about one centre are searched as such; the truth stays, and θ is any.

RADIUS = 18.0


def round_model(tolerance: float = 0.0, bound: float | None = None, centre: tuple[float, float] = (0.0, 0.0)):
    """A ring as an objects file has it."""
    outer, inner = ({"circle": {"centre": list(centre), "radius": r}} for r in (RADIUS, 6.0))
    sections = [
        {"z": [0, 12], "polygons": [{"outer": outer, "holes": [inner]}]},
        {"z": [12, 20], "polygons": [{"outer": {"circle": {"centre": list(centre), "radius": 11.0}}}]},
    ]
    state = {"name": "flat", "sections": sections} | ({} if bound is None else {"normal_bound": bound})
    table = {"name": "ring", "tolerance": tolerance, "states": [state]}
    text = {"format": "palpate/objects@1", "units": "mm", "objects": [table]}
    return objects_from_text(ObjectsFileText.model_validate(text), "here").objects[0]


def true_disc(radii_mm: np.ndarray, centre: tuple[float, float] = (0.0, 0.0)) -> ObjectModel:
    """A finely drawn outline of these radii at equal angles, up to 12 mm high: for judges only."""
    angle = 2 * math.pi * np.arange(len(radii_mm)) / len(radii_mm)
    outline = np.array(centre) + radii_mm[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return flat("ring", outline, 12.0)


def square() -> ObjectModel:
    return flat("square", np.array([[-16.0, -16.0], [16.0, -16.0], [16.0, 16.0], [-16.0, 16.0]]))


def is_kept(catalogue: Catalogue, true: ObjectModel, rng: np.random.Generator, **errors: float) -> bool:
    placed: Placed = place(true, rng)
    radius = float(rng.choice([0.0, 1.0, 5.0, 8.0]))
    contacts = grip(placed, rng, radius=radius, aim=0.4, **errors)
    touched = [contact for contact in contacts if contact.touched]
    if not touched:
        return True
    return holding_truth(recognise(catalogue, contacts), placed) is not None


@pytest.mark.parametrize("seed", sample(range(25), range(3)))
@pytest.mark.parametrize("at_bound", [False, True])
def test_a_true_circle_stays(seed: int, at_bound: bool) -> None:
    rng = np.random.default_rng([48, seed])
    true = true_disc(np.full(20_000, RADIUS))
    half = float(rng.choice([0.001, 0.1, 0.4]))
    bound = float(rng.choice([0.01, 0.3, 1.0]))
    assert is_kept(
        Catalogue([round_model(), square()]),
        true,
        rng,
        bound=bound,
        half_range=half,
        fingers=int(rng.integers(1, 6)),
        at_bound=at_bound,
    )


@pytest.mark.parametrize("seed", sample(range(25), range(9)))
def test_an_ellipse_within_the_tolerance_and_the_normal_bound_stays(seed: int) -> None:
    rng = np.random.default_rng([49, seed])
    off = float(rng.choice([0.02, 0.1, 0.3]))
    angle = 2 * math.pi * np.arange(5000) / 5000
    true = true_disc(RADIUS + off * np.cos(2 * angle))
    model = round_model(off, 2.2 * off / (RADIUS - off))
    assert is_kept(
        Catalogue([model]), true, rng, bound=0.2, half_range=0.05, fingers=4, at_bound=bool(seed % 2)
    )


@pytest.mark.parametrize("seed", sample(range(25), range(9)))
def test_a_rough_circle_within_the_tolerance_stays_though_no_bound_of_normals_is_known(seed: int) -> None:
    rng = np.random.default_rng([50, seed])
    off = float(rng.choice([0.02, 0.1, 0.3]))
    true = true_disc(RADIUS + rng.uniform(-off, off, int(rng.choice([60, 300, 2000]))))
    assert is_kept(
        Catalogue([round_model(off)]),
        true,
        rng,
        bound=0.2,
        half_range=0.05,
        fingers=3,
        at_bound=bool(seed % 2),
    )


@pytest.mark.parametrize("seed", sample(range(40), range(9)))
def test_a_slot_with_true_arcs_stays(seed: int) -> None:
    """Arcs of a state that is not round are polygons in the search, a little off."""
    rng = np.random.default_rng([52, seed])
    table = {"name": "slot", "height": 20, "outline": [[-20, -9], [20, -9, 1], [20, 9], [-20, 9, 1]]}
    text = {"format": "palpate/objects@1", "units": "mm", "objects": [table]}
    model = objects_from_text(ObjectsFileText.model_validate(text), "here").objects[0]
    true = shapely.LineString([[-20, 0], [20, 0]]).buffer(9.0, quad_segs=2000)
    assert is_kept(
        Catalogue([model, square()]),
        flat("slot", shapely.get_coordinates(true)[:-1]),
        rng,
        bound=float(rng.choice([0.0, 0.01, 0.5])),
        half_range=float(rng.choice([1e-4, 0.05, 0.3])),
        fingers=int(rng.integers(2, 6)),
        at_bound=bool(seed % 2),
    )


def test_the_anchor_of_each_circle_stands_for_all() -> None:
    catalogue = Catalogue([round_model()])
    (state,) = catalogue.states
    assert (state.symmetry.order, state.symmetry_order) == (48, 0)
    for height, circles in ((5.0, 2), (15.0, 1)):
        for edges in (catalogue.edges(Finger(3.0, height)), catalogue.outlines(Finger(3.0, height))):
            assert (edges.representative.sum(), len(edges.state)) == (circles, circles * 25)


def test_a_hole_that_the_tip_does_not_enter_has_no_edges() -> None:
    edges = Catalogue([round_model()]).edges(Finger(6.5, 5.0))
    assert edges.representative.sum() == 1


@pytest.mark.parametrize("centre", [(0.0, 0.0), (4.0, -3.0)])
def test_theta_is_any_and_bounds_hold_for_every_theta(centre: tuple[float, float]) -> None:
    rng = np.random.default_rng(51)
    catalogue = Catalogue([round_model(centre=centre)])
    placed = place(true_disc(np.full(5000, RADIUS), centre), rng)
    found = recognise(catalogue, grip(placed, rng, bound=0.1, half_range=0.1, fingers=4, aim=0.2))
    (item,) = found.hypotheses
    assert item.bounds.theta_rad == (-math.pi, math.pi)
    middle = placed.on_table(np.array(centre))
    for theta in np.linspace(-math.pi, math.pi, 17):
        cos, sin = math.cos(theta), math.sin(theta)
        x, y = middle - [cos * centre[0] - sin * centre[1], sin * centre[0] + cos * centre[1]]
        assert item.bounds.x_mm[0] <= x <= item.bounds.x_mm[1]
        assert item.bounds.y_mm[0] <= y <= item.bounds.y_mm[1]


def test_a_state_is_round_only_if_all_its_circles_have_one_centre() -> None:
    (state,) = round_model().states
    assert state.is_round
    (low, high) = state.sections
    circle = high.polygons[0].curves[0]
    outer = high.polygons[0].outer + np.array([1.0, 0.0])
    moved = Polygon(outer, (), (replace(circle, centre_mm=(1.0, 0.0)),))
    assert not State("a", (low, Section((12.0, 20.0), (moved,)))).is_round
    assert not square().states[0].is_round


@pytest.mark.parametrize("seed", sample(range(40), range(9)))
def test_a_rough_disc_that_is_shifted_and_turned_by_any_angle_stays(seed: int) -> None:
    """Its turn is no motion: what is known of a circle is the same for all of them."""
    rng = np.random.default_rng([53, seed])
    off, shift = float(rng.choice([0.02, 0.1, 0.3])), float(rng.choice([0.05, 0.4, 1.5]))
    model = round_model(off)
    catalogue = Catalogue([model])
    motion = Motion(np.array([shift]), np.array([0.0]))
    true = true_disc(RADIUS + rng.uniform(-off, off, int(rng.choice([60, 300]))))
    placed = place(true, rng)
    how = {"bound": 0.2, "half_range": 0.1, "at_bound": bool(seed % 2)}
    found = recognise(catalogue, until_touched(grip, placed, rng, fingers=3, **how))
    for _ in range(3):
        bearing, share = rng.uniform(0, 2 * math.pi), float(rng.choice([1.0, rng.random()]))
        x, y = share * shift * np.array([math.cos(bearing), math.sin(bearing)])
        placed = replace(placed, x=placed.x + x, y=placed.y + y, theta=rng.uniform(-math.pi, math.pi))
        assert holding_truth(found.move(motion), placed) is not None
        found = found.extend(grip(placed, rng, fingers=2, **how), motion)
        assert holding_truth(found, placed) is not None
