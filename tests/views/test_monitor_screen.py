"""The screen of `palpate watch`: where taxels, signs, bars and numbers stand, at several widths."""

import io
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frames import ArrayCounters
from palpate.drivers.tactile.patches import ContactPatch, PatchFlag
from palpate.rig.array_monitor import FingerView, TareState
from palpate.views.watch_screen import WatchPicture, line_of, out_of, scale_of, watch_view
from support.devices.array_tips import DESCRIPTION

PATCH = ContactPatch(
    angle_rad=math.radians(-20.0),
    angle_half_range_rad=math.radians(15.0),
    centroid_rad=-0.35,
    centroid_bound_rad=0.05,
    position_mm=(4.7, -1.7, 8.1),
    position_bound_mm=(0.2, 0.3, 1.5),
    height_mm=8.1,
    height_bound_mm=1.5,
    force_n=2.0,
    force_bound_n=0.19,
    extent_rad=0.7,
    area_mm2=12.0,
    flags=frozenset({PatchFlag.WIDE, PatchFlag.DEAD_NEIGHBOUR}),
)


def view_of(description: Description = DESCRIPTION, **changes: object) -> FingerView:
    shape = (description.rows, description.cols)
    blank = np.zeros(shape, dtype=bool)
    view = FingerView(
        name="f1",
        port="mock://f1",
        description=description,
        tare=TareState.DONE,
        counts=np.full(shape, 20, dtype=np.uint16),
        taxel_n=np.zeros(shape),
        saturated=blank,
        dead=blank,
        hot=blank,
        force_n=0.0,
        patch=None,
        rate_hz=249.96,
        age_s=0.0084,
        counters=ArrayCounters(1000, 0, 0, 0, 0),
    )
    return replace(view, **changes)  # type: ignore[arg-type]


def screen(*views: FingerView, width: int = 44, colour: bool = False, keys: bool = False) -> list[str]:
    """The screen's lines; with `colour` its escape sequences are in them."""
    picture = WatchPicture("rig bench", 12.3, "", ("a note",), views, 8.0, keys)
    out = io.StringIO()
    console = Console(
        file=out,
        width=width,
        force_terminal=colour,
        color_system="truecolor" if colour else None,
        no_color=not colour,
    )
    console.print(watch_view(picture, width=width, colour=colour))
    return out.getvalue().splitlines()


def map_of(lines: list[str]) -> list[str]:
    """The eight rows of the first finger's map."""
    top = next(k for k, line in enumerate(lines) if line.startswith("f1"))
    return [line[:20] for line in lines[top + 1 : top + 9]]


def test_steps_are_one_two_five_up_to_half_of_full_scale() -> None:
    steps = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1)
    assert scale_of(2.05).starts_n == pytest.approx(steps)
    assert scale_of(1.0).starts_n[-1] == pytest.approx(0.5)
    assert scale_of(39.0).starts_n[-1] == pytest.approx(10)


def test_taxels_stand_where_they_are_seen_facing_the_tip() -> None:
    taxel_n = np.zeros((8, 20))
    taxel_n[0, 0], taxel_n[7, 19], taxel_n[3, 5] = 0.6, 0.02, 0.0006
    rows = map_of(screen(view_of(taxel_n=taxel_n)))
    assert rows[7] == "@" + " " * 19, "the lowest row is at the bottom"
    assert rows[0].rstrip() == " " * 19 + "*"
    assert rows[4].rstrip() == "     .", "the scale's first step"
    assert [row.strip() for k, row in enumerate(rows) if k not in (0, 4, 7)] == [""] * 5


def test_signs_of_taxels_that_cannot_be_trusted_stand_on_colours_too() -> None:
    dead, hot, saturated = (np.zeros((8, 20), dtype=bool) for _ in range(3))
    dead[7, 0] = hot[7, 1] = saturated[7, 1] = saturated[7, 2] = True
    view = view_of(dead=dead, hot=hot, saturated=saturated)
    assert map_of(screen(view))[0].rstrip() == "×!▲"
    coloured = screen(view, colour=True)
    plain = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in coloured]
    assert map_of(plain)[0].rstrip() == "×!▲"
    for lines in (screen(view), plain):
        text = "\n".join(lines)
        assert "× dead   ! hot   ▲ at its largest count" in text
        assert "taxels: 1 dead, 1 hot" in text
    assert "dead" not in "\n".join(screen(view_of()))


def test_stronger_taxels_are_brighter() -> None:
    taxel_n = np.zeros((8, 20))
    taxel_n[7, :10] = [start * 1.5 for start in scale_of(DESCRIPTION.full_scale_n).starts_n]
    lines = screen(view_of(taxel_n=taxel_n), colour=True)
    row = next(line for line in lines if line.count("48;2;") > 10)
    colours = [tuple(map(int, found)) for found in re.findall(r"48;2;(\d+);(\d+);(\d+)", row)]
    brightness = [0.2126 * r + 0.7152 * g + 0.0722 * b for r, g, b in colours[:10]]
    assert brightness == sorted(brightness)
    assert len(set(colours[:11])) == 11, "each step and nothing"


