"""References files: the shipped one, and what is refused in one line."""

from pathlib import Path

import pytest

from palpate.base.errors import InputError
from palpate.calibration.reference import ReferenceDisc, ReferencePlate
from palpate.config.calibration_file import load_references
from palpate.config.loading import shipped_references
from palpate.rig.commissioning.calibration_run import build_references

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
