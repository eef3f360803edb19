"""Catalogue: every state of every object, grown for each kind of finger, in flat arrays.

Work done once per catalogue and kept: grown edges sorted by normal within a state (`edges`), and the ranges
of distance between the edges of each state (`pairs`). Object models that were made without a file are checked
first: clear errors instead of obscure geometry.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints, ObjectModel, Polygon, Section, State
from palpate.base.geometry.object_model import LEARNED_HEIGHT_MM
from palpate.recognizer.angle_pockets import Pockets, conservative_pockets
from palpate.recognizer.contact import LARGEST_MM, Finger
from palpate.recognizer.edges import ROUNDING_MM, CatalogueState, EdgeSet
from palpate.recognizer.grown_edges import ROUND_ORDER, outline_set, pairing_set
from palpate.recognizer.preparation import FingerPreparation
from palpate.recognizer.strip_trees import StripForest, strip_forest
from palpate.recognizer.symmetry import centroid, rotational_symmetry, symmetrise
from palpate.recognizer.tip_obstacle import is_exact
from palpate.recognizer.true_boundary import TrueBoundary, true_boundary

_SMALLEST_MM2, _THINNEST_MM = 1e-9, 2e-7


def _check_model(item: ObjectModel) -> None:
    """Raise InputError, naming the object and the place, unless everything about it is in order."""
    if not (math.isfinite(item.tolerance_mm) and 0 <= item.tolerance_mm <= LARGEST_MM):
        raise InputError(
            f"object {item.name}: the tolerance must be from 0 to {LARGEST_MM:g} mm, "
            f"not {item.tolerance_mm:g}"
        )
    if not item.states:
        raise InputError(f"object {item.name} has no state: at least one is needed")
    for state in item.states:
        place = f"object {item.name}, state {state.name}"
        if not state.sections:
            raise InputError(f"{place} has no cross section: at least one is needed")
        for section in state.sections:
            _check_section(section, place)


def _check_section(section: Section, place: str) -> None:
    low, high = section.z_mm
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"{place}: the heights of a cross section must be finite")
    if low > high:
        raise InputError(f"{place}: a cross section must run upwards, not from {low:g} to {high:g} mm")
    if not section.polygons:
        raise InputError(f"{place}: a cross section has no polygon: at least one is needed")
    for polygon in section.polygons:
        _check_polygon(polygon, place)


def _check_polygon(polygon: Polygon, place: str) -> None:
    for ring in polygon.rings:
        _check_ring(ring, place)
    shape = shapely.Polygon(polygon.outer, polygon.holes)
    if not shape.is_valid:
        raise InputError(f"{place}: an outline is no simple polygon: {shapely.is_valid_reason(shape)}")
    if shape.area < max(_SMALLEST_MM2, _THINNEST_MM * shape.length):
        raise InputError(f"{place}: an outline encloses no area")


def _check_ring(ring: Floats, place: str) -> None:
    if ring.ndim != 2 or ring.shape[1] != 2 or len(np.unique(ring, axis=0)) < 3:
        raise InputError(f"{place}: an outline needs at least three different points (x, y)")
    if not np.all(np.isfinite(ring)) or float(np.abs(ring).max()) > LARGEST_MM:
        raise InputError(f"{place}: coordinates must be finite and within ±{LARGEST_MM:g} mm")


FACET_ERROR_MM = 0.1
"""By how much an arc may bulge over its facet, where nothing else is said."""


SYMMETRY_TOLERANCE_MM = 1e-3
_TRAVEL_STEP_MM = 20.0
_LEAST_PRIOR = 1e-3  # a part may have been put as it hardly falls
_MAX_ADDED_TOLERANCE_SHARE = 0.01  # of a state's tolerance
_MAX_FLAT_EDGES = 600  # of a state: larger ones are searched by strip trees


class Catalogue:
    """Known objects, prepared. Grown edges are made when a finger first needs them.

    `facet_error_mm`: how far an arc may bulge over its facet; part of the error bound, so small, but every
    halving makes the arcs' facets 1.4 times as many. States with more than `flat_edges` edges are searched by
    strip trees (memo §3.3). `states`: of the objects, where `prepare_states` has given them already.
    `reach_mm` (S,): each state lies within this distance of its centroid. `prior` (S,): probability of each
    state of its object; where that is not known of all of them, they are equally frequent. Raises InputError
    for an empty catalogue.
    """

    def __init__(
        self,
        objects: Sequence[ObjectModel],
        *,
        facet_error_mm: float = FACET_ERROR_MM,
        flat_edges: int = _MAX_FLAT_EDGES,
        states: Sequence[CatalogueState] | None = None,
    ) -> None:
        if not objects:
            raise InputError("the catalogue is empty: at least one object is needed")
        if not 1e-6 <= facet_error_mm <= 1.0:
            raise InputError(f"the facet error must be from 1e-6 to 1 mm, not {facet_error_mm:g}")
        self.states: tuple[CatalogueState, ...] = tuple(prepare_states(objects) if states is None else states)
        self.symmetry_orders: Ints = np.array([state.symmetry.order for state in self.states])
        self.origins_mm: Floats = np.array([state.origin_mm for state in self.states])
        self.reach_mm: Floats = np.array([_reach_mm(state) for state in self.states])
        self.prior: Floats = _priors(self.states)
        self.facet_error_mm = facet_error_mm
        self.flat_edges = flat_edges
        self._edges: dict[Finger, EdgeSet] = {}
        self._outlines: dict[Finger, EdgeSet] = {}
        self._outline_strips: dict[Finger, StripForest] = {}
        self._strips: dict[Finger, StripForest] = {}
        self._boundaries: dict[Finger, TrueBoundary] = {}
        self._tolerant: dict[Finger, Bools] = {}
        self._pockets: dict[tuple[Finger, float, float], Pockets] = {}

    def __repr__(self) -> str:
        objects = len({state.object_name for state in self.states})
        return f"<Catalogue {len(self.states)} states of {objects} objects>"

    def take(self, finger: Finger, preparation: FingerPreparation) -> None:
        """Use what is prepared of these states for a finger already."""
        _check_tip(self.states, finger)
        self._outlines[finger] = preparation.outlines
        self._edges[finger] = preparation.edges
        self._boundaries[finger] = preparation.boundary

    def edges(self, finger: Finger) -> EdgeSet:
        """The edges that a contact of `finger` may be paired with."""
        if finger not in self._edges:
            outlines = self.outlines(finger)
            self._edges[finger] = pairing_set(self.states, finger, self.facet_error_mm, outlines)
        return self._edges[finger]

    def outlines(self, finger: Finger) -> EdgeSet:
        """The grown outlines that stop `finger` on its way: the edges, but for objects with a tolerance."""
        if finger not in self._outlines:
            _check_tip(self.states, finger)
            self._outlines[finger] = outline_set(self.states, finger, self.facet_error_mm)
        return self._outlines[finger]

    def boundary(self, finger: Finger) -> TrueBoundary:
        """Curves on which the centre of `finger` lies when it touches, with true arcs: for `verification`."""
        if finger not in self._boundaries:
            self._boundaries[finger] = true_boundary(self.states, finger)
        return self._boundaries[finger]

    def has_tolerance(self, finger: Finger) -> Bools:
        """Mask of states (S,) whose outlines, as a finger meets them, may be off by more than rounding."""
        if finger not in self._tolerant:
            self._tolerant[finger] = np.array([not is_exact(state, finger) for state in self.states])
        return self._tolerant[finger]

    def strips(self, finger: Finger) -> StripForest:
        """Strip trees over the edges that `finger` can meet, for states with more than `flat_edges`."""
        if finger not in self._strips:
            edges = self.edges(finger)
            self._strips[finger] = strip_forest(edges, edges.count > self.flat_edges)
        return self._strips[finger]

    def outline_strips(self, finger: Finger) -> StripForest:
        """Strip trees over the outlines, for states with more than `flat_edges`."""
        if self.outlines(finger) is self.edges(finger):
            return self.strips(finger)
        if finger not in self._outline_strips:
            outlines = self.outlines(finger)
            self._outline_strips[finger] = strip_forest(outlines, outlines.count > self.flat_edges)
        return self._outline_strips[finger]

    def pockets(self, finger: Finger, allowance_mm: float, travel_mm: float) -> Pockets:
        """Conservative angle pockets of all edges that `finger` can meet (memo §2.2.2).

        They are made for an allowance that is rounded up and a travel that is rounded down, so that a few
        serve all contacts.
        """
        allowance = 0.0 if allowance_mm == 0 else 2.0 ** (math.ceil(2 * math.log2(allowance_mm)) / 2)
        travel = math.floor(travel_mm / _TRAVEL_STEP_MM) * _TRAVEL_STEP_MM
        key = (finger, allowance, travel)
        if key not in self._pockets:
            self._pockets[key] = conservative_pockets(self.edges(finger), allowance, travel)
        return self._pockets[key]


def _check_tip(states: Sequence[CatalogueState], finger: Finger) -> None:
    """Raise InputError for a tip that may feel more, or less, of a part than those that learned it."""
    for item in states:
        least = item.least_tip_radius_mm
        if least is None:
            continue
        if finger.tip_radius_mm < least:
            raise InputError(
                f"{item.object_name} was learned with tips of radius {least:g} mm, and one of "
                f"{finger.tip_radius_mm:g} mm may feel more: learn it with that tip, or leave it out"
            )
        for section in item.state.sections_within(finger.span_mm):
            apart = np.abs(np.minimum(finger.span_mm, item.state.top_mm) - section.z_mm).max()
            if apart > LEARNED_HEIGHT_MM + ROUNDING_MM:
                raise InputError(
                    f"{item.object_name} was learned by tips between {section.z_mm[0]:g} and "
                    f"{section.z_mm[1]:g} mm above the table, and others, from {finger.span_mm[0]:g} to "
                    f"{finger.span_mm[1]:g} mm, may feel less: learn it with these, or leave it out"
                )


def prepare_states(objects: Sequence[ObjectModel]) -> list[CatalogueState]:
    """Check objects and find the symmetry of every state. Raises InputError for an object that is wrong."""
    for item in objects:
        _check_model(item)
    return [_prepare_state(item, state) for item in objects for state in item.states]


def _priors(states: Sequence[CatalogueState]) -> Floats:
    """Probability of each state (S,) of its object."""
    known: dict[str, list[float | None]] = {}
    for item in states:
        known.setdefault(item.object_name, []).append(item.state.probability)

    def of(item: CatalogueState) -> float:
        found = [value for value in known[item.object_name] if value is not None]
        count, total = len(known[item.object_name]), sum(found)
        if len(found) < count or total <= 0:
            return 1.0 / count
        return max(item.state.probability or 0.0, _LEAST_PRIOR) / total

    return np.array([of(item) for item in states])


def _reach_mm(item: CatalogueState) -> float:
    """Largest distance of the part's outline from its centroid, at any height."""
    vertices = np.concatenate([ring for section in item.state.sections for ring in section.rings])
    return float(np.hypot(*(vertices - item.origin_mm).T).max()) + item.tolerance_mm + item.rounding_mm


