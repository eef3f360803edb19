"""The recogniser against programs of others: codac's interval pavings and networkx's cliques.

The contacts have no path (they start where they end) and the tip no radius. So a configuration has to satisfy
this and nothing else: every contact lies within ε of some edge whose normal its range allows. That is easily
said to codac (guaranteed set inversion with intervals) and, for two contacts at a time, to a graph.
"""

import ctypes
import ctypes.util
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from itertools import combinations, product

import networkx
import numpy as np
import pytest
import shapely

from palpate.base.geometry import Bools, Floats
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, Recognition, recognise
from palpate.recognizer.memo_statistics import memo_counts
from support.campaign.sampling import sample
from support.campaign.trials import in_polygons
from support.oracles.shapely_touches import flat

LIBM = ctypes.CDLL(ctypes.util.find_library("m"))
NEAREST = LIBM.fegetround()


@contextmanager
def rounding_put_back() -> Iterator[None]:
    """However the processor rounds meanwhile, afterwards it is to nearest again."""
    try:
        yield
    finally:
        LIBM.fesetround(NEAREST)


# Importing codac makes the processor round upward from then on, in whatever else this process computes too.
with rounding_put_back():
    import codac

    UPWARD = LIBM.fegetround()

POINT = Finger(0.0, 10.0)
LEVER_MM = 20.0  # codac's third unknown is θ times this, so that all three are lengths
SLACK_MM = 1e-5  # more than the recogniser's allowance for rounding


@dataclass(frozen=True)
class Problem:
    """A polygon (n, 2), counter-clockwise, and contacts of it at `truth` (x, y, θ)."""

    polygon: Floats
    truth: Floats
    contacts: tuple[Contact, ...]

    @property
    def ends(self) -> Floats:
        """Both ends (n, 2, 2) of every edge."""
        return np.stack([self.polygon, np.roll(self.polygon, -1, axis=0)], axis=1)

    @property
    def normals(self) -> Floats:
        """Direction (n,) rad of every edge's outward normal."""
        along = self.ends[:, 1] - self.ends[:, 0]
        return np.arctan2(-along[:, 0], along[:, 1])


# What of the recogniser is looked at, in one place.


def answered(problem: Problem) -> Recognition:
    return recognise(Catalogue([flat("it", problem.polygon)]), problem.contacts)


def pairings(answer: Recognition) -> set[tuple[int, ...]]:
    """Edges of the polygon, in the order of the contacts, of all surviving interpretations."""
    return {pairing for item in answer.hypotheses for pairing in item.features}


def covered(answer: Recognition, points: Floats) -> Bools:
    """Which configurations (m, 3) (x, y, θ) are in a cell."""
    result = np.zeros(len(points), dtype=bool)
    for item in answer.hypotheses:
        cells = item.cells
        turn = (points[:, 2:] - cells.middle + np.pi) % (2 * np.pi) - np.pi
        point, cell = np.nonzero(np.abs(turn) <= cells.half_width + 1e-9)
        away = points[point, :2] - answer.anchor_mm
        cos, sin = np.cos(points[point, 2]), np.sin(points[point, 2])
        seen = np.column_stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0]])
        position = seen + item.state.origin_mm
        inside = in_polygons(cells.polygon[cell], position[:, None])
        result[point[inside]] = True
    return result


def surviving_counts(problem: Problem) -> list[int]:
    """How many pairings the angle and distance tests leave at the second level and after it."""
    counts = memo_counts(Catalogue([flat("it", problem.polygon)]), problem.contacts)
    return [level.after_both for level in counts.levels]


# Problems.


def turned(vector: Floats, theta: float) -> Floats:
    cos, sin = math.cos(theta), math.sin(theta)
    return np.stack(
        [cos * vector[..., 0] - sin * vector[..., 1], sin * vector[..., 0] + cos * vector[..., 1]], -1
    )


