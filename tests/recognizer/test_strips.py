"""Strips of outlines and their simplification."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.geometry.plane import point_segment_distance, wrap_angle
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.minkowski import grow, simplify_outline
from palpate.recognizer.offset_curves import GrownSection
from palpate.recognizer.recognition import Recognition, recognise
from palpate.recognizer.strip_trees import StripForest
from support.campaign.sampling import sample
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
    touch,
    with_normal,
)

# ----------------------------------------------------------------------------------------------------
# Strip trees: what they say of their edges holds, and a search by them answers what a flat one does.

FLAT = 10**9
NARROW, WIDE = math.radians(5), math.radians(20)
FEW_AND_MANY = (1, 2, 3, 4, 5)
FINGERS = list(product([0.0, 5.0], [WIDE, NARROW, None]))
FINE = [
    (300, 0.0, None, (4,)),
    (300, 0.0, WIDE, (2, 3)),
    (300, 5.0, NARROW, (2, 3)),
    (500, 0.0, None, (4,)),
    (500, 5.0, NARROW, (3, 5)),
    (1200, 0.0, NARROW, (3, 4)),
]


def ring(kind: str, vertices: int, size: float = 1.0, seed: int = 0) -> np.ndarray:
    a = 2 * np.pi * np.arange(vertices) / vertices
    radius = 60 + 6 * np.sin(3 * a + 1) + 3 * np.cos(7 * a)
    if kind == "wavy":
        radius = radius + np.sin(vertices // 6 * a)
    if kind == "noisy":
        radius = radius + np.random.default_rng(seed).uniform(-0.5, 0.5, vertices)
    return size * radius[:, None] * np.column_stack([np.cos(a), np.sin(a)])


def wavy(edges: int) -> ObjectModel:
    return flat(f"wavy-{edges}", ring("wavy", edges))


def framed() -> ObjectModel:
    """A plate with two holes, and beside it a smaller polygon and one within a hole."""
    holes = (
        np.array([(-35, -20), (-5, -20), (-5, 18), (-35, 18)], dtype=float),
        np.array([(8, -12), (20, -16), (30, 0), (18, 14), (6, 8)], dtype=float),
    )
    plate = Polygon(np.array([(-45, -30), (40, -30), (48, 4), (30, 30), (-45, 26)], dtype=float), holes)
    inner = Polygon(np.array([(-28, -8), (-14, -10), (-16, 6), (-26, 8)], dtype=float))
    beside = Polygon(np.array([(-20, 34), (10, 34), (4, 46), (-16, 44)], dtype=float))
    section = Section((0.0, 20.0), (plate, inner, beside))
    return ObjectModel("framed", (State("flat", (section,)),))


def ring_of_teeth() -> ObjectModel:
    """Twelve-fold symmetric, with a hole of the same symmetry."""
    a = 2 * np.pi * np.arange(48) / 48
    unit = np.column_stack([np.cos(a), np.sin(a)])
    outer = np.where(np.arange(48) % 4 < 2, 42.0, 34.0)[:, None] * unit
    section = Section((0.0, 20.0), (Polygon(outer, (20.0 * unit[::4],)),))
    return ObjectModel("teeth", (State("flat", (section,)),))


def forest(models: list[ObjectModel], radius: float) -> tuple[EdgeSet, StripForest]:
    catalogue = Catalogue(models, flat_edges=8)
    finger = Finger(radius, 10.0)
    return catalogue.edges(finger), catalogue.strips(finger)


def below(strips: StripForest, strip: int) -> list[int]:
    """The edges of the leaves under a strip."""
    stack, found = [strip], []
    while stack:
        at = stack.pop()
        if strips.edge[at] >= 0:
            found.append(int(strips.edge[at]))
        else:
            stack += [int(strips.left[at]), int(strips.right[at])]
    return found


MODELS = [outlines(SHIPPED_OBJECTS)[3], wavy(300), framed(), ring_of_teeth()]


@pytest.mark.parametrize("radius", [0.0, 5.0])
def test_every_edge_is_in_one_leaf_of_its_states_tree(radius: float) -> None:
    square = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])
    edges, strips = forest([*MODELS, square], radius)
    leaves = strips.edge[strips.edge >= 0]
    assert len(leaves) == len(np.unique(leaves))
    seen = []
    for state, root in enumerate(strips.root):
        if edges.count[state] <= 8:
            assert root < 0
            continue
        block = range(int(edges.first[state]), int(edges.first[state + 1]))
        assert sorted(below(strips, int(root))) == list(block)
        seen += block
    assert sorted(leaves.tolist()) == seen
    inner = strips.edge < 0
    assert np.all((strips.left[inner] >= 0) & (strips.right[inner] >= 0))
    assert np.all((strips.left[~inner] < 0) & (strips.right[~inner] < 0))


@pytest.mark.parametrize("radius", [0.0, 5.0])
def test_strips_enclose_their_edges(radius: float) -> None:
    """Points of every edge's slack are within the stray, every normal of its span within the half turn."""
    edges, strips = forest(MODELS, radius)
    part = np.linspace(0.0, 1.0, 5)
    for strip in range(len(strips.edge)):
        under = np.array(below(strips, strip))
        along = strips.end[strip] - strips.start[strip]
        length = np.hypot(*along)
        direction = along / max(length, 1e-300)
        points = edges.start[under, None] + part[:, None] * (edges.end - edges.start)[under, None]
        for across in (edges.slack_out[under], -edges.slack_in[under], np.zeros(len(under))):
            for aside in (-1, 0, 1):
                shift = across[:, None] * edges.normal[under]
                shift = shift + aside * edges.slack_along[under][:, None] * edges.direction[under]
                away = point_segment_distance(points + shift[:, None], strips.start[strip], direction, length)
                assert away.max() <= strips.stray[strip] + 1e-9
        off = np.abs(wrap_angle(edges.normal_rad[under] - strips.normal[strip])) + edges.span[under]
        whole = strips.half_turn[strip] >= np.pi
        assert whole or off.max() <= strips.half_turn[strip] + 1e-9


