"""Doubt of the set-up: rigs that are wrong in one thing are hinted at where nothing fits, right ones not."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from palpate.base.vocabulary import IdentificationVerdict, SetUpFault, Strategy
from palpate.config import ObjectsFile, RigFile
from palpate.recognizer import Catalogue
from palpate.rig.bench import environment, set_up
from palpate.rig.emulated.scene import Placement
from palpate.rig.fingers import Stage
from palpate.rig.identification.doubt import _contacts_seen, _Mounting
from palpate.rig.identification.result import IdentificationJob, IdentificationRun
from palpate.rig.session.run import run_identification
from support.benches.rigs import small_objects, small_rig

TOLD, OBJECTS = small_rig(), small_objects()
NAMES = [finger.name for finger in TOLD.fingers]
PART = OBJECTS.objects[0]


def run(truth: RigFile, objects: ObjectsFile = OBJECTS, seed: int = 3) -> IdentificationRun:
    """A run told the small rig, on a bench as it really is."""
    placement = Placement(PART, PART.states[0], 5.0, -4.0, 0.7)
    bench = replace(set_up(truth, [placement], seed), rig=TOLD)
    job = IdentificationJob(TOLD, Catalogue(objects.objects), (placement,), Strategy.PLANNED, seed)
    return run_identification(job, environment(bench))


def wrong(change: Callable[[dict[str, Any]], None], fingers: slice) -> RigFile:
    values = TOLD.model_dump(mode="json")
    for finger in values["fingers"][fingers]:
        change(finger)
    return RigFile.model_validate(values)


def other_sign(finger: dict[str, Any]) -> None:
    finger["aim"]["gear_ratio"] *= -1


def turned_array(finger: dict[str, Any]) -> None:
    finger["array"]["heading_deg"] = 90.0


def half_as_wide(finger: dict[str, Any]) -> None:
    finger["tip"]["radius_mm"] /= 2


@cache
def stranger() -> IdentificationRun:
    return run(TOLD, ObjectsFile(tuple(item for item in OBJECTS.objects if item is not PART)))


@pytest.mark.parametrize(
    ("truth", "what", "finger"),
    [
        pytest.param(
            wrong(other_sign, slice(0, 1)), SetUpFault.JOINT_SIGN, NAMES[0], marks=pytest.mark.campaign
        ),
        pytest.param(
            wrong(turned_array, slice(1, 2)), SetUpFault.ARRAY_TURNED, NAMES[1], marks=pytest.mark.slow
        ),
        pytest.param(wrong(half_as_wide, slice(None)), SetUpFault.TIP_SIZE, None, marks=pytest.mark.campaign),
    ],
)
def test_a_wrong_set_up_is_hinted_at(truth: RigFile, what: SetUpFault, finger: str | None) -> None:
    ended = run(truth)
    assert ended.result.outcome in (IdentificationVerdict.UNKNOWN, IdentificationVerdict.MOVING)
    assert (what, finger) in {(item.what, item.finger) for item in ended.doubts}
    out = ended.out(wall_seconds=0.0, session=None)
    assert out.object is None or out.verdict is IdentificationVerdict.MOVING
    assert [item.what for item in out.setup_doubts] == [item.what for item in ended.doubts]


def test_a_stranger_on_a_right_rig_says_nothing_of_the_set_up() -> None:
    ended = stranger()
    assert ended.result.outcome in (IdentificationVerdict.UNKNOWN, IdentificationVerdict.MOVING)
    assert not ended.doubts
    touched = [any(touch.contact.touched for touch in grip) for grip in ended.result.grips]
    assert sum(touched) >= 3, "grips to doubt the set-up by"


def test_what_a_rig_as_told_saw_is_what_was_seen() -> None:
    for touch in (touch for grip in stranger().result.grips for touch in grip):
        told = _Mounting(TOLD.fingers[touch.finger_index])
        turn = Stage.of(TOLD).planned_turn(touch.stage_rad)
        (again,) = _contacts_seen(touch, told, told, turn)
        assert again.end_mm == pytest.approx(touch.contact.end_mm, abs=1e-6)
        assert again.start_mm == pytest.approx(touch.contact.start_mm, abs=1e-6)
        assert again.free_path_bound_mm == pytest.approx(touch.contact.free_path_bound_mm, abs=1e-6)
        if touch.contact.normal is not None:
            assert again.normal is not None
            assert np.isclose(again.normal.lo_rad, touch.contact.normal.lo_rad)