def random_polygon(rng: np.random.Generator) -> Floats:
    """Three to six vertices round the origin, not always convex."""
    count = int(rng.integers(3, 7))
    angle = 2 * math.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    return rng.uniform(10.0, 30.0, count)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def random_problem(seed: int, contacts: int, *, normals: bool) -> Problem:
    """Contacts anywhere on the outline, with errors within their bounds, half of the time just at them."""
    rng = np.random.default_rng((seed, contacts, normals))
    polygon = random_polygon(rng)
    truth = np.array([*rng.uniform(-10, 10, 2), rng.uniform(-math.pi, math.pi)])
    bound = float(rng.uniform(0.2, 1.0))
    at_bound = seed % 2 == 0
    half = math.radians(float(rng.choice([3.0, 20.0, 50.0])))
    problem = Problem(polygon, truth, ())
    felt = []
    for k in range(contacts):
        edge = int(rng.integers(len(polygon)))
        begin, end = problem.ends[edge]
        part = float(rng.choice([0.0, 1.0, *rng.uniform(0, 1, 6)]))
        angle = rng.uniform(0, 2 * math.pi)
        size = bound if at_bound else bound * math.sqrt(rng.random())
        point = begin + part * (end - begin) + size * np.array([math.cos(angle), math.sin(angle)])
        at = turned(point, truth[2]) + truth[:2]
        middle = problem.normals[edge] + truth[2]
        middle += float(rng.choice([-1, 1])) * half if at_bound else float(rng.uniform(-half, half))
        given = NormalRange(middle - half, middle + half) if normals else None
        where = (float(at[0]), float(at[1]))
        felt.append(Contact(f"f{k}", POINT, True, where, where, bound, given))
    return Problem(polygon, truth, tuple(felt))


# codac.

Separator = codac.SepBase


@contextmanager
def codacs_rounding() -> Iterator[None]:
    """Rounding upward, without which codac's intervals guarantee nothing; and back again."""
    with rounding_put_back():
        LIBM.fesetround(UPWARD)
        yield


def test_rounding_is_to_nearest() -> None:
    assert LIBM.fegetround() == NEAREST
    assert 1.0 + 1e-17 == 1.0
    with codacs_rounding():
        assert LIBM.fegetround() == UPWARD != NEAREST
    assert LIBM.fegetround() == NEAREST


def seen_from_object(contact: Contact) -> codac.AnalyticFunction_Vector:
    """(x, y, θ·lever) ↦ the contact in the object's frame."""
    at = codac.VectorVar(3)
    cos, sin = codac.cos(at[2] / LEVER_MM), codac.sin(at[2] / LEVER_MM)
    x, y = contact.end_mm[0] - at[0], contact.end_mm[1] - at[1]
    return codac.AnalyticFunction([at], codac.vec(cos * x + sin * y, cos * y - sin * x))


def orientations(contact: Contact, normal_rad: float, slack: float) -> Separator | None:
    """Where the edge's normal, turned by θ, is in the contact's range; None if there is no range."""
    if contact.normal is None:
        return None
    middle = (contact.normal.lo_rad + contact.normal.hi_rad) / 2
    half = (contact.normal.hi_rad - contact.normal.lo_rad) / 2 + slack
    at = codac.VectorVar(3)
    ahead = codac.AnalyticFunction([at], codac.cos(at[2] / LEVER_MM + (normal_rad - middle)))
    return codac.SepInverse(ahead, codac.Interval(math.cos(half), 2.0))


def possible(problem: Problem, around: Callable[[Floats, float], Floats], slack: float) -> Separator:
    """Configurations in which every contact is in the polygon `around` (ends, ε) of an allowed edge."""
    return reduce(codac.SepInter, [_one(problem, contact, around, slack) for contact in problem.contacts])


def _one(
    problem: Problem, contact: Contact, around: Callable[[Floats, float], Floats], slack: float
) -> Separator:
    seen = seen_from_object(contact)
    near = []
    for ends, normal in zip(problem.ends, problem.normals, strict=True):
        vertices = [codac.Vector(vertex.tolist()) for vertex in around(ends, contact.position_bound_mm)]
        here = codac.SepInverse(seen, codac.SepPolygon(vertices))
        turn = orientations(contact, float(normal), slack)
        near.append(here if turn is None else codac.SepInter(here, turn))
    return reduce(codac.SepUnion, near)


def within(ends: Floats, bound: float) -> Floats:
    """All within ε of the edge, its round ends as octagons inside of them."""
    capsule = shapely.LineString(ends).buffer(bound, quad_segs=2)
    return shapely.get_coordinates(capsule)[:-1]