def test_a_root_of_a_closed_outline_allows_all_normals() -> None:
    _, strips = forest([wavy(300)], 0.0)
    assert strips.half_turn[strips.root[0]] >= np.pi - 1e-2


def grip_with_misses(
    placed: Placed,
    rng: np.random.Generator,
    fingers: int,
    *,
    radius: float,
    bound: float,
    half_range: float | None,
) -> list[Contact]:
    """A grip and those of two more approaches, well off the middle, that miss. No error, but bounds."""
    contacts = grip(placed, rng, fingers=fingers, radius=radius, bound=0.0, half_range=half_range)
    for k in range(2):
        at = rng.uniform(0, 2 * math.pi)
        tried = touch(
            placed.shape,
            rng,
            radius=radius,
            bound=0.0,
            half_range=None,
            direction=at + math.pi + rng.choice([-1, 1]) * rng.uniform(0.35, 0.5),
            start=140 * np.array([math.cos(at), math.sin(at)]),
            reach=280.0,
            name=f"m{k}",
        )
        contacts += [] if tried.touched else [tried]
    exact = [with_normal(placed, contact, half_range) for contact in contacts]
    return [replace(contact, position_bound_mm=bound) for contact in exact]


def assert_same(one: Recognition, two: Recognition) -> int:
    """Interpretations, hypotheses, verdict: all that an answer holds. Returns how many hypotheses."""
    assert one.verdict is two.verdict
    pairings = [
        {(int(s), *(int(e) for e in row)) for s, row in zip(n.state, n.edges, strict=True)}
        for n in (one.interpretations, two.interpretations)
    ]
    assert pairings[0] == pairings[1]
    assert len(one.interpretations) == len(two.interpretations)
    rows = []
    for found in (one.hypotheses, two.hypotheses):
        row = np.column_stack([found.state, found.verified, found.lo, found.hi, found.weight])
        rows.append(row[np.lexsort(row.T[::-1].round(6))])
    np.testing.assert_allclose(rows[0], rows[1], rtol=0, atol=1e-9)
    return len(one.hypotheses)


def compared(
    models: list[ObjectModel], seed: int, trials: int, fingers: tuple[int, ...], **how: float | None
) -> int:
    """Flat and strip search on the same grips; returns how many gave hypotheses."""
    rng = np.random.default_rng(seed)
    by_strips, by_lists = Catalogue(models, flat_edges=8), Catalogue(models, flat_edges=FLAT)
    answered = 0
    for trial in range(trials):
        placed = place(models[trial % len(models)], rng)
        contacts = grip_with_misses(placed, rng, fingers[trial % len(fingers)], **how)
        if any(contact.touched for contact in contacts):
            answered += assert_same(recognise(by_strips, contacts), recognise(by_lists, contacts)) > 0
    return answered


@pytest.mark.parametrize(("radius", "half_range"), sample(FINGERS, FINGERS[::2]))
def test_same_answer_of_holes_and_several_polygons_too(radius: float, half_range: float | None) -> None:
    fingers = FEW_AND_MANY if half_range else FEW_AND_MANY[1:]
    for models, seed, trials in ((outlines(SHIPPED_OBJECTS), 41, 6), ([framed(), ring_of_teeth()], 42, 10)):
        assert compared(models, seed, trials, fingers, radius=radius, bound=0.3, half_range=half_range) >= 5


