"""Contacts of pads hold the truth: by shapely, touch by touch, and by whole recognitions."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from shapely import affinity

from palpate.base.geometry import Floats, ObjectModel
from palpate.drivers.emulators.pad import PadFace
from palpate.drivers.emulators.part import IN_PLACE
from palpate.recognizer import Catalogue, Contact, face_offsets_mm, recognise
from palpate.rig.motion.touch import dent_range_mm
from support.campaign.objects import KINDS, random_model
from support.campaign.sampling import sample
from support.oracles.pads import DrawnPad, PadTrial, face_stop_mm, outline_of, seen_along

_NOTHING_MM = 1e-6


def placed(model: ObjectModel, at: tuple[float, float, float], height_mm: float = 10.0) -> shapely.Geometry:
    """What of a part stands at a height, put at (x, y, θ)."""
    polygons = [
        shapely.Polygon(polygon.outer, polygon.holes)
        for section in model.states[0].sections_within((height_mm, height_mm))
        for polygon in section.polygons
    ]
    turned = affinity.rotate(shapely.union_all(polygons), at[2], origin=(0, 0), use_radians=True)
    return affinity.translate(turned, at[0], at[1])


def drawn(seed: int) -> tuple[np.random.Generator, ObjectModel, tuple[float, float, float]]:
    rng = np.random.default_rng([91, seed])
    model = random_model(str(rng.choice(sorted(KINDS))), rng, 2.0)
    return rng, model, (*rng.uniform(-10, 10, 2).tolist(), float(rng.uniform(-math.pi, math.pi)))


@pytest.mark.parametrize("seed", sample(range(40), range(8)))
def test_an_emulated_face_is_dented_by_what_is_behind_it(seed: int) -> None:
    rng, model, at = drawn(seed)
    part = placed(model, at)
    middle, outline = np.array(part.centroid.coords[0]), outline_of(part)
    for _ in range(25):
        angle, half = float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(2, 15))
        ahead = np.array([math.cos(angle), math.sin(angle)])
        start = middle + rng.uniform(-25, 25) * np.array([-ahead[1], ahead[0]]) - 110.0 * ahead
        stop = face_stop_mm(part, start, angle, half)
        face = PadFace(half, 5.0)
        if not math.isfinite(stop):
            assert face.press(outline, start + 100.0 * ahead, angle, IN_PLACE) is None
            continue
        assert face.press(outline, start + (stop - 1e-6) * ahead, angle, IN_PLACE) is None
        deep = float(rng.uniform(0.05, 0.6))
        press = face.press(outline, start + (stop + deep) * ahead, angle, IN_PLACE)
        assert press is not None
        assert -float(press.load.force_n @ ahead) >= 5.0 * deep * (1 - 1e-9), "as much as its deepest dent"
        behind = shapely.intersection(
            seen_along(part, start + (stop + deep) * ahead, angle), shapely.box(-9.0, -half, 0.0, half)
        )
        for across, borne in zip(press.load.across_mm.tolist(), press.load.by_place_n.tolist(), strict=True):
            if borne > 0:
                skin = shapely.LineString([(-9.0, across), (0.0, across)])
                assert behind.distance(skin) < 1e-6, "only what is dented bears"


def _touches_there(part: shapely.Geometry, contact: Contact) -> bool:
    """Whether the boundary is within a contact's bound, with a normal that it allows."""
    allowed = contact.outward_normals()
    assert allowed is not None
    for piece in shapely.get_parts(part):
        for ring in (shapely.orient_polygons(piece).exterior, *shapely.orient_polygons(piece).interiors):
            points = np.asarray(ring.coords)
            for begin, end in pairwise(points):
                way = end - begin
                outward = math.atan2(-way[0], way[1])
                inside = (outward - allowed.lo_rad) % (2 * math.pi) <= allowed.hi_rad - allowed.lo_rad
                away = shapely.LineString([begin, end]).distance(shapely.Point(contact.end_mm))
                if inside and away <= contact.position_bound_mm + _NOTHING_MM:
                    return True
    return False


