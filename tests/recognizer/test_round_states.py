"""Round states: circles about one centre are searched as such; the truth stays, and θ is any."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from sampling import sample
from shapely_bench import Placed, flat, grip, holding_truth, place, until_touched

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.recognizer import Catalogue, Finger, Motion, recognise

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


@pytest.mark.parametrize("seed", sample(range(25), range(9)))
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
        assert holding_truth(found.moved(motion), placed) is not None
        found = found.extend(grip(placed, rng, fingers=2, **how), motion)
        assert holding_truth(found, placed) is not None
