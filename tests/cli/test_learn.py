"""`palpate objects learn` on the emulated bench: what it writes, says and refuses."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import palpate
from palpate.base.errors import InputError
from palpate.config.schema import schema_text
from palpate.recognizer import Finger
from support.benches.rigs import firm_rig
from support.commands.command import Here, violations
from support.commands.repository import EXAMPLES


def test_a_run_that_ends_too_soon_says_so_and_writes_nothing(tmp_path: Path, here: Here) -> None:
    out, picture = tmp_path / "part.json", tmp_path / "part.svg"
    done = here(
        *("objects", "learn", "part", "--height", "18", "--rig", firm_rig(), "--seed", "7"),
        *("--max-seconds", "40", "--out", out, "--picture", picture, "--json"),
    )
    assert done.code == 1
    result = done.json
    assert violations(result, json.loads(schema_text("learning"))) == []
    assert result["format"] == "palpate/learning@1"
    assert result["tolerance"] is None
    assert result["limit"] == "max_seconds"
    assert result["touches"] >= 6
    assert result["rig_seconds"] > 40
    assert not out.exists()
    assert "<svg" in picture.read_text()


def test_it_goes_on_from_contacts_of_an_unknown_part() -> None:
    rig = palpate.open_rig(firm_rig(), seed=7)
    lies = EXAMPLES / "scene.json"
    first = rig.learn("part", height_mm=18.0, max_seconds=30.0, scene=lies)
    more = rig.learn("part", height_mm=18.0, max_seconds=30.0, scene=lies, contacts=first.grips)
    assert more.grips[: len(first.grips)] == first.grips
    assert more.touch_count > first.touch_count > 0
    assert more.fits_together
    other = [[replace(item, finger=Finger(3.0, 10.0)) for item in grip] for grip in first.grips]
    with pytest.raises(InputError, match="no finger"):
        rig.learn("part", height_mm=18.0, max_seconds=30.0, scene=lies, contacts=other)


def test_a_model_that_is_there_is_not_written_over(tmp_path: Path, here: Here) -> None:
    out = tmp_path / "part.json"
    out.write_text("mine")
    done = here("objects", "learn", "part", "--height", "18", "--rig", firm_rig(), "--out", out)
    assert done.code == 2
    assert out.read_text() == "mine"
    nowhere = here("objects", "learn", "a/b", "--height", "18", "--rig", firm_rig())
    assert nowhere.code == 2


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"height_mm": 0.0}, "height_mm"),
        ({"height_mm": 3.0}, "lower than all tips"),
        ({"tolerance_mm": 0.0}, "tolerance_mm"),
        ({"max_seconds": -1.0}, "max_seconds"),
    ],
)
def test_limits_that_mean_nothing_are_refused(changed: dict[str, float], named: str) -> None:
    with pytest.raises(InputError, match=named):
        palpate.open_rig(firm_rig()).learn("part", **({"height_mm": 18.0} | changed))


def test_parts_that_may_slide_are_refused() -> None:
    with pytest.raises(InputError, match="part_holds_n"):
        palpate.open_rig().learn("part", height_mm=18.0)
