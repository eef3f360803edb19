"""Calibration files, calibrated rigs and reference files."""

import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from palpate.base.errors import InputError
from palpate.calibration.measurements import ReferenceDisc, ReferencePlate
from palpate.config import (
    RigFile,
    SlideFingerConfig,
    apply_calibration,
    calibration_path,
    calibration_toml,
    check_calibration,
    geometry_sha256,
    load_calibration,
    load_rig,
    shipped_rig,
)
from palpate.config.calibration_file import load_references
from palpate.config.fields import Measured, UpLength
from palpate.config.loading import shipped_references
from palpate.config.schema import schema_text
from palpate.rig.commissioning.calibration_run import build_references
from support.benches.calibration_files import empty_calibration, full_calibration
from support.benches.rigs import firm_rig
from support.commands.repository import EXAMPLES, ROOT

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


TEXT = calibration_toml(full_calibration(RIG))


def refusal(folder: Path, text: str) -> str:
    file = folder / "bench.calibration.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_calibration(file)
    message = str(caught.value)
    assert "\n" not in message
    return message.removeprefix(f"{file}: ")


@pytest.mark.parametrize("seed", range(2))
def test_what_is_written_is_what_is_read(tmp_path: Path, seed: int) -> None:
    for number, file in enumerate((full_calibration(RIG, seed), empty_calibration(RIG))):
        written = tmp_path / f"{number}.toml"
        written.write_text(calibration_toml(file), encoding="utf-8")
        again = load_calibration(written)
        assert again == file
        assert calibration_toml(again) == calibration_toml(file)


def test_people_can_read_it() -> None:
    lines = TEXT.splitlines()
    assert lines[0].startswith("# Written by `palpate calibrate`")
    assert "made = 2026-05-04T12:30:00Z" in lines
    assert "[fingers.actuators.slide]" in lines
    assert '    {row = 1, col = 10, what = "dead"},' in lines
    begin = lines.index("gain = [")
    assert [line.count(",") for line in lines[begin + 1 : begin + 9]] == [20] * 8
    assert lines[begin + 9] == "]"