def _true_way_is_within(trial: PadTrial, contact: Contact, left_mm: float, part: shapely.Geometry) -> bool:
    """Whether the place of the face that a free way stands for went free, within the way's bound."""
    begin = trial.true_start_mm + left_mm * trial.left
    end = trial.true_free_mm + left_mm * trial.left
    ahead = (end - begin) / math.dist(begin, end)
    # Where it was when the host takes it to have been at the way's end.
    stop = begin + ahead * min(math.dist(begin, end), float(ahead @ (np.array(contact.end_mm) - begin)))
    near = max(math.dist(begin, contact.start_mm), math.dist(stop, contact.end_mm))
    # It ends where the face just touches.
    free = shapely.intersection(shapely.LineString([begin, stop]), part).length < _NOTHING_MM
    return free and near <= contact.free_path_bound_mm + _NOTHING_MM


@pytest.mark.parametrize("seed", sample(range(200), range(4)))
def test_points_of_a_touched_face_hold_the_truth(seed: int) -> None:
    rng, model, at = drawn(seed)
    part, pad = placed(model, at), DrawnPad(rng)
    middle = np.array(part.centroid.coords[0])
    for _ in range(10):
        trial = pad.trial(part, middle)
        touched = [contact for contact in trial.points if contact.touched]
        assert len(touched) in ((0,) if trial.patch is None else (1, 2))
        assert all(_touches_there(part, contact) for contact in touched)
        half = pad.width_mm / 2
        places = (face_offsets_mm(half) * (half - pad.tip.radius_bound_mm) / half).tolist()
        for contact, left in zip(trial.points[len(touched) :], places, strict=True):
            assert _true_way_is_within(trial, contact, left, part)
        if trial.patch is not None:
            force = max(trial.patch.force_n, 0.4)
            _, deepest = dent_range_mm(force, trial.patch.force_bound_n, pad.tip, 8.0)
            assert trial.deepest_mm <= deepest


def holds(found: Catalogue, contacts: list[Contact], name: str, at: tuple[float, float, float]) -> bool:
    for item in recognise(found, contacts).hypotheses:
        bounds = item.bounds
        turn = (at[2] - bounds.theta_rad[0]) % (2 * math.pi) + bounds.theta_rad[0]
        same = item.state.symmetry.order > 1 or bounds.theta_rad[0] <= turn <= bounds.theta_rad[1]
        inside = all(
            lo - 1e-9 <= value <= hi + 1e-9
            for value, (lo, hi) in ((at[0], bounds.x_mm), (at[1], bounds.y_mm))
        )
        if item.state.object_name == name and same and (inside or item.state.symmetry.order > 1):
            return True
    return False


def wobbly(part: shapely.Geometry, off_mm: float, rng: np.random.Generator) -> shapely.Geometry:
    """With corners off by as much or less; as it was if it would cross itself."""

    def moved(ring: shapely.LinearRing) -> Floats:
        points = np.asarray(ring.coords)[:-1]
        return points + _within(off_mm, len(points), rng)

    pieces = [
        shapely.Polygon(moved(piece.exterior), [moved(ring) for ring in piece.interiors])
        for piece in shapely.get_parts(part)
    ]
    return shapely.union_all(pieces) if all(piece.is_valid for piece in pieces) else part


def _within(off_mm: float, count: int, rng: np.random.Generator) -> Floats:
    around = rng.uniform(-math.pi, math.pi, count)
    away = off_mm * np.sqrt(rng.uniform(size=count))
    return away[:, None] * np.column_stack([np.cos(around), np.sin(around)])


@pytest.mark.parametrize("seed", sample(range(400), range(2)))
def test_recognition_keeps_what_pads_touched(seed: int) -> None:
    rng, model, at = drawn(1000 + seed)
    _, other, _ = drawn(5000 + seed)
    off = float(rng.choice([0.0, 0.0, 0.1, 0.4]))
    model = replace(model, tolerance_mm=off)
    part, pad = wobbly(placed(model, at), off, rng), DrawnPad(rng)
    middle: Floats = np.array(part.centroid.coords[0])
    trials = [pad.trial(part, middle) for _ in range(6)]
    contacts = [contact for trial in trials for contact in trial.points]
    if sum(contact.touched for contact in contacts) < 2:
        return
    models = [model, ObjectModel("other", other.states)]
    assert holds(Catalogue(models), contacts, model.name, at)
