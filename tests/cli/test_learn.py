"""`palpate objects learn` on the emulated bench: what it writes, says and refuses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import palpate
from palpate import LearnedObject
from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config.objects_file import ObjectsFile
from palpate.config.schema import schema_text
from palpate.config.writers import file_text
from palpate.recognizer import Catalogue, Finger
from palpate.rig.learning.learned_model import NominalOutline, learned_model
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


def test_what_is_known_is_named_and_not_learned(tmp_path: Path, here: Here) -> None:
    known, out = tmp_path / "known.json", tmp_path / "part.json"
    known.write_text(file_text(palpate.load_objects()))
    done = here(
        *(
            "objects",
            "learn",
            "part",
            "--height",
            "18",
            "--rig",
            firm_rig(),
            "--scene",
            EXAMPLES / "scene.json",
        ),
        *("--objects", known, "--out", out, "--json"),
    )
    assert done.code == 0
    assert violations(done.json, json.loads(schema_text("learning"))) == []
    assert done.json["verdict"] == "identified"
    assert done.json["objects"] == ["tr-2"]
    assert done.json["goal_met"]
    assert not out.exists()


def test_what_is_unknown_is_learned_from_the_touches_that_showed_it_and_goes_on() -> None:
    others = [item.name for item in palpate.load_objects().objects if item.name != "tr-2"]
    known = palpate.load_objects().select(others, "shipped")
    rig, lies = palpate.open_rig(firm_rig(), seed=7), EXAMPLES / "scene.json"
    first = rig.learn("part", height_mm=18.0, max_seconds=60.0, objects=known, scene=lies)
    assert first.verdict is IdentificationVerdict.UNKNOWN
    assert first.fits_together
    with pytest.raises(InputError, match="part"):
        _ = first.objects
    more = rig.learn("part", height_mm=18.0, max_seconds=10.0, scene=lies, contacts=first.grips)
    assert more.verdict is None
    assert more.grips[: len(first.grips)] == first.grips
    assert more.touch_count > first.touch_count > 0
    assert more.fits_together
    other = [[replace(item, finger=Finger(3.0, 10.0)) for item in grip] for grip in first.grips]
    with pytest.raises(InputError, match="no finger"):
        rig.learn("part", height_mm=18.0, max_seconds=30.0, scene=lies, contacts=other)


def test_a_state_that_is_known_is_refused_before_anything_moves() -> None:
    known = palpate.load_objects()
    taken = known.objects[1].states[0].name
    with pytest.raises(InputError, match=taken):
        palpate.open_rig(firm_rig()).learn(known.objects[1].name, height_mm=18.0, state=taken, objects=known)


def test_a_further_state_has_the_bounds_that_hold_for_both() -> None:
    square = np.array([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)])

    def learned(state: str, tolerance_mm: float, tip_mm: float) -> ObjectModel:
        outline = NominalOutline(square, tolerance_mm)
        return learned_model(("part", state), {(6.0, 14.0): outline}, 18.0, tip_mm)

    flat, turned = learned("flat", 1.5, 5.0), learned("turned over", 2.5, 4.0)
    before = ObjectsFile((*palpate.load_objects().objects, flat))
    found = LearnedObject("part", "turned over", turned, 3.0, (), 0.0, None, True, (), (), before).objects
    assert len(found.objects) == len(before.objects)
    both = found.objects[-1]
    assert [item.name for item in both.states] == ["flat", "turned over"]
    assert both.tolerance_mm == turned.tolerance_mm
    assert both.least_tip_radius_mm == 5.0
    assert Catalogue([both]).states[1].tolerance_mm >= 2.5


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