def test_every_key_is_explained() -> None:
    """On the page, and in the schema except for what explains itself."""
    page = (ROOT / "docs" / "calibration-file.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"`(?:\[+)?(?:fingers\.)?([\w.]+)\]*`", page))
    known: set[str] = set()

    def visit(node: dict[str, Any]) -> None:
        for option in [node, node.get("items", {}), *node.get("anyOf", [])]:
            for key, value in option.get("properties", {}).items():
                known.add(key)
                assert value.get("description") or key == "format", key
                visit(value)

    visit(json.loads(schema_text("calibration")))
    assert {"largest_mm", "overshoot", "touches_seen", "phase_deg", "sha256"} <= known
    assert known - documented - {"slide", "aim"} == set()


def test_it_lies_beside_the_rig_file() -> None:
    assert calibration_path(Path("rigs/bench.toml")) == Path("rigs/bench.calibration.toml")
    assert calibration_path(Path("my.bench.toml")) == Path("my.bench.calibration.toml")


UP, NEAR = TypeAdapter(UpLength), TypeAdapter(Measured)
LENGTHS = st.floats(0, 1e12, allow_subnormal=False)


@settings(max_examples=50)
@given(LENGTHS)
def test_bounds_are_rounded_outward_and_once(value: float) -> None:
    rounded = UP.validate_python(value)
    assert value <= rounded <= value * 1.001
    assert UP.validate_python(rounded) == rounded


@settings(max_examples=50)
@given(st.floats(-1e12, 1e12, allow_subnormal=False))
def test_measured_values_keep_seven_digits(value: float) -> None:
    rounded = NEAR.validate_python(value)
    assert rounded == pytest.approx(value, rel=5.1e-7, abs=0)
    assert NEAR.validate_python(rounded) == rounded


def test_times_are_kept_to_the_second() -> None:
    at = datetime(2026, 5, 4, 12, 30, 1, 999999, tzinfo=UTC)
    file = empty_calibration(RIG)
    again = type(file).model_validate({**file.model_dump(), "made": at})
    assert again.made == datetime(2026, 5, 4, 12, 30, 1, tzinfo=UTC)


CASES = [
    (("touch_covariance = [\n", "touch_covariance = [\n    [0, 0],\n"), "must have 2 rows of 2 values"),
    (("gain_bound = [\n    [", "gain_bound = [\n    [0.01, "), "rows of different lengths; both matrices"),
    (("{row = 1, col = 10", "{row = 8, col = 10"), 'unusable[0] ("f1"): names taxel [8, 10] of 8 x 20'),
    (('what = "dead"', 'what = "cold"'), 'is "cold"; allowed: "dead", "hot", "unresponsive"'),
    (("mm_per_turn_sigma = 0.004", "mm_per_turn_sigma = -0.004"), "is -0.004; it must be at least 0"),
    (("mm_per_turn = 100.02", "mm_per_turn = 0"), 'slide.mm_per_turn ("f1"): is 0; it must not be'),
    (("made = 2026-05-04T12:30:00Z", "made = 2026-05-04T12:30:00+02:00"), "must be a date and time in UTC"),
    (("made = 2026-05-04T12:30:00Z", "made = 7"), "made: is 7; it must be a date and time in UTC"),
    (('sha256 = "aaaa', 'sha256 = "AAAA'), "a SHA-256 is 64 characters"),
    (("coverage = 0.999", "coverage = 1"), "coverage: is 1; it must be below 1"),
    (('name = "f2"', 'name = "f1"'), 'fingers[1].name ("f1"): fingers[0] has this name already'),
    (('finger = "f1"', 'finger = "f9"'), 'touches_seen[0].finger: is "f9"; fingers: f1, f2, f3'),
    (("[fingers.place]", "[fingers.palce]"), 'unknown key "palce"; did you mean "place"?'),
    (
        ("\ncovariance = [\n", "\ncovariance = [\n    [0, 0, 0, 0, 0],\n"),
        'place.covariance ("f1"): must have 5 rows of 5',
    ),
    (("\ncovariance = [\n    [0.000121, 0.0", "\ncovariance = [\n    [0.000121, 0.1"), "must be symmetric"),
    (
        ('format = "palpate/calibration@1"', 'format = "palpate/rig@1"'),
        'needed here: "palpate/calibration@1"',
    ),
]


@pytest.mark.parametrize(("change", "message"), CASES, ids=[message[:30] for _, message in CASES])
def test_what_is_wrong_is_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    assert TEXT.count(change[0]) >= 1
    assert message in refusal(tmp_path, TEXT.replace(*change, 1))


def test_a_taxel_is_named_once(tmp_path: Path) -> None:
    entry = '{row = 1, col = 10, what = "dead"},'
    text = TEXT.replace(entry, f"{entry}\n    {entry.replace('dead', 'hot')}", 1)
    assert "unusable[1]" in refusal(tmp_path, text)


def test_a_gain_bound_rounded_up_stays_a_share() -> None:
    tactile = full_calibration(RIG).fingers[0].tactile
    assert tactile is not None
    bounds = np.full_like(tactile.gain, 0.99899999)
    again = type(tactile).model_validate({**tactile.model_dump(), "gain_bound": bounds.tolist()})
    assert np.max(again.gain_bound) == 0.999


# ----------------------------------------------------------------------------------------------------
# References files: the shipped one, and what is refused in one line.

GOOD = """
format = "palpate/references@1"

[disc]
diameter_mm = 49.8
height_mm = 30.0
tolerance_mm = 0.02

[plate]
outline_mm = [[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]]
height_mm = 30.0
"""


def file(folder: Path, text: str) -> Path:
    path = folder / "references.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_shipped_references_are_a_disc_of_50_mm_and_a_square_of_80() -> None:
    disc, plate = build_references(load_references(shipped_references()))
    assert disc == ReferenceDisc("disc", 25.0)
    assert isinstance(plate, ReferencePlate)
    assert sorted(map(tuple, plate.corners_mm.tolist())) == [(-40, -40), (-40, 40), (40, -40), (40, 40)]
    assert (plate.repeats, plate.tolerance_mm) == (4, 0.0)


def test_own_references_are_taken_as_measured(tmp_path: Path) -> None:
    disc, plate = build_references(load_references(file(tmp_path, GOOD)))
    assert (disc.radius_mm, disc.tolerance_mm) == (24.9, 0.02)
    assert plate.repeats == 2
    # An outline's own origin does not matter: it is told from its middle.
    assert plate.corners_mm.max(axis=0).tolist() == [30.0, 20.0]


@pytest.mark.parametrize(
    "outline",
    [
        "[[0, 0], [60, 0], [60, 40], [30, 10], [0, 40]]",  # a notch
        "[[0, 0], [60, 40], [60, 0], [0, 40]]",  # a bow tie
        "[[0, 0], [30, 0], [60, 0], [60, 40], [0, 40]]",  # a corner on a face
    ],
)
def test_a_plate_that_is_not_convex_is_refused_in_one_line(tmp_path: Path, outline: str) -> None:
    text = GOOD.replace("[[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]]", outline)
    with pytest.raises(InputError, match=r"plate\.outline_mm is not convex; a plate's corners go") as refused:
        build_references(load_references(file(tmp_path, text)))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("diameter_mm = 49.8", "diameter_mm = 0.0", r"disc.diameter_mm.* must be above 0"),
        ("[60.0, 0.0], [60.0, 40.0], ", "", r"plate.outline_mm"),
        ("tolerance_mm = 0.02", "tolerance = 0.02", r"disc.*tolerance_mm"),
        ("height_mm = 30.0", "height_mm = -3", r"disc.height_mm.* must be above 0"),
        ("references@1", "objects@1", r"format.*palpate/references@1"),
        ("[disc]", "[disk]", r"dis"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path: Path, before: str, after: str, words: str) -> None:
    assert before in GOOD
    with pytest.raises(InputError, match=words) as refused:
        load_references(file(tmp_path, GOOD.replace(before, after, 1)))
    assert str(refused.value).startswith(str(tmp_path / "references.toml"))
    assert "\n" not in str(refused.value)
