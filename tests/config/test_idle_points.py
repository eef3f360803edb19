"""Points of objects files that say nothing are left out, and nothing else is."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from palpate.config import load_objects
from palpate.config.objects_checks import drop_redundant_points
from palpate.config.objects_tables import ObjectsFileText
from palpate.jobs.files import load_objects as load_and_warn
from palpate.jobs.script import RigWarning

Points = list[tuple[float, ...]]
SQUARE: Points = [(0, 0), (10, 0), (10, 10), (0, 10)]


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
        ([*SQUARE, (0, 0)], "1 point that repeats the one before"),
        (
            [(0, 0), (0, 0), (4, 0), (10, 0), (10, 10), (10, 10), (0, 10), (0, 5)],
            "2 points that repeat the one before and 2 points on a straight line",
        ),
        ([(0, 0), (3, 0), (5, 0), (8, 0), (10, 0), (10, 10), (0, 10)], "3 points on a straight line"),
    ],
)
def test_what_says_nothing_is_left_out_and_said(points: Points, words: str) -> None:
    text, (line,) = drop_redundant_points(text_of(points))
    assert outer(text) == SQUARE
    assert line.startswith('object "plate": left out ')
    assert words in line


@pytest.mark.parametrize(
    "points",
    [
        SQUARE,
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
    outline = [*SQUARE, (0, 0)]
    objects = [{"name": "plate", "outline": outline, "height": 9}]
    file.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": objects}))
    found = load_objects(file)
    assert len(found.objects[0].states[0].sections[0].rings[0]) == 4
    with pytest.warns(RigWarning, match='parts.json: object "plate": left out 1 point that repeats'):
        assert load_and_warn(file) == found
