"""Contacts of tips that stick and slip, on joints that give way: within the bounds that a rig file declares.

The judge knows the outline and where the emulated tips really were, and works with shapely alone.
"""

import math
from typing import Any

import numpy as np
import pytest
import shapely
from emulated_session import EmulatedSession, emulated_session, shape_of
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from quick_rig import small_objects, small_rig
from touched import random_grip

from palpate.config import RigFile
from palpate.drivers.emulators.mechanics import CompliantJoint, JointCompliance
from palpate.recognizer import Contact
from palpate.rig.bench import connect
from palpate.rig.conversion import deflection_mm, deflection_rad, shear_rad
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch

MM_PER_N, DEG_PER_N, FRICTION = 0.1, 0.03, 0.6


def rig_under_load(
    *,
    friction: float = 0.0,
    deflection: float = 0.0,
    holds: tuple[float, float] | None = None,
    play_deg: float = 0.02,
    declare: bool = True,
    fingers: int = 3,
) -> RigFile:
    """The small rig with tips that stick and joints that give way, and whether its fingers declare it."""
    data: dict[str, Any] = small_rig().model_dump(mode="json", exclude_unset=True)
    data["emulation"] |= {
        "deflection_mm_per_n": deflection,
        "aim_backlash_deg": play_deg,
        "part": {"engine": "still", "tip_friction": friction},
    }
    if holds is not None:
        data["emulation"]["play_holds_n"] = list(holds)
    del data["fingers"][fingers:]
    for finger in data["fingers"]:
        finger["aim"]["backlash_deg"] = play_deg
        finger["tip"]["max_friction"] = FRICTION
        finger["bounds"] |= {"deflection_mm_per_n": MM_PER_N, "deflection_deg_per_n": DEG_PER_N}
    rig = RigFile.model_validate(data)
    if declare:
        return rig
    silent = [
        finger.model_copy(
            update={
                "tip": finger.tip.model_copy(update={"max_friction": 0.0}),
                "bounds": finger.bounds.model_copy(
                    update={"deflection_mm_per_n": 0.0, "deflection_deg_per_n": 0.0}
                ),
            }
        )
        for finger in rig.fingers
    ]
    return rig.model_copy(update={"fingers": silent})


def one_grip(session: EmulatedSession, seed: int) -> list[tuple[Touch, np.ndarray]]:
    """A random grip, and where tips really were as it was measured."""
    centres: list[np.ndarray] = []

    def remember(stage: GripPhase) -> None:
        if stage is GripPhase.RETRACTING:
            centres[:] = [finger.centre_mm for finger in session.bench.fingers]

    with connect(session.bench_rig) as hand:
        touches = session.grip(hand, random_grip(session, np.random.default_rng(seed)), remember)
    return [(touch, centres[touch.finger_index]) for touch in touches]


def outside(shape: shapely.Polygon, contact: Contact, centre: np.ndarray, radius: float) -> str | None:
    """What of a contact is not true; None if all is."""
    way = shapely.LineString([contact.start_mm, contact.end_mm])
    assert contact.path_bound_mm is not None
    if shapely.distance(way, shape) < radius - contact.path_bound_mm:
        return "way"
    if not contact.touched:
        return None
    foot = shapely.shortest_line(shape.boundary, shapely.Point(centre)).coords[0]
    normal = math.atan2(centre[1] - foot[1], centre[0] - foot[0])
    touching = (foot[0] + radius * math.cos(normal), foot[1] + radius * math.sin(normal))
    if shapely.distance(shapely.Point(touching), shape) > radius - 1e-6:
        if math.dist(touching, contact.end_mm) > contact.position_bound_mm:
            return "position"
        return None if _holds(contact, normal) else "normal"
    # In a notch: some place nearby where a tip would just touch has to fit.
    rim = shapely.segmentize(shapely.buffer(shape, radius, quad_segs=256).boundary, 0.01)
    near = shapely.points(shapely.get_coordinates(rim))
    near = near[shapely.distance(near, shapely.Point(contact.end_mm)) <= contact.position_bound_mm]
    for point in near:
        foot = shapely.shortest_line(shape.boundary, point).coords[0]
        if _holds(contact, math.atan2(point.y - foot[1], point.x - foot[0])):
            return None
    return "notch"


def _holds(contact: Contact, normal_rad: float) -> bool:
    if contact.normal is None:
        return True
    return (normal_rad - contact.normal.lo_rad) % math.tau <= contact.normal.hi_rad - contact.normal.lo_rad


def judged(seed: int, **load: Any) -> list[tuple[str | None, Touch]]:
    """One grip on a bench of a seed, each contact with what of it is not true."""
    session = emulated_session(seed=seed, rig=rig_under_load(**load), objects=small_objects())
    assert session.placement is not None
    shape = shape_of(session.placement)
    return [(outside(shape, touch.contact, centre, 5.0), touch) for touch, centre in one_grip(session, seed)]


