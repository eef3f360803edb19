"""The examples tell one story: `contacts.json` was felt on the part that `scene.json` puts on the bench."""

import math

import pytest
import shapely
from repository import EXAMPLES
from shapely import affinity

from palpate.config import ContactEntry, load_contacts, load_objects, load_scene, shipped_objects

CONTACTS = [contact for grip in load_contacts(EXAMPLES / "contacts.json").grips for contact in grip.contacts]


def part_on_the_table() -> shapely.Polygon:
    scene = load_scene(EXAMPLES / "scene.json")
    (model,) = [m for m in load_objects(shipped_objects()).objects if m.name == scene.object]
    (state,) = [s for s in model.states if s.name == scene.state]
    turned = affinity.rotate(
        shapely.Polygon(state.sections[0].polygons[0].outer), scene.theta_rad, origin=(0, 0), use_radians=True
    )
    return affinity.translate(turned, scene.x_mm, scene.y_mm)


@pytest.mark.parametrize("contact", [c for c in CONTACTS if c.touched])
def test_touches_lie_on_the_part_within_their_bounds(contact: ContactEntry) -> None:
    assert contact.centre is not None
    assert contact.normal is not None
    part, centre = part_on_the_table(), shapely.Point(contact.centre)
    assert part.distance(centre) == pytest.approx(contact.tip_radius, abs=contact.position_bound)
    foot = shapely.shortest_line(part, centre).coords
    normal = math.atan2(foot[1][1] - foot[0][1], foot[1][0] - foot[0][0])
    lo, hi = contact.normal
    assert (normal - lo) % (2 * math.pi) <= hi - lo


def test_misses_pass_the_part_by() -> None:
    misses = [contact for contact in CONTACTS if not contact.touched]
    assert misses
    for contact in misses:
        assert contact.approach.end is not None
        swept = shapely.LineString([contact.approach.start, contact.approach.end])
        assert part_on_the_table().distance(swept) > contact.tip_radius
