"""Objects files: mistakes, heights, idle points."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import InputError, RigWarning
from palpate.config import load_objects
from palpate.config.objects_checks import drop_redundant_points
from palpate.config.objects_file import load_objects_text
from palpate.config.objects_tables import ObjectsFileText, ObjectText, objects_json
from palpate.config.schema import schema_text
from palpate.config.writers import file_text
from palpate.jobs.files import load_objects as load_and_warn
from support.commands.command import missing, violations

SQUARE = [[0, 0], [10, 0], [10, 10], [0, 10]]
INNER = [[2, 2], [4, 2], [4, 4], [2, 4]]


def catalogue(**changes: Any) -> dict[str, Any]:
    plate: dict[str, Any] = {"name": "plate", "outline": SQUARE, "height": 20}
    plate.update(changes)
    entry = {key: value for key, value in plate.items() if value is not ...}
    return {"format": "palpate/objects@1", "units": "mm", "objects": [entry]}


def in_states(*polygons: dict[str, Any], **changes: Any) -> dict[str, Any]:
    state = {"name": "up", "sections": [{"z": [0, 3], "polygons": list(polygons)}]} | changes
    return catalogue(outline=..., height=..., states=[state])


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "parts.json"


def refusal(file: Path, content: object) -> str:
    return refusals(file, content)[0]


def refusals(file: Path, content: object) -> list[str]:
    file.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_objects(file)
    messages = [str(caught.value), *getattr(caught.value, "__notes__", [])]
    for message in messages:
        assert message.startswith(str(file))
        assert "\n" not in message
        assert "pydantic" not in message
        assert "http" not in message
    return [message.removeprefix(f"{file}: ") for message in messages]


def test_the_short_form_becomes_one_state_with_one_section(file: Path) -> None:
    file.write_text(json.dumps(catalogue()), encoding="utf-8")
    (plate,) = load_objects(file).objects
    (state,) = plate.states
    (section,) = state.sections
    (polygon,) = section.polygons
    assert (plate.name, plate.tolerance_mm, state.name, section.z_mm) == ("plate", 0.0, "flat", (0.0, 20.0))
    assert state.probability is None
    np.testing.assert_array_equal(polygon.outer, SQUARE)
    assert not polygon.outer.flags.writeable


def test_states_holes_and_numbers_come_through(file: Path) -> None:
    content = in_states({"outer": SQUARE, "holes": [INNER]}, probability=0.38, tipping_angle=0.4)
    content["objects"][0]["tolerance"] = 0.05
    file.write_text(json.dumps(content), encoding="utf-8")
    (part,) = load_objects(file).objects
    assert part.tolerance_mm == 0.05
    assert part.states[0].probability == 0.38
    assert part.states[0].tipping_angle_rad == 0.4
    np.testing.assert_array_equal(part.states[0].sections[0].polygons[0].holes[0], INNER)


def test_what_a_part_holds_comes_through_and_is_written(file: Path) -> None:
    file.write_text(json.dumps(catalogue(part_holds_n=0.3, part_support_mm=15.0)))
    loaded = load_objects(file)
    assert (loaded.objects[0].holds_n, loaded.objects[0].support_mm) == (0.3, 15.0)
    file.write_text(file_text(loaded))
    assert load_objects(file) == loaded
    file.write_text(json.dumps(catalogue(part_holds_n=0)))
    with pytest.raises(InputError, match="part_holds_n"):
        load_objects(file)


def test_both_directions_keep_the_order_of_the_file(file: Path) -> None:
    file.write_text(json.dumps(catalogue(outline=SQUARE[::-1])), encoding="utf-8")
    outer = load_objects(file).objects[0].states[0].sections[0].polygons[0].outer
    np.testing.assert_array_equal(outer, SQUARE[::-1])


def test_a_byte_order_mark_is_no_obstacle(file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + json.dumps(catalogue()).encode())
    assert len(load_objects(file).objects) == 1


PLATE, STATE = 'object "plate"', 'object "plate", state "up", section 0, polygon'
BOW = [[0, 0], [10, 10], [10, 0], [0, 10]]
CASES: list[tuple[object, str, str]] = [
    (catalogue(outline=..., outlin=SQUARE), PLATE, 'unknown key "outlin"; did you mean "outline"?'),
    (
        catalogue(zzz=1, objcts=2),
        PLATE,
        'unknown key "zzz"; allowed: name, tolerance, normal_bound, least_tip_radius, source',
    ),
    (in_states({"outer": SQUARE, "hole": []}), f"{STATE} 0", 'unknown key "hole"; did you mean "holes"?'),
    (catalogue(outline=BOW), f"{PLATE}, outline", "at (5, 5): edge 0 meets edge 2"),
    (
        catalogue(outline=[[0, 0], [10, 0], [20, 0], [5, 0]]),
        f"{PLATE}, outline",
        "edge 0 runs back along",
    ),
    (catalogue(outline=[[0, 0], [10, 0], [10, 0]]), f"{PLATE}, outline point 2", "repeats point 1"),
    (catalogue(outline=[]), f"{PLATE}, outline", "has 0 points; an outline needs at least 3"),
    (
        catalogue(outline=[[0, 0], [10, "a"], [1, 1]]),
        f"{PLATE}, outline point 1, [1]",
        'is "a"; it must be',
    ),
    (catalogue(height=float("inf")), f"{PLATE}, height", "is inf; it must be a finite number"),
    (catalogue(height=-3), f"{PLATE}, height", "is -3; it must be above 0"),
    (catalogue(height=True), f"{PLATE}, height", "is true; it must be a number"),
    (catalogue(height=...), PLATE, 'the key "height" is missing (or give "states")'),
    (catalogue(name="a\nb"), 'object "a\\nb", name', "one line without blanks around it"),
    (catalogue(name="a\x1bb"), 'object "a\\x1bb", name', "made of printable characters"),
    (catalogue(name="\ud800"), 'object "\\ud800", name', "a text of valid characters"),
    (catalogue() | {"units": "inch"}, "units", 'is "inch"; allowed: "mm"'),
    (catalogue() | {"objects": []}, "contains no objects", ""),
    (catalogue() | {"objects": [3]}, "object 0", "is 3; it must be a table of keys and values"),
    (catalogue() | {"objects": catalogue()["objects"] * 2}, PLATE, "the name is taken by object 0"),
    (
        catalogue(name="\u00e9")
        | {"objects": [*catalogue(name="\u00e9")["objects"], *catalogue(name="e\u0301")["objects"]]},
        'object "e\u0301"',
        "the name is taken by object 0",
    ),
    (
        in_states({"outer": SQUARE, "holes": [[[1, 1], [2, 1], [2, 20]]]}),
        f"{STATE} 0, hole 0",
        "outside the outer",
    ),
    (
        in_states({"outer": SQUARE, "holes": [[[0, 0], [2, 1], [2, 2]]]}),
        f"{STATE} 0, hole 0",
        "touches the outer",
    ),
    (
        in_states({"outer": SQUARE, "holes": [INNER, INNER]}),
        f"{STATE} 0, hole 1",
        "or overlaps hole 0 at",
    ),
    (in_states({"outer": SQUARE}, {"outer": INNER}), f"{STATE} 1", "overlaps polygon 0 at"),
    ({"fromat": "palpate/objects@1"}, "unknown key", '"fromat"; did you mean "format"?'),
    ({}, 'the key "format" is missing', "objects@1"),
    ([1], "holds a list", "it must be a table"),
    ('{"a": 1,\n "b" 2}', "not valid JSON", "line 2, column 6: "),
    ('{"a": 1, "a": 2}', 'the key "a" is given twice in one table', ""),
    ("[" * 100_000, "brackets are nested too deeply", ""),
    ("", "not valid JSON", "line 1, column 1: "),
    ('format = "palpate/rig@1"\n', "format", 'is "palpate/rig@1"; needed here: "palpate/objects@1"'),
    ('{"format":"palpate/study-runs@1"}\n{}\n', "format", 'is "palpate/study-runs@1"; needed here'),
    ('{"format": "palpate/objects@1",\n}', "not valid JSON", "line 2, column 1: "),
]


@pytest.mark.parametrize(("content", "where", "word"), CASES)
def test_what_is_refused_is_named(file: Path, content: object, where: str, word: str) -> None:
    said = refusal(file, content)
    assert said.startswith(where)
    assert word in said.removeprefix(where)


def test_heights_that_overlap_or_lie_under_the_table_are_refused(file: Path) -> None:
    sections = [{"z": [0, 8], "polygons": [{"outer": SQUARE}]}, {"z": [7, 9], "polygons": [{"outer": INNER}]}]
    message = refusal(file, in_states(sections=sections))
    assert missing(message, '"plate"', '"up"', "section 1, z", "overlaps", "section 0") == []
    sections[0]["z"] = [-1, 8]
    below, overlaps = refusals(file, in_states(sections=sections))
    assert below.endswith("section 0, z: starts at -1 mm, below the support plane")
    assert missing(overlaps, "section 1, z", "overlaps", "section 0") == []
    sections[0]["z"] = [8, 8]
    assert "the first value must be below the second" in refusal(file, in_states(sections=sections))


def test_every_mistake_is_a_line_up_to_ten_wherever_it_is_made(file: Path) -> None:
    content = catalogue()
    content["objects"] = [{"name": f"o{k}", "outline": SQUARE, "hight": 10} for k in range(3)]
    content["objects"][1]["height"] = "high"
    assert refusals(file, content) == [
        'object "o0"; object "o1"; object "o2": unknown key "hight"; did you mean "height"?',
        'object "o1", height: is "high"; it must be a number',
    ]
    content["objects"] = [{"name": f"o{k}", "outline": SQUARE} for k in range(12)]
    (line,) = refusals(file, content)
    assert line.startswith('object "o0"; object "o1"; ')
    assert line.endswith('object "o5" and 6 more: the key "height" is missing (or give "states")')
    content["objects"] = [{"name": f"o{k}", "outline": SQUARE, "height": -k} for k in range(12)]
    _, *others, last = refusals(file, content)
    assert (len(others), last) == (9, "2 more, which are not shown")


def test_probabilities_add_up_to_one_at_most(file: Path) -> None:
    content = in_states({"outer": SQUARE}, probability=0.6)
    content["objects"][0]["states"].append(content["objects"][0]["states"][0] | {"name": "down"})
    assert refusal(file, content).endswith("add up to 1.2; at most 1 is possible")


def test_missing_file_folder_and_foreign_bytes(file: Path) -> None:
    with pytest.raises(InputError, match=re.escape(f"{file}: there is no such file")):
        load_objects(file)
    with pytest.raises(InputError, match="is a folder, not a file"):
        load_objects(file.parent)
    file.write_bytes(b'{"format":\n "\xe9"}')
    with pytest.raises(InputError, match="line 2 holds byte 0xe9, which is not UTF-8"):
        load_objects(file)


# ----------------------------------------------------------------------------------------------------
# Object models known at some heights only, and the writer of objects files.

SQUARE_MM = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]
POLYGONS = [{"outer": SQUARE_MM}]


def catalogue_of_heights(zs: list[list[float]], **changes: Any) -> dict[str, Any]:
    state = {"name": "up", "sections": [{"z": z, "polygons": POLYGONS} for z in zs]} | changes
    return {"format": "palpate/objects@1", "units": "mm", "objects": [{"name": "part", "states": [state]}]}


def loaded(folder: Path, content: object) -> Any:
    file = folder / "parts.json"
    file.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return load_objects(file).objects[0].states[0]


def test_a_state_without_heights_is_known_everywhere(tmp_path: Path) -> None:
    state = loaded(tmp_path, catalogue_of_heights([[2, 5], [7, 9]]))
    assert state.top_mm == 9
    assert all(state.known_at(height) for height in (0.0, 6.0, 8.0, 50.0))


def test_a_state_is_known_within_its_heights_and_above_its_top(tmp_path: Path) -> None:
    state = loaded(
        tmp_path, catalogue_of_heights([[4.5, 5.5]], height=20, heights=[[4.5, 5.5], [11.5, 12.5]])
    )
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
    ("zs", "keys", "message"),
    [
        ([[4, 5]], {"heights": [[4, 5]]}, 'state "up": has "heights" but no "height"'),
        (
            [[4, 5]],
            {"height": 9, "heights": [[4, 5], [4.5, 6]]},
            "heights[1]: starts at 4.5 mm, where",
        ),
        ([[4, 5]], {"height": 9, "heights": [[6, 7], [4, 5]]}, "heights[1]: starts at 4 mm, where the one"),
        ([[4, 5]], {"height": 4.5, "heights": [[4, 5]]}, "heights[0]: ends at 5 mm, above the part's height"),
        ([[0, 5]], {"height": 9, "heights": [[-1, 5]]}, "heights[0]: starts at -1 mm, below the support"),
        (
            [[4, 5], [5, 7]],
            {"height": 9, "heights": [[4, 5.5], [6, 7]]},
            "section 1, z: [5, 7] mm is not",
        ),
        ([[0, 9.5]], {"height": 9}, "section 0, z: [0, 9.5] mm is not within the heights at which"),
        ([[0, 8]], {"height": 9}, 'state "up": ends at 8 mm, below its height of 9 mm'),
        ([[0, 8]], {"height": 0}, "height: is 0; it must be above 0"),
        ([[0, 8]], {"height": 8, "heights": []}, "heights: has 0 values; it must have at least 1"),
    ],
)
def test_refusals_name_the_place(
    tmp_path: Path, zs: list[list[float]], keys: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, catalogue_of_heights(zs, **keys))
    assert message in str(caught.value)
    assert 'object "part", state "up"' in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_schema_knows_heights() -> None:
    schema = json.loads(schema_text("objects"))
    good = catalogue_of_heights([[4, 5]], height=9, heights=[[4, 5]])
    assert violations(good, schema) == []
    assert violations(catalogue_of_heights([[4, 5]], heights=5), schema) != []


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
    short = {"name": "plate", "outline": SQUARE_MM, "height": 20}
    file.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": [short]}))
    text = load_objects_text(file)
    more = ObjectText(name="other", outline=[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], height=1.0)
    both = text.model_copy(update={"objects": [*text.objects, more]})
    assert json.loads(objects_json(both))["objects"][0] == short


# ----------------------------------------------------------------------------------------------------
# Points of objects files that say nothing are left out, and nothing else is.

Points = list[tuple[float, ...]]
SQUARE_POINTS: Points = [(0, 0), (10, 0), (10, 10), (0, 10)]


def text_of(*outlines: object) -> ObjectsFileText:
    first, *holes = outlines
    state = {"name": "a", "sections": [{"z": [0, 9], "polygons": [{"outer": first, "holes": holes}]}]}
    objects = [{"name": "plate", "states": [state]}]
    return ObjectsFileText.model_validate({"format": "palpate/objects@1", "units": "mm", "objects": objects})


def outer(text: ObjectsFileText) -> Points:
    states = text.objects[0].states
    assert states is not None
    return [tuple(map(float, point)) for point in states[0].sections[0].polygons[0].outer]  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([*SQUARE_POINTS, (0, 0)], "1 point that repeats the one before"),
        (
            [(0, 0), (0, 0), (4, 0), (10, 0), (10, 10), (10, 10), (0, 10), (0, 5)],
            "2 points that repeat the one before and 2 points on a straight line",
        ),
        ([(0, 0), (3, 0), (5, 0), (8, 0), (10, 0), (10, 10), (0, 10)], "3 points on a straight line"),
    ],
)
def test_what_says_nothing_is_left_out_and_said(points: Points, words: str) -> None:
    text, (line,) = drop_redundant_points(text_of(points))
    assert outer(text) == SQUARE_POINTS
    assert line.startswith('object "plate": left out ')
    assert words in line


def test_of_several_objects_a_single_line_is_said() -> None:
    one = text_of([*SQUARE_POINTS, (0, 0)])
    text, (line,) = drop_redundant_points(one.model_copy(update={"objects": one.objects * 3}))
    assert len(text.objects) == 3
    assert line.startswith("3 objects: left out 3 points")


@pytest.mark.parametrize(
    "points",
    [
        SQUARE_POINTS,
        [(0, 0), (5, 1e-4), (10, 0), (10, 10), (0, 10)],  # bent, if little
        [(0, 0, 0.5), (10, 0), (10, 10), (0, 10)],
        [(0, 0), (5, 0, 0.3), (10, 0), (10, 10), (0, 10)],  # an arc begins there
        [(0, 0), (20, 0), (10, 0), (10, 10)],  # runs back
    ],
)
def test_what_says_something_stays(points: Points) -> None:
    before = text_of(points)
    text, lines = drop_redundant_points(before)
    assert text is before
    assert lines == ()


def test_a_fine_circle_keeps_all_of_its_points() -> None:
    """Each of them alone is as good as on the line between its neighbours."""
    turns = np.linspace(0, 2 * math.pi, 100_000, endpoint=False)
    points = np.column_stack([np.cos(turns), np.sin(turns)]).tolist()
    text, lines = drop_redundant_points(text_of(points))
    assert lines == ()
    assert len(outer(text)) == 100_000


@given(
    sides=st.integers(3, 9),
    extra=st.lists(st.tuples(st.integers(0, 8), st.floats(0, 1)), max_size=12),
    seed=st.integers(0, 1000),
)
def test_the_outline_is_the_same_without_them(sides: int, extra: list[tuple[int, float]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = 2 * math.pi * (np.arange(sides) + rng.uniform(-0.3, 0.3, sides)) / sides
    corners = 20 * np.column_stack([np.cos(turns), np.sin(turns)])
    points: Points = []
    for k, corner in enumerate(corners):
        step = corners[(k + 1) % sides] - corner
        own = sorted(share for number, share in extra if number % sides == k)
        points += [tuple((corner + share * step).tolist()) for share in (0.0, *own)]
    text, _ = drop_redundant_points(text_of(points))
    left = outer(text)
    assert len(left) >= sides
    assert shapely.hausdorff_distance(shapely.LinearRing(left), shapely.LinearRing(points)) < 1e-6


def test_files_say_so_when_they_are_loaded(tmp_path: Path) -> None:
    file = tmp_path / "parts.json"
    outline = [*SQUARE_POINTS, (0, 0)]
    objects = [{"name": "plate", "outline": outline, "height": 9}]
    file.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": objects}))
    found = load_objects(file)
    assert len(found.objects[0].states[0].sections[0].rings[0]) == 4
    with pytest.warns(RigWarning, match='parts.json: object "plate": left out 1 point that repeats'):
        assert load_and_warn(file) == found
