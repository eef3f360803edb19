"""Object models known at some heights only, and the writer of objects files."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from json_schema import violations

from palpate.base.errors import InputError
from palpate.config import load_objects
from palpate.config.objects_file import load_objects_text
from palpate.config.objects_tables import ObjectsFileText, ObjectText, objects_json
from palpate.config.schema import schema_text

SQUARE = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]
POLYGONS = [{"outer": SQUARE}]


def catalogue(zs: list[list[float]], **changes: Any) -> dict[str, Any]:
    state = {"name": "up", "sections": [{"z": z, "polygons": POLYGONS} for z in zs]} | changes
    return {"format": "palpate/objects@1", "units": "mm", "objects": [{"name": "part", "states": [state]}]}


def loaded(folder: Path, content: object) -> Any:
    file = folder / "parts.json"
    file.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return load_objects(file).objects[0].states[0]


def test_a_state_without_heights_is_known_everywhere(tmp_path: Path) -> None:
    state = loaded(tmp_path, catalogue([[2, 5], [7, 9]]))
    assert state.top_mm == 9
    assert all(state.known_at(height) for height in (0.0, 6.0, 8.0, 50.0))


def test_a_state_is_known_within_its_heights_and_above_its_top(tmp_path: Path) -> None:
    state = loaded(tmp_path, catalogue([[4.5, 5.5]], height=20, heights=[[4.5, 5.5], [11.5, 12.5]]))
    known = {height: state.known_at(height) for height in (4.4, 4.5, 5.5, 5.6, 12.0, 12.6, 20.0, 20.1)}
    assert known == {
        4.4: False,
        4.5: True,
        5.5: True,
        5.6: False,
        12.0: True,
        12.6: False,
        20.0: False,
        20.1: True,
    }
    assert state.top_mm == 20


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (catalogue([[4, 5]], heights=[[4, 5]]), 'state "up": has "heights" but no "height"'),
        (
            catalogue([[4, 5]], height=9, heights=[[4, 5], [4.5, 6]]),
            "heights[1]: starts at 4.5 mm, where the one before has not ended",
        ),
        (
            catalogue([[4, 5]], height=9, heights=[[6, 7], [4, 5]]),
            "heights[1]: starts at 4 mm, where the one",
        ),
        (
            catalogue([[4, 5]], height=4.5, heights=[[4, 5]]),
            "heights[0]: ends at 5 mm, above the part's height",
        ),
        (catalogue([[0, 5]], height=9, heights=[[-1, 5]]), "heights[0]: starts at -1 mm, below the support"),
        (
            catalogue([[4, 5], [5, 7]], height=9, heights=[[4, 5.5], [6, 7]]),
            "section 1, z: [5, 7] mm is not within the heights at which the state is known: 4–5.5 and 6–7 mm",
        ),
        (catalogue([[0, 9.5]], height=9), "section 0, z: [0, 9.5] mm is not within the heights at which"),
        (
            catalogue([[0, 8]], height=9),
            'state "up": ends at 8 mm, below its height of 9 mm; say at which "heights"',
        ),
        (catalogue([[0, 8]], height=0), "height: is 0; it must be above 0"),
        (catalogue([[0, 8]], height=8, heights=[]), "heights: has 0 values; it must have at least 1"),
    ],
)
def test_refusals_name_the_place(tmp_path: Path, content: object, message: str) -> None:
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, content)
    assert message in str(caught.value)
    assert 'object "part", state "up"' in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_schema_knows_heights() -> None:
    schema = json.loads(schema_text("objects"))
    good = catalogue([[4, 5]], height=9, heights=[[4, 5]])
    assert violations(good, schema) == []
    assert violations(catalogue([[4, 5]], heights=5), schema) != []


NUMBERS = st.floats(-1e4, 1e4).map(lambda value: round(value, 6) + 0.0)
RINGS = st.lists(st.tuples(NUMBERS, NUMBERS), min_size=3, max_size=40)


@given(rings=st.lists(RINGS, min_size=1, max_size=3), tolerance=st.floats(0, 1), height=st.floats(0.1, 900))
def test_what_is_written_is_read_again_to_the_last_digit(
    rings: list[list[tuple[float, float]]], tolerance: float, height: float
) -> None:
    sections = [
        {"z": (k, k + 1.0), "polygons": [{"outer": ring, "holes": rings}]} for k, ring in enumerate(rings)
    ]
    states = [{"name": "süd", "height": height, "heights": [(0.0, height)], "sections": sections}]
    objects = [{"name": 'a "b"', "tolerance": tolerance, "states": states}, {"name": "c", "height": 3.0}]
    text = ObjectsFileText.model_validate({"format": "palpate/objects@1", "units": "mm", "objects": objects})
    written = objects_json(text)
    assert ObjectsFileText.model_validate(json.loads(written)) == text
    assert max(map(len, written.splitlines())) <= 130, "readable"


def test_objects_that_were_there_stay_as_they_are(tmp_path: Path) -> None:
    file = tmp_path / "parts.json"
    short = {"name": "plate", "outline": SQUARE, "height": 20}
    file.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": [short]}))
    text = load_objects_text(file)
    more = ObjectText(name="other", outline=[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], height=1.0)
    both = text.model_copy(update={"objects": [*text.objects, more]})
    assert json.loads(objects_json(both))["objects"][0] == short