@pytest.mark.parametrize(("edges", "radius", "half_range", "fingers"), sample(FINE, FINE[:3]))
def test_same_answer_for_fine_outlines(
    edges: int, radius: float, half_range: float | None, fingers: tuple[int, ...]
) -> None:
    answered = compared(
        [wavy(edges)], 43, len(fingers), fingers, radius=radius, bound=0.1, half_range=half_range
    )
    assert answered == len(fingers)


def test_same_answer_from_inside_a_hole() -> None:
    """Fingers that come down in a hole and move outwards meet the hole's own edges."""
    rng = np.random.default_rng(44)
    models = [framed(), outlines(SHIPPED_OBJECTS)[3]]
    by_strips, by_lists = Catalogue(models, flat_edges=8), Catalogue(models, flat_edges=FLAT)
    for _ in range(4):
        placed = place(models[0], rng)
        cos, sin = math.cos(placed.theta), math.sin(placed.theta)
        start = np.array([cos * 18 + placed.x, sin * 18 + placed.y])
        contacts = [
            touch(
                placed.shape,
                rng,
                radius=1.0,
                bound=0.3,
                half_range=WIDE,
                direction=float(direction),
                start=start,
                reach=80.0,
                name=f"f{k}",
            )
            for k, direction in enumerate(rng.uniform(-math.pi, math.pi, 4))
        ]
        assert all(contact.touched for contact in contacts)
        assert assert_same(recognise(by_strips, contacts), recognise(by_lists, contacts)) > 0


def test_small_and_large_states_together() -> None:
    """Some states in lists and some in trees at once, contact after contact."""
    rng = np.random.default_rng(45)
    models = [
        *outlines(SHIPPED_OBJECTS),
        wavy(300),
        flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)]),
    ]
    mixed, by_lists = Catalogue(models, flat_edges=60), Catalogue(models, flat_edges=FLAT)
    finger = Finger(2.0, 10.0)
    assert 0 < np.sum(mixed.strips(finger).root >= 0) < len(models)
    for trial in range(8):
        placed = place(models[trial], rng)
        contacts = [c for c in grip(placed, rng, fingers=5, radius=2.0) if c.touched]
        one, two = recognise(mixed, contacts[:2]), recognise(by_lists, contacts[:2])
        assert_same(one, two)
        for contact in contacts[2:]:
            one, two = one.extend([contact]), two.extend([contact])
            assert_same(one, two)


# ----------------------------------------------------------------------------------------------------
# Outlines coarser than they came: nothing of the original is outside of what the coarse edges state.

KINDS = ("smooth", "wavy", "noisy")
SECTIONS = list(product((400, 60), KINDS, (0.0, 5.0)))
FEW = [
    (n, most, *rest)
    for n, most in ((900, 400), (900, 60), (6000, 2000))
    for rest in product(KINDS, (0.0, 5.0))
]


