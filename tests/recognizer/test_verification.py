"""What is called verified is true, by a judge of its own; and what is true can be verified."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, recognise
from palpate.recognizer.interpretations import Query
from palpate.recognizer.verification import Nearness, Poses, Verification, may_fit, verify
from support.campaign.objects import objects_of
from support.oracles.judge import Scene, asked, catalogue_of, drawn, objections, refused
from support.oracles.shapely_touches import flat, grip, holding_truth, place, turned, until_touched

KITE = flat("kite", [(-30, 0), (0, -14), (34, 0), (0, 22)])
FORK = flat(
    "fork", [(0, 0), (50, 0), (50, 40), (43, 40), (43, 12), (34, 30), (26, 9), (19, 9), (19, 33), (0, 40)]
)
FINNED = flat("finned", [(0, 0), (60, 0), (60, 10), (30.2, 10), (30.2, 50), (30, 50), (30, 10), (0, 10)])


def at_configuration(
    catalogue: Catalogue, state: int, at: tuple[float, float, float], contacts: list[Contact]
) -> Verification:
    """What the check says of an object at (x, y, θ)."""
    anchor = np.array([3.0, -2.0])
    centre = np.array(at[:2]) + turned(catalogue.origins_mm[state], at[2])
    position = turned(centre - anchor, -at[2])
    poses = Poses(np.array([state]), np.array([at[2]]), position[None])
    return verify(Query(catalogue, contacts, anchor), poses)


def verified_at(model: ObjectModel, at: tuple[float, float, float], contacts: list[Contact]) -> bool:
    return bool(at_configuration(Catalogue([model]), 0, at, contacts).holds[0])


def contact(
    end: tuple[float, float],
    heading_deg: float,
    radius: float,
    bound: float,
    *,
    normal_deg: tuple[float, float] | None = None,
    travel: float = 30.0,
    touched: bool = True,
) -> Contact:
    """One that comes straight to `end`; without `normal_deg` its normal is within 20° of the way back."""
    heading = math.radians(heading_deg)
    start = (end[0] - travel * math.cos(heading), end[1] - travel * math.sin(heading))
    lo, hi = normal_deg or (heading_deg + 160.0, heading_deg + 200.0)
    normal = NormalRange(math.radians(lo), math.radians(hi)) if touched else None
    return Contact("f", Finger(radius, 10.0), touched, start, end, bound, normal)


@pytest.mark.parametrize("part", range(3))
def test_a_judge_refuses_no_verified_configuration(part: int) -> None:
    seen = 0
    for index in range(12 * part, 12 * part + 12):
        scene = drawn(77, index, ("memo",))
        answer = asked(scene)
        assert refused(scene, answer) == [], index
        seen += int(answer.hypotheses.verified.sum())
    assert seen > 20


@pytest.mark.parametrize("model", [KITE, FORK], ids=["kite", "fork"])
def test_corners_of_rectangles_are_not_within_the_bound(model: ObjectModel) -> None:
    catalogue = Catalogue([model])
    rng = np.random.default_rng(12)
    for _ in range(12):
        placed = place(model, rng)
        contacts = until_touched(grip, placed, rng, fingers=2, radius=6.0, at_bound=True)
        for item in recognise(catalogue, contacts).hypotheses:
            if item.verified:
                assert objections(item.state.state, 0.0, item.configuration, contacts) == []


def test_the_bound_is_a_disc_about_true_arcs() -> None:
    corner, radius, bound = np.array([34.0, 0.0]), 5.0, 0.3
    for angle in (-0.15, 0.0, 0.1):
        outward = np.array([math.cos(angle), math.sin(angle)])
        for away, holds in ((bound - 1e-5, True), (bound + 1e-5, False)):
            end = corner + (radius + away) * outward
            felt = contact((float(end[0]), float(end[1])), 180.0, radius, bound)
            assert verified_at(KITE, (0.0, 0.0, 0.0), [felt]) == holds


def test_the_bound_is_round_at_the_end_of_an_edge() -> None:
    square = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])
    for share, holds in ((0.70, True), (0.72, False)):
        # Only the face's normal is allowed: its place ends at y = 20.
        end = (25.0 + 0.3 * share, 20.0 + 0.3 * share)
        felt = contact(end, 180.0, 5.0, 0.3, normal_deg=(-10.0, 0.0))
        assert verified_at(square, (0.0, 0.0, 0.0), [felt]) == holds


def test_normals_are_those_of_the_place_itself() -> None:
    end = (34.0 + 5.0, 0.0)
    for lo, holds in ((0.0, True), (3.0, True), (4.0, False)):
        felt = contact(end, 180.0, 5.0, 0.3, normal_deg=(lo, lo + 10.0))
        assert verified_at(KITE, (0.0, 0.0, 0.0), [felt]) == holds


@pytest.mark.parametrize("radius", [0.0, 0.05])
def test_no_path_goes_through_a_thin_wall(radius: float) -> None:
    """Every point of the path is nearer to an edge than the bound; there is no way round the fin even so."""
    through = contact((45.0, 30.0), 0.0, radius, 0.3, touched=False)
    beside = contact((29.8, 30.0), 0.0, radius, 0.3, touched=False)
    assert not verified_at(FINNED, (0.0, 0.0, 0.0), [through])
    assert verified_at(FINNED, (0.0, 0.0, 0.0), [beside])
    assert objections(FINNED.states[0], 0.0, _origin(), [through]) == ["path of f"]
    assert objections(FINNED.states[0], 0.0, _origin(), [beside]) == []


def _origin() -> object:
    catalogue = Catalogue([FINNED])
    item = recognise(catalogue, [contact((-5.0, 5.0), 0.0, 5.0, 0.3)]).hypotheses[0]
    return replace(item.configuration, x_mm=0.0, y_mm=0.0, theta_rad=0.0)


def test_a_path_may_be_moved_by_its_bound_only() -> None:
    for depth, holds in ((0.29, True), (0.31, False)):
        passing = contact((30.0, 10.0 + 4.0 - depth), 0.0, 4.0, 0.3, travel=20.0, touched=False)
        assert (
            verified_at(flat("bar", [(0, 0), (60, 0), (60, 10), (0, 10)]), (0.0, 0.0, 0.0), [passing])
            == holds
        )


def truth_of(scene: Scene) -> tuple[Catalogue, int, tuple[float, float, float]]:
    catalogue, placed = catalogue_of(scene.family, scene.tolerance_mm), scene.placed
    names = [state.object_name for state in catalogue.states]
    return catalogue, names.index(placed.model.name), (placed.x, placed.y, placed.theta)


@pytest.mark.parametrize("part", range(3))
def test_the_truth_can_be_verified(part: int) -> None:
    """Errors are at their bounds in half of the scenes; of some the outline is off by the tolerance."""
    for index in range(100 * part, 100 * part + 100):
        scene = drawn(78, index, ("memo",))
        catalogue, state, at = truth_of(scene)
        assert at_configuration(catalogue, state, at, list(scene.contacts)).holds[0], index


def test_hypotheses_that_hold_the_truth_are_nearly_always_verified() -> None:
    held = []
    for index in range(30):
        scene = drawn(79, index, ("memo",))
        found = holding_truth(asked(scene), scene.placed)
        held.append(found is not None and found.verified)
    assert np.mean(held) > 0.9


def test_nothing_fits_where_nothing_may_fit() -> None:
    """Regions without hope hold no configuration that satisfies all contacts."""
    rng = np.random.default_rng(5)
    catalogue = Catalogue([KITE, FORK])
    placed = place(KITE, rng)
    contacts = until_touched(grip, placed, rng, fingers=3)
    anchor = np.zeros(2)
    count, spread = 400, 60
    poses = Poses(
        rng.integers(0, 2, count), rng.uniform(-np.pi, np.pi, count), rng.uniform(-30, 30, (count, 2))
    )
    true = turned(
        np.array([placed.x, placed.y]) + turned(catalogue.origins_mm[0], placed.theta), -placed.theta
    )
    poses.state[:40], poses.theta[:40] = 0, placed.theta + rng.uniform(-0.1, 0.1, 40)
    poses.position[:40] = true + rng.uniform(-1, 1, (40, 2))
    turn, shift = np.full(count, 0.1), np.full(count, 1.5)
    hope = may_fit(Query(catalogue, contacts, anchor), poses, Nearness(turn, shift))
    assert hope[:40].all()
    assert not hope.all()
    row = np.repeat(np.flatnonzero(~hope), spread)
    near = Poses(
        poses.state[row],
        poses.theta[row] + rng.uniform(-0.1, 0.1, len(row)),
        poses.position[row] + rng.uniform(-1, 1, (len(row), 2)),
    )
    assert not verify(Query(catalogue, contacts, anchor), near).fits.all(axis=1).any()


@pytest.mark.parametrize("radius", [0.0, 0.7, 3.3, 4.9, 9.0])
def test_boundary_is_that_of_the_grown_section(radius: float) -> None:
    """As long as shapely's, and everywhere just a radius away; with notches narrower than the tip."""
    models = [KITE, FORK, FINNED, *objects_of("own")]
    catalogue = Catalogue(models)
    for height in (5.0, 18.0):
        boundary = catalogue.boundary(Finger(radius, height))
        for number, item in enumerate(catalogue.states):
            shape = shapely.union_all(
                [
                    shapely.Polygon(
                        polygon.outer - item.origin_mm, [h - item.origin_mm for h in polygon.holes]
                    )
                    for section in item.state.sections_at(height)
                    for polygon in section.polygons
                ]
            )
            if shape.is_empty:
                continue
            pieces = boundary.pieces.select(boundary.pieces.state == number)
            for share in np.linspace(0.0, 1.0, 5):
                centres = shapely.points(pieces.centres(share * pieces.size, radius))
                away = shapely.distance(shape, centres)
                np.testing.assert_allclose(away, radius, atol=2e-7)
            length = float(np.where(pieces.is_face, pieces.length, radius * pieces.turn_rad).sum())
            grown = shape.buffer(radius, quad_segs=1000) if radius else shape
            assert length == pytest.approx(grown.length, abs=1e-3)


def test_normals_may_be_off_by_what_the_object_states() -> None:
    bar = flat("bar", [(0, 0), (60, 0), (60, 10), (0, 10)])
    felt = contact((30.0, -4.0), 90.0, 4.0, 0.1, normal_deg=(-83.0, -80.0))
    for stated, holds in ((None, False), (math.radians(5.0), False), (math.radians(8.0), True)):
        loose = replace(bar, tolerance_mm=0.05, normal_bound_rad=stated)
        assert verified_at(loose, (0.0, 0.0, 0.0), [felt]) == holds
