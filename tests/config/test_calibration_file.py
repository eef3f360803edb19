import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrations import empty_calibration, full_calibration
from firm_rig import firm_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from repository import ROOT

from palpate.base.errors import InputError
from palpate.config import calibration_path, calibration_toml, load_calibration, load_rig
from palpate.config.fields import Measured, UpLength
from palpate.config.schema import schema_text

RIG = load_rig(firm_rig())
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