def grown(kind: str, vertices: int, radius: float) -> GrownSection:
    """An outline with a hole and a second polygon within the hole, each of its own number of vertices."""
    hole, inner = ring(kind, vertices // 3, 0.6, 1), ring(kind, vertices // 5, 0.3, 2)
    polygons = (Polygon(ring(kind, vertices), (hole,)), Polygon(inner))
    return grow(Section((0.0, 20.0), polygons), radius, 0.1)


def stated(original: GrownSection, coarse: GrownSection) -> np.ndarray:
    """For each original edge whether some coarse edge states where it is and how it faces, both at once.

    Sampled points of an edge, up to its bulge outside and its dent
    inside, have to lie within that coarse edge's own bulge and dent, and its normals within the span.
    """
    found = np.zeros(len(original.length), dtype=bool)
    normal = np.column_stack([original.direction[:, 1], -original.direction[:, 0]])
    angle = np.arctan2(*original.direction.T[::-1])
    coarse_angle = np.arctan2(*coarse.direction.T[::-1])
    across = np.column_stack([coarse.direction[:, 1], -coarse.direction[:, 0]])
    for k in range(len(original.length)):
        points = np.linspace(original.start[k], original.end[k], 3)
        points = np.concatenate(
            [points, points + original.bulge[k] * normal[k], points - original.dent[k] * normal[k]]
        )
        rel = points[:, None] - coarse.start
        height = np.einsum("pnj,nj->pn", rel, across)
        along = np.einsum("pnj,nj->pn", rel, coarse.direction)
        beyond = np.maximum(-along, along - coarse.length)
        fits = np.all(
            (height <= coarse.bulge + 1e-9)
            & (height >= -coarse.dent - 1e-9)
            & (beyond <= coarse.dent + coarse.bulge + 1e-9),
            axis=0,
        )
        turn = np.abs(wrap_angle(angle[k] - coarse_angle)) + original.span[k]
        fits &= turn <= coarse.span + 1e-9
        found[k] = fits.any()
    return found


@pytest.mark.parametrize(("most", "kind", "radius"), sample(SECTIONS, SECTIONS[::3] + SECTIONS[4::6]))
def test_every_original_edge_is_stated_by_a_coarse_one(most: int, kind: str, radius: float) -> None:
    original = grown(kind, 900, radius)
    coarse = simplify_outline(original, most)
    assert len(coarse.length) < len(original.length)
    found = stated(original, coarse)
    assert found.all(), (int(np.sum(~found)), len(found))


@pytest.mark.parametrize(
    ("vertices", "most", "kind", "radius"), sample(FEW, [row for row in FEW if row[0] == 900] + FEW[-5::3])
)
def test_edges_are_few_and_rings_closed(vertices: int, most: int, kind: str, radius: float) -> None:
    original = grown(kind, vertices, radius)
    coarse = simplify_outline(original, most)
    assert len(coarse.length) <= most
    # Every end is the start of exactly one edge, in the same numbers, and every start some old vertex.
    starts = coarse.start[np.lexsort(coarse.start.T)]
    ends = coarse.end[np.lexsort(coarse.end.T)]
    np.testing.assert_array_equal(starts, ends)
    assert len(np.unique(starts, axis=0)) == len(starts)
    old = {tuple(point) for point in original.start.tolist()}
    assert {tuple(point) for point in starts.tolist()} <= old
    assert ring_count(coarse) == ring_count(original)
    np.testing.assert_allclose(np.hypot(*coarse.direction.T), 1.0, atol=1e-12)
    np.testing.assert_allclose(
        coarse.start + coarse.length[:, None] * coarse.direction, coarse.end, atol=1e-9
    )
    assert np.all((coarse.bulge >= 0) & (coarse.dent >= 0) & (coarse.span >= 0) & (coarse.span <= np.pi))


def ring_count(section: GrownSection) -> int:
    following = {
        tuple(a): tuple(b) for a, b in zip(section.start.tolist(), section.end.tolist(), strict=True)
    }
    count = 0
    while following:
        point = next(iter(following))
        count += 1
        while point in following:
            point = following.pop(point)
    return count


@pytest.mark.parametrize("radius", [0.0, 5.0])
def test_outlines_of_few_edges_stay_as_they_are(radius: float) -> None:
    original = grown("wavy", 300, radius)
    assert simplify_outline(original, len(original.length)) is original


def test_small_rings_keep_their_corners() -> None:
    """A square hole in a fine outline has four edges before and after."""
    hole = np.array([(-9, -9), (9, -9), (9, 9), (-9, 9)], dtype=float)
    section = Section((0.0, 20.0), (Polygon(ring("noisy", 800), (hole,)),))
    original = grow(section, 0.0, 0.1)
    coarse = simplify_outline(original, 100)
    inside = np.hypot(*coarse.start.T) < 15
    assert np.sum(inside) == 4
    assert np.all(coarse.dent[inside] == 0)
    assert np.all(coarse.span[inside] < 1e-12)


def test_an_outline_that_cannot_be_that_coarse_is_still_closed() -> None:
    """Asked for fewer edges than rings can have, it is as coarse as it gets, and no hang."""
    coarse = simplify_outline(grown("noisy", 300, 0.0), 3)
    assert len(coarse.length) <= 3 * 5
    np.testing.assert_array_equal(
        coarse.start[np.lexsort(coarse.start.T)], coarse.end[np.lexsort(coarse.end.T)]
    )


def check_one_grip(model: ObjectModel, seed: int, radius: float) -> None:
    """One grip of four fingers on the object, exactly at its bounds: the truth is kept."""
    rng = np.random.default_rng(seed)
    placed = place(model, rng)
    half = math.radians(15)
    exact = grip(placed, rng, fingers=4, radius=radius, bound=0.0, half_range=half)
    contacts = [replace(with_normal(placed, contact, half), position_bound_mm=0.05) for contact in exact]
    assert all(contact.touched for contact in contacts)
    catalogue = Catalogue([model])
    assert catalogue.edges(Finger(radius, 10.0)).count[0] <= 2000
    found = recognise(catalogue, contacts)
    assert holding_truth(found, placed) is not None


@pytest.mark.parametrize(
    ("kind", "radius"),
    sample(product(KINDS, (0.0, 5.0)), [("smooth", 5.0)]),
)
def test_ten_thousand_vertices(kind: str, radius: float) -> None:
    check_one_grip(flat(kind, ring(kind, 10_000)), 61, radius)
