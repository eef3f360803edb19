"""Outlines coarser than they came: nothing of the original is outside of what the coarse edges state."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from sampling import sample
from shapely_bench import flat, grip, holding_truth, place

from palpate.base.geometry import ObjectModel, Polygon, Section
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Finger, NormalRange
from palpate.recognizer.minkowski import GrownSection, grow, simplify_outline
from palpate.recognizer.recognition import recognise

KINDS = ("smooth", "wavy", "noisy")
SECTIONS = list(product((400, 60), KINDS, (0.0, 5.0)))
FEW = [
    (n, most, *rest)
    for n, most in ((900, 400), (900, 60), (6000, 2000))
    for rest in product(KINDS, (0.0, 5.0))
]


def ring(kind: str, vertices: int, size: float = 1.0, seed: int = 0) -> np.ndarray:
    a = 2 * np.pi * np.arange(vertices) / vertices
    radius = 60 + 6 * np.sin(3 * a + 1) + 3 * np.cos(7 * a)
    if kind == "wavy":
        radius = radius + np.sin(vertices // 6 * a)
    if kind == "noisy":
        radius = radius + np.random.default_rng(seed).uniform(-0.5, 0.5, vertices)
    return size * radius[:, None] * np.column_stack([np.cos(a), np.sin(a)])


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
    contacts = []
    for contact in grip(placed, rng, fingers=4, radius=radius, bound=0.0, half_range=half):
        given = contact
        if contact.normal is None:
            boundary = np.asarray(placed.shape.exterior.coords)
            middle = (boundary[1:] + boundary[:-1]) / 2
            nearest = int(np.argmin(np.hypot(*(middle - contact.end_mm).T)))
            x, y = boundary[nearest + 1] - boundary[nearest]
            ccw = placed.shape.exterior.is_ccw
            normal = math.atan2(-x, y) if ccw else math.atan2(x, -y)
            given = replace(contact, normal=NormalRange(normal - half, normal + half))
        contacts.append(replace(given, position_bound_mm=0.05))
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
