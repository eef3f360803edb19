"""Emulated pads: whole runs of rigs with pads, and what is refused before anything moves."""

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contact_sweep import describe
from emulated_session import emulated_session, identify_checked
from firm_rig import firm_rig
from quick_rig import small, small_objects, small_rig
from repository import EXAMPLES

from palpate.base.errors import DeviceError, InputError
from palpate.base.vocabulary import IdentificationVerdict, PartMotion, TipShape
from palpate.config import RigFile, load_contacts, load_rig
from palpate.drivers.tactile.description import Description, Shape
from palpate.jobs.recognition import plan
from palpate.recognizer import Catalogue, Finger
from palpate.rig.arrays import extractor_of, pad_problem, shape_warning, threshold_problem
from palpate.rig.catalogue.reachability import finding_lines
from palpate.rig.commissioning.calibration_run import steps_of
from palpate.rig.conversion import finger_of
from palpate.rig.emulated.devices import description_of
from palpate.rig.study.simulation import with_motion
from palpate.views.recognition import contacts_json

EXAMPLE = EXAMPLES / "pad-rig.toml"
Change = dict[str, object]


def pad_rig(tip: Change | None = None, array: Change | None = None, **other: Change) -> RigFile:
    """The example made small; `other`: changes of tables by their names."""
    data = tomllib.loads(small(EXAMPLE))
    for finger in data["fingers"]:
        finger["tip"] |= tip or {}
        finger["array"] |= array or {}
    for table, changes in other.items():
        data[table] |= changes
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", range(2))
def test_parts_are_identified_by_pads(seed: int) -> None:
    session = emulated_session(seed=seed, rig=pad_rig(), objects=small_objects())
    result = identify_checked(session, Catalogue(small_objects().objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    touches = [touch for grip in result.grips for touch in grip]
    assert {touch.contact.finger for touch in touches} == {Finger(5.0, 10.0, shape=TipShape.PAD)}
    assert {contact.finger for touch in touches for contact in touch.evidence} == {Finger(0.0, 10.0)}
    for grip in contacts_json([[item for touch in grip for item in touch.evidence] for grip in result.grips])[
        "grips"
    ]:  # type: ignore[attr-defined]
        names = [contact["finger"] for contact in grip["contacts"]]
        assert len(set(names)) == len(names), "so files of contacts have them"


def test_wide_coarse_pads_that_are_off_by_their_bounds_still_find_the_truth() -> None:
    rig = pad_rig(
        tip={"width_mm": 16.0, "radius_bound_mm": 0.2, "length_mm": 6.0},
        array={"pitch_mm": 2.0, "heading_bound_deg": 1.0},
        emulation={"tip_radius_error_mm": 0.2, "array_heading_error_deg": 1.0},
    )
    session = emulated_session(seed=5, rig=rig, objects=small_objects())
    identify_checked(session, Catalogue(small_objects().objects))


def test_the_rig_files_pad_is_half_as_wide_either_way() -> None:
    rig = load_rig(EXAMPLE)
    assert {finger_of(finger) for finger in rig.fingers} == {Finger(5.0, 10.0, shape=TipShape.PAD)}
    assert {finger_of(finger).face_point for finger in rig.fingers} == {Finger(0.0, 10.0)}
    again = RigFile.model_validate(rig.model_dump())
    assert again == rig, "half of the width may be said again"


@pytest.mark.parametrize(
    ("tip", "array", "message"),
    [
        ({"width_mm": None}, {}, '"width_mm" is missing: a pad has that in place of radius_mm'),
        ({"shape": "cylinder"}, {}, 'is for shape = "pad"; a cylinder has radius_mm'),
        ({"shape": "cylinder", "width_mm": None}, {}, 'the key "radius_mm" is missing'),
        ({"radius_mm": 4.0}, {}, r"is 4, not half of width_mm \(10\); leave it out"),
        ({"max_friction": 0.3}, {}, "must be 0 for pads"),
        ({"max_latitude_deg": 20.0}, {}, "is for balls"),
        ({}, {"pitch_mm": None}, '"pitch_mm" is missing: how far apart the columns'),
        ({}, {"heading_deg": 10.0}, r"a pad looks along the slide \(0\)"),
        ({}, {"pitch_mm": 20.0}, r"is 20; it is at most tip.width_mm \(10\)"),
        ({}, {"coverage_deg": 180.0}, "is for cylinders and balls"),
    ],
)
def test_pads_that_cannot_be(tip: Change, array: Change, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pad_rig(tip, array)


def test_a_misspelt_shape_is_one_mistake(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    text = EXAMPLE.read_text(encoding="utf-8")
    rig.write_text(text.replace('shape = "pad"', 'shape = "Pad"'), encoding="utf-8")
    with pytest.raises(InputError, match='is "Pad"; allowed: "cylinder", "ball", "pad"') as caught:
        load_rig(rig)
    assert not hasattr(caught.value, "__notes__")


def test_a_flat_array_on_another_tip_is_warned_of() -> None:
    flat, round_ = array(Shape.FLAT, 20, 0.5), array(Shape.CYLINDER, 20, 0.1)
    for rig, description, warned in (
        (small_rig(), flat, True),
        (small_rig(), round_, False),
        (pad_rig(), flat, False),
    ):
        assert (shape_warning(rig.fingers[0], description) is not None) == warned


def test_cylinders_have_no_pitch() -> None:
    data = small_rig().model_dump(exclude_unset=True)
    data["fingers"][1]["array"]["pitch_mm"] = 1.0
    with pytest.raises(ValueError, match=r'is for tip\.shape = "pad"; the tip is a cylinder'):
        RigFile.model_validate(data)


def test_parts_that_move_are_refused() -> None:
    with pytest.raises(ValueError, match="how pads move parts is not known; hold parts down"):
        pad_rig(search={"part_holds_n": 5.0})
    with pytest.raises(ValueError, match="leave it out, so that parts lie still"):
        pad_rig(emulation={"part": {"engine": "quasi-static"}})
    models = [replace(model, holds_n=3.0) for model in small_objects().objects]
    with pytest.raises(InputError, match=r'f1: its tip is a pad, and object "ell" declares part_holds_n'):
        finding_lines(pad_rig(), models, "parts.json")
    assert finding_lines(pad_rig(), small_objects().objects, "parts.json") == []


def test_arms_with_pads_are_refused() -> None:
    data = tomllib.loads((EXAMPLES / "two-link-rig.toml").read_text(encoding="utf-8"))
    for finger in data["fingers"]:
        del finger["tip"]["radius_mm"]
        finger["tip"] |= {"shape": "pad", "width_mm": 8.0}
        finger["array"] |= {"pitch_mm": 0.5, "heading_deg": 0.0}
    with pytest.raises(ValueError, match="on an arm a pad turns as it travels"):
        RigFile.model_validate(data)


def test_what_is_not_done_with_pads_is_said() -> None:
    with pytest.raises(
        InputError, match="f1: its tip is a pad, and simulated touches are those of cylinders"
    ):
        with_motion(pad_rig(), small_objects(), PartMotion.STILL)
    with pytest.raises(InputError, match="pads cannot be calibrated"):
        steps_of(pad_rig(), ["fingers"])
    contacts = load_contacts(EXAMPLES / "contacts.json")
    with pytest.raises(InputError, match="which of them are of one touch"):
        plan(load_rig(EXAMPLE), None, contacts)


def array(shape: Shape, cols: int, pitch: float) -> Description:
    return describe(shape, 4, cols, pitch, 4.0, counts_per_n=2000.0)


@pytest.mark.parametrize(
    ("description", "message"),
    [
        (array(Shape.CYLINDER, 20, 0.1), "is not flat"),
        (array(Shape.FLAT, 10, 1.0), "1 mm apart, more than array.pitch_mm"),
        (
            array(Shape.FLAT, 19, 0.5),
            "its 19 columns, 0.5 mm apart, reach from -4.75 to 4.75 mm across, and the pad's face, "
            "10 mm wide, from -5 to 5 at most",
        ),
        (array(Shape.FLAT, 24, 0.5), "must cover the face, and no more"),
        (array(Shape.FLAT, 20, 0.5), None),
        (array(Shape.FLAT, 21, 0.5), None),
    ],
)
def test_an_array_covers_its_pads_face(description: Description, message: str | None) -> None:
    rig = load_rig(EXAMPLE)
    found = pad_problem(rig.fingers[0], description)
    if message is None:
        assert found is None
        return
    assert found is not None
    assert message in found
    with pytest.raises(DeviceError, match="tactile array f1: "):
        extractor_of(rig, rig.fingers[0], description)


def test_an_array_covers_its_pads_height() -> None:
    description = array(Shape.FLAT, 20, 0.5)
    low, high = (pad_rig(tip={"length_mm": length}).fingers[0] for length in (16.0, 17.0))
    assert pad_problem(low, description) is None
    found = pad_problem(high, description)
    assert found is not None
    assert found.startswith(
        "its 4 rows, 4 mm apart, are 16 mm high, and the pad's face 17 mm (tip.length_mm)"
    )
    assert pad_problem(high, description_of(high, 0)) is None


def test_a_push_on_all_of_a_pad_is_felt_or_the_threshold_is_refused() -> None:
    rig = pad_rig()
    extractor = extractor_of(rig, rig.fingers[0], description_of(rig.fingers[0], 0))
    assert extractor.spread_hidden_n() == pytest.approx(80 * 4 * 2.0 / 2000, rel=1e-6), "4 σ of each taxel"
    assert threshold_problem(extractor, rig.closing, rig.fingers[0].tip) is None
    low = rig.closing.model_copy(update={"contact_force_n": 0.3})
    assert "press evenly on all of the pad" in (threshold_problem(extractor, low, rig.fingers[0].tip) or "")


def test_zeros_that_drift_on_a_way_count() -> None:
    still, drifting = pad_rig(), pad_rig(array={"drift_counts_per_s": 0.2})
    now, later = (
        extractor_of(rig, rig.fingers[0], description_of(rig.fingers[0], 0)).spread_hidden_n(10.0)
        for rig in (still, drifting)
    )
    tared = extractor_of(drifting, drifting.fingers[0], description_of(drifting.fingers[0], 0))
    assert later - tared.spread_hidden_n() == pytest.approx(80 * 2 * 0.2 * 10.0 / 2000), "either way"
    assert later > now
    assert "press evenly" in (threshold_problem(tared, drifting.closing, drifting.fingers[0].tip) or "")


def test_emulated_arrays_cover_the_face() -> None:
    finger = pad_rig(array={"pitch_mm": 0.3}).fingers[0]
    found = description_of(finger, 0)
    assert found.cols == 34
    assert np.diff(found.columns) == pytest.approx(10.0 / 34)
    assert math.isclose(found.columns[0] - 10.0 / 68, -5.0)
    assert pad_problem(finger, found) is None
    with pytest.raises(InputError, match=r"raise array\.pitch_mm"):
        description_of(pad_rig(array={"pitch_mm": 0.03}).fingers[0], 0)


def test_the_example_is_the_firm_rig_with_pads() -> None:
    firm, pads = (tomllib.loads(Path(path).read_text(encoding="utf-8")) for path in (firm_rig(), EXAMPLE))
    assert [item["base_mm"] for item in pads["fingers"]] == [item["base_mm"] for item in firm["fingers"]]
