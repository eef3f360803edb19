from pathlib import Path

import pytest
from calibrations import empty_calibration, full_calibration
from firm_rig import firm_rig
from repository import EXAMPLES

from palpate.base.errors import InputError
from palpate.config import (
    RigFile,
    SlideFingerConfig,
    apply_calibration,
    check_calibration,
    geometry_sha256,
    load_rig,
    shipped_rig,
)

BENCH = firm_rig().read_text(encoding="utf-8")
RIG = load_rig(firm_rig())


def rig_with(folder: Path, *changes: tuple[str, str]) -> RigFile:
    text = BENCH
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    file = folder / "rig.toml"
    file.write_text(text, encoding="utf-8")
    return load_rig(file)


@pytest.mark.parametrize("source", [shipped_rig(), *sorted((EXAMPLES).glob("*rig.toml"))])
def test_an_empty_calibration_changes_nothing(source: Path) -> None:
    rig = load_rig(source)
    file = empty_calibration(rig)
    check_calibration(file, rig, "c.toml", "rig.toml")
    assert apply_calibration(rig, file) == rig


def test_what_was_measured_takes_the_place_of_what_was_described() -> None:
    file = full_calibration(RIG)
    rig = apply_calibration(RIG, file)
    assert rig.emulation == RIG.emulation
    for new, old, found in zip(rig.fingers, RIG.fingers, file.fingers, strict=True):
        assert isinstance(new, SlideFingerConfig)
        assert isinstance(old, SlideFingerConfig)
        assert found.tactile is not None
        assert new.base_mm == pytest.approx((old.base_mm[0] + 0.02, old.base_mm[1] - 0.01))
        assert new.heading_deg == old.heading_deg + 0.01
        assert new.slide.zero_mm == 40.05  # of the place, not of homing
        assert new.slide.mm_per_turn == 100.03
        assert new.slide.backlash_mm == pytest.approx(0.06 + 3.3 * 0.004)
        assert new.aim.backlash_deg == pytest.approx(0.015 + 3.3 * 0.002)
        assert new.tip.radius_mm == 5.01
        assert new.tip.stiffness_n_per_mm == found.tactile.stiffness_n_per_mm
        assert new.tip.stiffness_spread == 0.03
        assert new.array.heading_deg == 0.1
        assert new.array.gain_spread == old.array.gain_spread
        assert new.array.drift_counts_per_s == found.tactile.drift_counts_per_s
        assert new.array.taxels is not None
        assert new.array.taxels.gain == found.tactile.gain
        assert new.array.taxels.unusable == [(1, 10)]
        assert (new.bounds.position_mm, new.bounds.direction_deg) == (0.2, 1.0)
        assert (new.bounds.base_mm, new.bounds.heading_deg) == (old.bounds.base_mm, old.bounds.heading_deg)
        assert new.slide.zero_bound_mm == new.slide.mm_per_turn_spread == 0
        assert new.tip.radius_bound_mm == new.array.heading_bound_deg == 0


def test_without_bounds_on_contacts_every_part_keeps_its_own() -> None:
    file = full_calibration(RIG)
    bare = [finger.model_copy(update={"bounds": None}) for finger in file.fingers]
    first = apply_calibration(RIG, file.model_copy(update={"fingers": bare})).fingers[0]
    assert isinstance(first, SlideFingerConfig)
    assert first.slide.zero_bound_mm == pytest.approx(3.3 * 0.01)
    assert first.slide.mm_per_turn_spread == pytest.approx(3.3 * 0.004 / 100, rel=1e-3)
    assert first.tip.radius_bound_mm == pytest.approx(3.3 * 0.006)
    assert first.array.heading_bound_deg == pytest.approx(3.3 * 0.1)
    assert first.bounds == RIG.fingers[0].bounds


