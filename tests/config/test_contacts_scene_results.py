import json
import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from palpate.base.errors import InputError
from palpate.base.vocabulary import RecognitionVerdict
from palpate.config import load_contacts, load_scene
from palpate.config.recognition_results import (
    HypothesisOut,
    InterpretationOut,
    LevelOut,
    RecognitionOut,
    StatisticsOut,
)
from palpate.config.result_model import BoundsOut, ConfigurationOut, to_json

TOUCH: dict[str, Any] = {
    "finger": "f1",
    "touched": True,
    "centre": [10, 0],
    "height": 10.0,
    "tip_radius": 5.0,
    "position_bound": 0.3,
    "normal": [-0.2, 0.2],
    "approach": {"direction": math.pi, "start": [100, 0]},
}
MISS: dict[str, Any] = {
    "finger": "f3",
    "touched": False,
    "height": 10.0,
    "tip_radius": 5.0,
    "position_bound": 0.3,
    "approach": {"direction": 0.0, "start": [-100, 0], "end": [50, 0]},
}


def write(folder: Path, content: object) -> Path:
    file = folder / "input.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    return file


def contacts(*entries: dict[str, Any]) -> dict[str, Any]:
    return {"format": "palpate/contacts@1", "units": "mm, rad", "grips": [{"contacts": list(entries)}]}


def without(entry: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key not in keys}


def test_the_length_of_a_tip(tmp_path: Path) -> None:
    (grip,) = load_contacts(write(tmp_path, contacts(TOUCH | {"tip_length": 12.0}, MISS))).grips
    assert [item.tip_length for item in grip.contacts] == [12.0, 0.0]
    with pytest.raises(InputError, match=r"tip_length.*: is 21: half of that is more than height \(10\)"):
        load_contacts(write(tmp_path, contacts(TOUCH | {"tip_length": 21})))


def test_a_touch_and_a_miss_come_through(tmp_path: Path) -> None:
    (grip,) = load_contacts(write(tmp_path, contacts(TOUCH, MISS))).grips
    touch, miss = grip.contacts
    assert (touch.centre, touch.normal, touch.approach.end) == ((10.0, 0.0), (-0.2, 0.2), None)
    assert (miss.touched, miss.centre, miss.approach.end) == (False, None, (50.0, 0.0))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (without(TOUCH, "centre"), 'grip 0, contact 0: a finger that touched needs the key "centre"'),
        (MISS | {"centre": [0, 0]}, "grip 0, contact 0, centre: a finger that touched nothing has none"),
        (
            MISS | {"approach": TOUCH["approach"]},
            "contact 0, approach: a finger that touched nothing needs the key",
        ),
        (TOUCH | {"approach": MISS["approach"]}, "contact 0, approach.end: a finger that touched stopped"),
        (TOUCH | {"normal": [1, 0]}, "normal: is [1, 0]; hi is counter-clockwise from lo"),
        (TOUCH | {"normal": [0, 7]}, "more than a full turn"),
        (TOUCH | {"centre": [101, 0]}, "contact 0, centre: lies 1 mm behind the start"),
        (TOUCH | {"tip_radius": -1}, "grip 0, contact 0, tip_radius: is -1; it must be at least 0"),
        (TOUCH | {"touched": 1}, "touched: is 1; it must be true or false"),
        (TOUCH | {"hight": 3}, 'grip 0, contact 0: unknown key "hight"; did you mean "height"?'),
    ],
)
def test_contacts_that_contradict_themselves_are_refused(
    tmp_path: Path, entry: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_contacts(write(tmp_path, contacts(entry)))
    assert message in str(caught.value)


def test_a_finger_touches_once_per_grip(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'contact 1, finger: "f1" is contact 0 of this grip already'):
        load_contacts(write(tmp_path, contacts(TOUCH, TOUCH)))


def test_a_scene_finds_its_objects_beside_itself(tmp_path: Path) -> None:
    content = {
        "format": "palpate/scene@1",
        "object": "plate",
        "configuration": {"x": 1, "y": -2.5, "theta": 0.3},
        "objects": "other.json",
    }
    scene = load_scene(write(tmp_path, content))
    assert (scene.x_mm, scene.y_mm, scene.theta_rad, scene.state) == (1.0, -2.5, 0.3, None)
    assert scene.objects == tmp_path / "other.json"
    with pytest.raises(InputError, match=r"configuration.theta: is nan; it must be a finite number"):
        load_scene(write(tmp_path, content | {"configuration": {"x": 0, "y": 0, "theta": math.nan}}))


def recognition(x: float = 1.23456789) -> RecognitionOut:
    return RecognitionOut(
        verdict=RecognitionVerdict.UNIQUE,
        hypotheses=(
            HypothesisOut(
                object="plate",
                state="flat",
                configuration=ConfigurationOut(x=x, y=-1e-9, theta=0.1),
                bounds=BoundsOut(x=(0.12345678, 0.12345678), y=(-0.12345678, 0.1), theta=(0.0, 3.5)),
                weight=1,
                verified=True,
                symmetry_order=1,
                interpretations=(
                    InterpretationOut(edges=(17, 3, 40), features=("edge 17", "vertex 3", "edge 40")),
                ),
            ),
        ),
        statistics=StatisticsOut(
            levels=(LevelOut(level=2, candidates=9, after_distance=4, after_angle=3),),
            model_tests=1,
            seconds=0.5,
        ),
    )


def test_results_are_rounded_and_bounds_never_inward() -> None:
    written = json.loads(to_json(recognition()))
    assert list(written) == [
        "format",
        "units",
        "verdict",
        "hypotheses",
        "statistics",
        "unfinished",
        "explanation",
        "why",
    ]
    (hypothesis,) = written["hypotheses"]
    assert hypothesis["configuration"] == {"x": 1.234568, "y": 0.0, "theta": 0.1}
    assert hypothesis["bounds"] == {"x": [0.123456, 0.123457], "y": [-0.123457, 0.1], "theta": [0.0, 3.5]}
    assert hypothesis["interpretations"] == [
        {"edges": [17, 3, 40], "features": ["edge 17", "vertex 3", "edge 40"]}
    ]
    assert "-0.0" not in to_json(recognition())
    assert to_json(recognition()) == to_json(recognition())


def test_a_result_that_is_not_finite_is_a_bug() -> None:
    with pytest.raises(ValidationError, match="finite"):
        recognition(math.inf)