def _prepare_state(item: ObjectModel, state: State) -> CatalogueState:
    origin = centroid(state)
    symmetry = rotational_symmetry(state, origin, SYMMETRY_TOLERANCE_MM)
    if state.is_round:
        symmetry = replace(symmetry, order=ROUND_ORDER)
    prepared = CatalogueState(
        item.name,
        state,
        origin,
        symmetry,
        item.tolerance_mm + state.curves_off_mm,
        item.holds_n,
        item.support_mm,
        _normal_bound_rad(item, state),
        item.least_tip_radius_mm,
    )
    return _with_exact_symmetry(prepared) if symmetry.order > 1 else prepared


def _normal_bound_rad(item: ObjectModel, state: State) -> float | None:
    """Largest deviation of normals from those of the polygons that stand for curves; None: not declared."""
    declared = item.normal_bound_rad if state.normal_bound_rad is None else state.normal_bound_rad
    return None if declared is None else declared + state.curves_turn_rad


def _with_exact_symmetry(item: CatalogueState) -> CatalogueState:
    """The state made exactly symmetric, at the price of a little more tolerance, where it has much already.

    Only then is one edge of each orbit enough. A vertex that is off by e more, on an edge of length L, turns
    its normals by up to 2e / L more: with twice e added to the tolerance δ, asin(4δ/L) covers that.
    """
    off = 2 * item.symmetry.off_mm
    if item.is_exactly_symmetric or off > _MAX_ADDED_TOLERANCE_SHARE * item.tolerance_mm:
        return item
    order = item.symmetry.order
    state = symmetrise(item.state, item.origin_mm, order, SYMMETRY_TOLERANCE_MM)
    if state is None:
        return item
    turn = item.normal_bound_rad
    exact = replace(
        item,
        state=state,
        symmetry=rotational_symmetry(state, item.origin_mm, SYMMETRY_TOLERANCE_MM),
        tolerance_mm=item.tolerance_mm + off,
        normal_bound_rad=None if turn is None else turn + item.symmetry.lean_rad,
    )
    return exact if exact.is_exactly_symmetric and exact.symmetry.order == order else item