def test_a_slide_that_did_not_meet_its_stops_keeps_zero_and_travel() -> None:
    file = full_calibration(RIG)
    found = file.fingers[0]
    assert found.actuators is not None
    slide = found.actuators.slide.model_copy(update={"homed": False})
    actuators = found.actuators.model_copy(update={"slide": slide})
    alone = found.model_copy(update={"actuators": actuators, "place": None, "bounds": None})
    first = apply_calibration(RIG, file.model_copy(update={"fingers": [alone, *file.fingers[1:]]})).fingers[0]
    described = RIG.fingers[0]
    assert isinstance(first, SlideFingerConfig)
    assert isinstance(described, SlideFingerConfig)
    assert first.slide.friction_a == pytest.approx(0.8 * slide.friction_a)
    measured = {"backlash_mm": first.slide.backlash_mm, "friction_a": first.slide.friction_a}
    assert first.slide == described.slide.model_copy(update=measured)


GEOMETRY = [
    ("base_mm = [0.0, 190.0]", "base_mm = [0.0, 190.5]"),
    ("heading_deg = 270.0", "heading_deg = 270.1"),
    ("dxl_id = 11", "dxl_id = 13"),
    ("mm_per_turn = 100.0", "mm_per_turn = 100.1"),
    ("radius_mm = 5.0", "radius_mm = 5.1"),
    ("zero_mm = 40.0", "zero_mm = 40.1"),
    ("heading_deg = 0.0", "coverage_deg = 260.0"),
    ('name = "f1"', 'name = "front"'),
]
OTHER = [
    ("max_force_n = 8.0", "max_force_n = 7.0"),
    ("radius_mm = 125.0", "radius_mm = 124.0"),
    ('port = "mock://f1"', 'port = "mock://left"'),
    ("backlash_mm = 0.08\nzero_mm", "backlash_mm = 0.09\nzero_mm"),
    ("base_mm = 0.05\nheading_deg", "base_mm = 0.07\nheading_deg"),
    ("heading_deg = 0.0", "heading_bound_deg = 1.0"),
    ("noise_counts = 2.0", "noise_counts = 3.0"),
]


@pytest.mark.parametrize("change", GEOMETRY, ids=[new for _, new in GEOMETRY])
def test_a_changed_finger_needs_another_calibration(tmp_path: Path, change: tuple[str, str]) -> None:
    assert geometry_sha256(rig_with(tmp_path, change)) != geometry_sha256(RIG)


@pytest.mark.parametrize("change", OTHER, ids=[new for _, new in OTHER])
def test_how_the_rig_is_used_may_change(tmp_path: Path, change: tuple[str, str]) -> None:
    rig = rig_with(tmp_path, change)
    assert geometry_sha256(rig) == geometry_sha256(RIG)
    check_calibration(full_calibration(RIG), rig, "c.toml", "rig.toml")


REFUSED = [
    (('name = "firm-bench"', 'name = "other"'), 'was made for rig "firm-bench"; rig.toml describes "other"'),
    (('name = "f2"', 'name = "left"'), "was made for fingers f1, f2, f3; rig.toml has f1, left, f3"),
    (("base_mm = [0.0, 190.0]", "base_mm = [0.0, 190.5]"), "changed in rig.toml since this calibration was"),
]


@pytest.mark.parametrize(("change", "message"), REFUSED, ids=[message[:20] for _, message in REFUSED])
def test_a_calibration_of_another_rig_is_refused(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    with pytest.raises(
        InputError, match=r"calibrate again with `palpate calibrate --rig rig\.toml`"
    ) as caught:
        check_calibration(full_calibration(RIG), rig_with(tmp_path, change), "c.toml", "rig.toml")
    assert str(caught.value).startswith("c.toml: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_arms_have_no_slides_to_calibrate() -> None:
    arms = load_rig(EXAMPLES / "two-link-rig.toml")
    slides = full_calibration(RIG).fingers
    names = [finger.name for finger in arms.fingers]
    renamed = [item.model_copy(update={"name": name}) for item, name in zip(slides, names, strict=True)]
    file = empty_calibration(arms).model_copy(update={"fingers": renamed})
    with pytest.raises(InputError, match="is an arm, which has no aim and no slide"):
        check_calibration(file, arms, "c.toml", "rig.toml")