def rectangle(ends: Floats, bound: float) -> Floats:
    """The rectangle that the recogniser puts in its place, a little larger."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    aside, size = np.array([along[1], -along[0]]), bound + SLACK_MM
    begin, end = ends[0] - size * along, ends[1] + size * along
    return np.array([begin + size * aside, end + size * aside, end - size * aside, begin - size * aside])


def box_of(low: Floats, high: Floats) -> codac.IntervalVector:
    return codac.IntervalVector([[float(a), float(b)] for a, b in zip(low, high, strict=True)])


def sampled(boxes: list[codac.IntervalVector], rng: np.random.Generator, most: int) -> Floats:
    """The middles of some boxes and a corner of each: configurations (m, 3)."""
    boxes = [box for box in boxes if not box.is_empty()]
    if not boxes:
        return np.empty((0, 3))
    chosen = [boxes[k] for k in rng.permutation(len(boxes))[:most]]
    low = np.array([[side.lb() for side in box] for box in chosen])
    high = np.array([[side.ub() for side in box] for box in chosen])
    points = np.concatenate([(low + high) / 2, low + rng.choice([0.0, 1.0], low.shape) * (high - low)])
    points[:, 2] /= LEVER_MM
    return points


def satisfied(problem: Problem, points: Floats) -> Bools:
    """Whether configurations (m, 3) hold, by plain arithmetic: what codac says is not taken on trust."""
    result = np.ones(len(points), dtype=bool)
    for contact in problem.contacts:
        away = np.array(contact.end_mm) - points[:, :2]
        cos, sin = np.cos(points[:, 2]), np.sin(points[:, 2])
        seen = np.column_stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0]])
        lines = shapely.linestrings(problem.ends)
        near = shapely.distance(shapely.points(seen)[:, None], lines) <= contact.position_bound_mm + 1e-9
        if contact.normal is not None:
            turn = problem.normals + points[:, 2:] - contact.normal.lo_rad + 1e-9
            near &= turn % (2 * np.pi) <= contact.normal.hi_rad - contact.normal.lo_rad + 2e-9
        result &= near.any(axis=1)
    return result


PROBLEMS = [
    (seed, contacts, normals) for contacts in (2, 3, 4) for normals in (False, True) for seed in range(24)
]


@pytest.mark.parametrize("part", sample(range(12), range(2)))
def test_cells_cover_what_codac_proves_inside(part: int) -> None:
    """In a window about the truth, moved at random so that it reaches over the region's borders."""
    proven = 0
    for seed, contacts, normals in PROBLEMS[part::12]:
        problem = random_problem(seed, contacts, normals=normals)
        answer = answered(problem)
        rng = np.random.default_rng(seed)
        size = problem.contacts[0].position_bound_mm
        middle = problem.truth * (1, 1, LEVER_MM) + rng.uniform(-size, size, 3) / 2
        window = box_of(middle - 1.2 * size, middle + 1.2 * size)
        with codacs_rounding():
            paving = codac.pave(window, possible(problem, within, 0.0), 0.6 * size)
        points = sampled(paving.boxes(codac.PavingInOut.inner), rng, 60)
        points = np.concatenate([points, problem.truth[None]])
        assert satisfied(problem, points).all()
        assert covered(answer, points).all(), (seed, contacts, normals)
        proven += len(points) - 1
    assert proven > 200


@pytest.mark.parametrize("part", sample(range(6), range(3)))
def test_codac_excludes_no_reported_configuration(part: int) -> None:
    """Each verified configuration stays in codac's guaranteed outer set; so each region meets its paving."""
    seen = 0
    for seed, contacts, normals in PROBLEMS[part::6]:
        problem = random_problem(seed, contacts, normals=normals)
        with codacs_rounding():
            allowed = possible(problem, rectangle, 1e-6)
        for item in answered(problem).hypotheses:
            if not item.verified:
                continue
            found = item.configuration
            at = np.array([found.x_mm, found.y_mm, found.theta_rad * LEVER_MM])
            with codacs_rounding():
                outer = allowed.separate(box_of(at - 1e-9, at + 1e-9)).outer
            assert not outer.is_empty(), (seed, contacts, normals, item.features)
            seen += 1
    assert seen > 36


@pytest.mark.parametrize("seed", sample(range(8), range(3)))
def test_whole_paving_meets_every_region(seed: int) -> None:
    """Coarse, but of all configurations: what codac cannot exclude, and what it proves, everywhere."""
    problem = random_problem(seed, 3, normals=True)
    answer = answered(problem)
    reach = 80.0
    everything = box_of(np.array([-reach, -reach, -63.0]), np.array([reach, reach, 63.0]))
    with codacs_rounding():
        paving = codac.pave(everything, possible(problem, rectangle, 1e-6), 0.4)
    boxes = paving.boxes(codac.PavingInOut.outer)
    low = np.array([[side.lb() for side in box] for box in boxes])
    high = np.array([[side.ub() for side in box] for box in boxes])
    for item in answer.hypotheses:
        if not item.verified:
            continue
        bounds = item.bounds
        ranges = np.array([bounds.x_mm, bounds.y_mm, np.multiply(bounds.theta_rad, LEVER_MM)])
        turns = 2 * np.pi * LEVER_MM * np.arange(-1, 2)[:, None, None] * np.array([0.0, 0.0, 1.0])
        meets = (low + turns <= ranges[:, 1]) & (high + turns >= ranges[:, 0])
        assert meets.all(axis=2).any(), item.features
    rng = np.random.default_rng(seed)
    points = sampled(boxes, rng, 2000)
    held = points[satisfied(problem, points)]
    assert covered(answer, held).all()