def test_force_contact_and_counts_in_words_and_a_bar() -> None:
    counters = ArrayCounters(5000, 7, 12, 3, 40)
    lines = screen(view_of(patch=PATCH, force_n=1.9, counters=counters))
    text = "\n".join(line.rstrip() for line in lines)
    for part in (
        "● touched",
        "force  2.000 ± 0.19 N",
        "at     -20.0° ± 15.0°",
        "height 8.1 ± 1.5 mm",
        "250.0 frames/s  age 8 ms",
        "lost 7 faults 12 dropped 40 misshapen 3",
    ):
        assert part in re.sub(r"\n(?=40|misshapen)", " ", text), part
    flags = re.sub(r"\s+", " ", text)
    assert "a dead or hot taxel in or beside the patch" in flags
    assert "wider than one edge explains: probably two edges in a notch" in flags
    (bar,) = [line for line in lines if "▕" in line]
    assert bar.startswith("▕████▊")
    assert "▏ 8 N" in bar


def test_the_range_of_normals_is_bracketed_under_its_columns() -> None:
    """Column k stands at (k - 9.5) 13.5°: -35°, -20° and -5° are nearest to columns 7, 8 and 9."""
    lines = screen(view_of(patch=PATCH))
    (line,) = [line for line in lines if "├" in line]
    assert line.rstrip() == "       ├┼┤"
    (line,) = [line for line in screen(view_of(patch=PATCH), width=80) if "├" in line]
    assert line.rstrip() == " " * 14 + "├──┼─┤", "two characters for a taxel"
    beyond = replace(PATCH, angle_rad=math.radians(130), angle_half_range_rad=math.radians(20))
    (line,) = [line for line in screen(view_of(patch=beyond)) if "├" in line]
    assert "┤" not in line


def test_three_fingers_side_by_side_in_80_columns_and_one_below_the_other_in_30() -> None:
    views = [replace(view_of(patch=PATCH), name=f"f{k}") for k in (1, 2, 3)]
    lines = screen(*views, width=80)
    assert max(map(len, lines)) <= 80
    assert re.match(r"f1 +● touched +f2 +● touched +f3 +● touched", lines[3])
    narrow = screen(*views, width=30)
    assert max(map(len, narrow)) <= 30
    assert [line.split()[0] for line in narrow if line.startswith("f") and "touched" in line] == [
        "f1",
        "f2",
        "f3",
    ]


def test_wide_terminals_get_wide_taxels() -> None:
    taxel_n = np.zeros((8, 20))
    taxel_n[7, 3] = 0.6
    lines = screen(view_of(taxel_n=taxel_n), width=80)
    assert lines[4].startswith(" " * 6 + "@@ ")


def test_an_array_larger_than_the_terminal_is_shown_in_blocks() -> None:
    rows, cols = 64, 64
    large = replace(
        DESCRIPTION,
        shape=Shape.FLAT,
        rows=rows,
        cols=cols,
        columns=tuple(float(k) for k in range(cols)),
        row_heights_mm=tuple(float(k) for k in range(rows)),
    )
    taxel_n = np.zeros((rows, cols))
    taxel_n[10, 33] = 0.6
    lines = screen(view_of(large, taxel_n=taxel_n, patch=PATCH), width=40)
    assert max(map(len, lines)) <= 40
    assert sum(line.count("@") for line in lines[:-2]) == 1
    assert "a cell is the strongest of 3 x 3 taxels" in "\n".join(lines)
    assert "direction not known: flat array" in re.sub(r"\s+", " ", "\n".join(lines))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"age_s": 0.8, "force_n": None}, "no frames"),
        ({"counts": None, "force_n": None}, "no frames"),
        ({"tare": TareState.NONE, "force_n": None}, "not tared"),
        ({"tare": TareState.UNDER_WAY, "force_n": None}, "taring"),
        ({}, "○ free"),
    ],
)
def test_the_word_for_how_a_finger_is(changes: dict[str, object], word: str) -> None:
    view = view_of(**changes)
    lines = screen(view)
    assert re.match(rf"f1 +{word}", lines[3])
    assert any(f"force  – ({word})" in line for line in lines) == (view.force_n is None)


def test_the_head_names_the_keys_where_anybody_can_type() -> None:
    assert "q end" not in "\n".join(screen(view_of()))
    assert screen(view_of(), keys=True, width=80)[0].endswith("q end  t tare  r reset counts")
    assert screen(view_of(), keys=True, width=40)[1].strip() == "q end  t tare  r reset counts"


def test_a_height_that_is_not_known_is_left_out_of_lines() -> None:
    patch = replace(PATCH, height_mm=math.nan, height_bound_mm=math.inf)
    said = line_of(view_of(force_n=2.0, patch=patch), 1.0)
    assert "touched at" in said
    assert not re.search(r"height|nan|inf", said)


def test_a_saturated_contact_in_lines_and_as_json() -> None:
    patch = replace(PATCH, force_bound_n=math.inf, centroid_rad=math.nan)
    view = view_of(patch=patch, force_n=2.1)
    assert "force  2.000 N or more" in "\n".join(screen(view))
    out = out_of([view], t_s=1.0, rig="bench", session=None).fingers[0].contact
    assert out is not None
    assert (out.force_bound_n, out.centroid_rad) == (None, None)
    assert line_of(view, 1.0).startswith(
        "    1.00 s  f1  2.000 N, touched at -20.0° ± 15.0°, height 8.1 ± 1.5 mm, a dead or hot taxel"
    )