LOADS = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 10**6),
        "friction": st.floats(0.0, FRICTION),
        "deflection": st.floats(0.0, MM_PER_N),
        "holds": st.none() | st.tuples(st.floats(0.0, 0.2), st.floats(0.3, 1.0)),
        "play_deg": st.floats(0.02, 0.2),
    }
)
WORST = {"seed": 3, "friction": FRICTION, "deflection": MM_PER_N, "holds": (0.0, 0.01), "play_deg": 0.2}
FEW = settings(deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))


@settings(FEW, max_examples=1)
@given(LOADS)
@example(WORST)
def test_contacts_are_within_their_bounds_whatever_tips_and_joints_do(load: dict[str, Any]) -> None:
    assert [what for what, _ in judged(**load, fingers=2) if what] == []


@pytest.mark.campaign
@settings(FEW, max_examples=40)
@given(LOADS)
def test_contacts_of_many_loads_are_within_their_bounds(load: dict[str, Any]) -> None:
    assert [what for what, _ in judged(**load, fingers=2) if what] == []


def test_what_is_declared_widens_contacts_by_so_much() -> None:
    """The rule of docs/recogniser.md, with its numbers."""
    tip = small_rig().fingers[0].tip.model_copy(update={"max_friction": 0.5})
    assert math.degrees(shear_rad(tip, 0.2)) == pytest.approx(0.716, abs=0.001)
    finger = rig_under_load().fingers[0]
    assert deflection_mm(finger, 0.5) == pytest.approx(0.05 * math.hypot(1, FRICTION))
    assert deflection_rad(finger, 0.5) == pytest.approx(math.radians(0.015) * math.hypot(1, FRICTION))
    [(_, wide)], [(_, narrow)] = (judged(1, declare=declare, fingers=1) for declare in (True, False))
    assert wide.patch is not None
    assert wide.patch == narrow.patch, "declared or not, the same is measured"
    assert wide.contact.end_mm == narrow.contact.end_mm
    assert wide.contact.normal is not None
    assert narrow.contact.normal is not None
    pressing = wide.patch.force_n + wide.patch.force_bound_n
    turned = shear_rad(finger.tip, pressing) + deflection_rad(finger, pressing)
    assert wide.contact.normal.hi_rad - narrow.contact.normal.hi_rad == pytest.approx(turned)
    assert narrow.contact.normal.lo_rad - wide.contact.normal.lo_rad == pytest.approx(turned)
    widened = wide.contact.position_bound_mm - narrow.contact.position_bound_mm
    assert deflection_mm(finger, pressing) < widened < deflection_mm(finger, pressing) + 0.02


@pytest.mark.parametrize("stiffness", [1.0, 3.0, 300.0])
def test_a_joint_bends_as_far_as_its_tip_pushes_it(stiffness: float) -> None:
    """A spring against a spring, whatever the two stiffnesses."""
    lever, softness, dent = 150.0, 0.1, 0.2
    joint = CompliantJoint(0.0, 0.0, JointCompliance(softness / lever**2, math.inf), stiffness)
    for _ in range(200):
        joint.step(1e-3, 0.0, stiffness * (dent - lever * joint.at), lever)
    bent = dent * softness * stiffness / (1 + softness * stiffness)
    assert lever * joint.at == pytest.approx(bent, abs=1e-5)
    for _ in range(200):
        joint.step(1e-3, 0.0, 0.0, lever)
    assert joint.at == 0.0


def test_a_force_takes_up_play_once_friction_no_longer_holds_it() -> None:
    joint = CompliantJoint(0.001, 0.0, JointCompliance(0.0, 0.2), 3.0)
    for push, at in ((0.2, 0.0), (-0.2, 0.0), (0.3, 0.001), (-0.1, 0.001), (-0.3, -0.001)):
        for _ in range(200):
            joint.step(1e-3, 0.0, push, 150.0)
        assert joint.at == pytest.approx(at)
    joint.step(1e-3, 0.01, 0.0, 150.0)
    assert joint.at == pytest.approx(0.009), "and the servo takes it along from its flank"
    still = CompliantJoint(0.001, 0.0, None, 3.0)
    still.step(1e-3, 0.0, 5.0, 150.0)
    assert still.at == 0.0


@pytest.mark.parametrize(
    ("load", "message"),
    [
        ({"friction": 0.7}, "is 0.7, beyond the bound fingers\\[0\\].tip.max_friction = 0.6"),
        ({"deflection": 0.2}, "beyond the bound fingers\\[0\\].bounds.deflection_mm_per_n = 0.1"),
        ({"holds": (0.3, 0.1)}, "the first value must be below the second"),
    ],
)
def test_emulated_loads_stay_within_what_is_declared(load: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        rig_under_load(**load)