# networkx.


def arcs_meet(arcs: list[tuple[float, float]]) -> bool:
    """Whether arcs (lo, width) have a common direction: then one of their beginnings is in all of them."""
    return any(
        all((begin - lo + 1e-9) % (2 * math.pi) <= width + 2e-9 for lo, width in arcs) for begin, _ in arcs
    )


def arc_of(problem: Problem, contact: int, edge: int) -> tuple[float, float]:
    """Orientations at which the edge's normal is in the contact's range."""
    normal = problem.contacts[contact].normal
    assert normal is not None
    return normal.lo_rad - float(problem.normals[edge]), normal.hi_rad - normal.lo_rad


def chords_fit(problem: Problem, one: tuple[int, int], two: tuple[int, int]) -> bool:
    """Whether two points of two edges can be as far apart as two contacts, give or take both bounds."""
    a, b = problem.contacts[one[0]], problem.contacts[two[0]]
    first, second = problem.ends[one[1]], problem.ends[two[1]]
    nearest = shapely.distance(shapely.LineString(first), shapely.LineString(second))
    furthest = max(float(np.linalg.norm(p - q)) for p, q in product(first, second))
    bound = a.position_bound_mm + b.position_bound_mm
    return bool(nearest - bound <= math.dist(a.end_mm, b.end_mm) <= furthest + bound)


def consistent_pairs(problem: Problem, contacts: int) -> networkx.Graph:
    """Nodes (contact, edge), links between those that pass the tests of angle and of distance."""
    nodes = [(contact, edge) for contact in range(contacts) for edge in range(len(problem.polygon))]
    graph = networkx.Graph()
    graph.add_nodes_from(nodes)
    for one, two in combinations(nodes, 2):
        if (
            one[0] != two[0]
            and arcs_meet([arc_of(problem, *one), arc_of(problem, *two)])
            and chords_fit(problem, one, two)
        ):
            graph.add_edge(one, two)
    return graph


def cliques(problem: Problem, contacts: int) -> set[tuple[int, ...]]:
    """Pairings of the first contacts, every two of which are consistent."""
    found = networkx.find_cliques(consistent_pairs(problem, contacts))
    return {tuple(edge for _, edge in sorted(clique)) for clique in found if len(clique) == contacts}


def with_common_orientation(problem: Problem, found: set[tuple[int, ...]]) -> set[tuple[int, ...]]:
    return {
        pairing
        for pairing in found
        if arcs_meet([arc_of(problem, contact, edge) for contact, edge in enumerate(pairing)])
    }


def clearly_possible(problem: Problem, pairing: tuple[int, ...]) -> bool:
    """Whether the contacts fit their edges at some θ of a grid, each in the rectangle round its edge."""
    middle_of = [(lo + width / 2, width / 2) for lo, width in map(arc_of, [problem] * 9, range(9), pairing)]
    grid = middle_of[0][0] + np.linspace(-1, 1, 400) * middle_of[0][1]
    for middle, half in middle_of:
        grid = grid[np.cos(grid - middle) >= math.cos(half)]
    if not len(grid):
        return False
    common = None
    for contact, edge in zip(problem.contacts, pairing, strict=True):
        corners = rectangle(problem.ends[edge], contact.position_bound_mm - 2 * SLACK_MM)
        seen = np.stack([turned(np.array(contact.end_mm), -float(theta)) for theta in grid])
        # s = R(−θ) P − q, for all q in the rectangle.
        allowed = shapely.polygons(seen[:, None] - corners)
        common = allowed if common is None else shapely.intersection(common, allowed)
    return bool(np.any(~shapely.is_empty(common)))


@pytest.mark.parametrize("seed", range(40))
def test_pairs_and_cliques(seed: int) -> None:
    """The pruned tree is what the graph says: links at the second level, cliques with a common θ after it."""
    problem = random_problem(seed, 4, normals=True)
    counts = surviving_counts(problem)
    for contacts, count in zip((2, 3, 4), counts, strict=True):
        found = cliques(problem, contacts)
        if contacts == 2:
            assert len(found) == count
        assert len(with_common_orientation(problem, found)) == count


@pytest.mark.parametrize("seed", sample(range(20), range(6)))
@pytest.mark.parametrize("contacts", [2, 3, 4])
def test_answers_are_cliques_and_miss_none_that_is_possible(seed: int, contacts: int) -> None:
    problem = random_problem(seed, contacts, normals=True)
    survivors = pairings(answered(problem))
    found = cliques(problem, contacts)
    assert survivors <= with_common_orientation(problem, found)
    for pairing in found - survivors:
        assert not clearly_possible(problem, pairing)
