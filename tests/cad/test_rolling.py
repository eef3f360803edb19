"""Parts that are round but for a socket: one state stands for every way in which they have rolled."""

import math

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely.affinity import affine_transform

from palpate.cad.parts import Solid
from palpate.cad.sections import SectionsError, sections_of
from palpate.cad.stable_states import stable_states
from palpate.cad.state_merging import merge_states
from palpate.rig.catalogue.import_states import _Slices

WITHIN = 0.03
TOLERANCE = 0.09


def bolt(turn, sides=120, socket=(6, 1.6), flat=None):
    """A bolt whose head has a socket of so many sides of a radius; or with a flat all along."""
    profile = [[0, 0], [2.5, 0], [2.6, 0.3], [2.6, 14], [4.5, 14.5], [4.5, 17], [4.0, 17.4], [0, 17.4]]
    part = trimesh.creation.revolve(np.array(profile, dtype=float), sections=sides)
    number, radius = socket
    hole = trimesh.creation.cylinder(radius, 4.0, sections=number)
    hole.apply_translation([0.03, 0.0, 17.4])
    part = part.difference(hole)
    if flat is not None:
        knife = trimesh.creation.box([10, 10, 40])
        knife.apply_translation([flat + 5, 0, 0])
        part = part.difference(knife)
    part.apply_transform(trimesh.transformations.random_rotation_matrix(np.array(turn)))
    return Solid("bolt", np.asarray(part.vertices, dtype=float), np.asarray(part.faces, dtype=np.int64))


def merge(solid):
    states, _ = stable_states(solid)
    return states, merge_states(solid, states, _Slices(solid).of, WITHIN, 0.01)


def in_plane(state, member, axis):
    """Turn (2, 2) and shift (2,) that lay a member's axis, as seen from above, along the state's."""
    ends = [[item.rotation @ p + item.offset_mm for p in axis] for item in (member, state)]
    there, here = (np.diff(np.array(item)[:, :2], axis=0)[0] for item in ends)
    angle = math.atan2(here[1], here[0]) - math.atan2(there[1], there[0])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return turn, ends[1][0][:2] - turn @ ends[0][0][:2]


def true_section(solid, member, height, turn, shift):
    """The section as trimesh has it, moved in the plane."""
    mesh = trimesh.Trimesh(solid.vertices_mm @ member.rotation.T + member.offset_mm, solid.faces)
    cut = mesh.section(plane_origin=[0, 0, height], plane_normal=[0, 0, 1])
    flat, back = cut.to_2D(to_2D=np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -height], [0, 0, 0, 1.0]]))
    assert np.allclose(back[:2, :2], np.eye(2))
    region = shapely.union_all(list(flat.polygons_full))
    return affine_transform(region, [*turn.ravel(), *shift])


turns = st.tuples(*[st.floats(0.05, 0.95)] * 3)


@settings(max_examples=1, deadline=None, suppress_health_check=list(HealthCheck))
@given(turns, st.sampled_from([(3, 1.4), (4, 1.6), (6, 1.6), (6, 2.2)]), st.integers(0, 2**32))
def test_sections_hold_however_the_part_has_rolled(turn, socket, seed):
    solid = bolt(turn, socket=socket)
    states, (merged, out) = merge(solid)
    rolled = [item for item in merged if item.model is not None]
    assert rolled
    assert sum(item.probability for item in out) < 0.05
    rng = np.random.default_rng(seed)
    for item in rolled:
        axis = item.model.axis
        middle = item.model.vertices_mm.mean(axis=0)  # on the axis
        ends = np.array([middle, middle + 10 * axis])
        sections = [one for one in sections_of(item.model, item.state, TOLERANCE) if one.polygons]
        same_way = [one for one in states if lies_alike(one, item.state, axis)]
        assert len(same_way) >= item.count
        for member in rng.choice(np.array(same_way, dtype=object), 6):
            moved = in_plane(item.state, member, ends)
            for section in rng.choice(np.array(sections, dtype=object), 4):
                low, high = section.z_mm
                height = low + rng.uniform(0.01, 0.99) * (high - low)
                true = true_section(solid, member, height, *moved)
                model = shapely.union_all(
                    [shapely.Polygon(polygon.outer, polygon.holes) for polygon in section.polygons]
                )
                off = section.off_mm + 1e-4
                assert shapely.difference(true, model.buffer(off, 32)).is_empty
                assert shapely.difference(model, true.buffer(off, 32)).is_empty
                edges = shapely.segmentize(shapely.boundary(true), 0.1)
                corners = shapely.points(shapely.get_coordinates(edges))
                assert shapely.distance(corners, shapely.boundary(model)).max() <= off


def lies_alike(one, other, axis):
    """True if a state has its axis as another, to a thousandth."""
    return abs(float((one.rotation - other.rotation)[2] @ axis)) < 1e-3


def test_heights_that_the_socket_comes_to_are_unknown():
    solid = bolt((0.2, 0.5, 0.7))
    _, (merged, _) = merge(solid)
    rolled = max(merged, key=lambda item: item.state.probability)
    (low, high) = rolled.state.unknown_mm[0]
    # Lying on the rim of its head, the axis is nearly level, 4.5 mm and less above the table.
    assert 4.5 - 1.6 - 1.5 < low < 4.5 - 1.6 + 0.1
    assert high > 4.5
    with pytest.raises(SectionsError, match="rolls"):
        sections_of(rolled.model, rolled.state, TOLERANCE, [(low, high)])
    for section in sections_of(rolled.model, rolled.state, TOLERANCE):
        assert section.z_mm[1] <= low or section.z_mm[0] >= high


def test_a_flat_all_along_is_not_taken_for_round():
    _, (merged, _) = merge(bolt((0.2, 0.5, 0.7), socket=(6, 0.5), flat=2.0))
    assert all(item.model is None for item in merged)
