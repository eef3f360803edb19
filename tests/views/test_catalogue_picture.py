"""Pictures of catalogues and of pairs that cannot be told apart."""

import xml.etree.ElementTree as ET
from collections import Counter
from functools import partial
from itertools import combinations, product
from pathlib import Path
from typing import Any

import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from palpate.config import load_objects, shipped_objects
from palpate.config.catalogue_results import PairOut, StateNameOut
from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import (
    StateSections,
    state_sections,
    symmetry_of_region,
    symmetry_of_state,
)
from palpate.views.catalogue.card import (
    CONCAVE,
    HEIGHT,
    UNREACHED,
    WIDTH,
    CardFacts,
    TwinNote,
    ranges_words,
    shade,
    side_rings,
)
from palpate.views.catalogue.check_text import fit_words, known_words
from palpate.views.catalogue.listing import TwinGroup, group_pairs
from palpate.views.catalogue.picture import MAX_CONTOURS, cards_of, draw_objects
from palpate.views.svg import CARD, FOUND, TIP, shorten_middle, text_width
from palpate.views.table_picture.frame import Box
from support.benches.parts import (
    L_SHAPE,
    fingers_at,
    moved,
    polygon,
    rectangle,
    section,
    stacked_part,
    states_of,
)
from support.commands.command import missing

# ----------------------------------------------------------------------------------------------------
# The picture of objects: well-formed, nothing clipped or covered, bounded, and drawn as it is.

NS = "{http://www.w3.org/2000/svg}"
FINGERS = fingers_at(5, 6, 60)
U_SHAPE = [[0, 0], [60, 0], [60, 50], [48, 50], [48, 14], [12, 14], [12, 50], [0, 50]]


@pytest.fixture
def states(tmp_path: Path) -> Any:
    return partial(states_of, tmp_path)


LONG = "bracket-with-a-name-as-from-a-drawing-office, state-1"
TWINS = (
    TwinNote("feels like", tuple(f"state-{k}" for k in range(2, 9))),
    TwinNote("may feel like", (LONG, "that")),
    TwinNote("as far as known like", (LONG,)),
)


def drawn(found: tuple[StateSections, ...], fingers: RigFingers = FINGERS) -> ET.Element:
    """The picture, parsed; every state feels like some, of which one has a long name."""
    told = {state: CardFacts(symmetry_of_state(state).order, TWINS) for state in found}
    (page,), _ = draw_objects("parts.json", found, told, fingers)
    return ET.fromstring(page)


def odd_parts() -> list[dict[str, Any]]:
    cone = [section(k / 4, (k + 1) / 4, polygon(48, 40 - k / 6)) for k in range(200)]
    twisted = [section(k, k + 1, moved(U_SHAPE, k / 90, 0, 0)) for k in range(70)]
    known = {"heights": [[4.5, 5.5], [9.5, 10.5]], "height": 40.0}
    gaps = {"heights": [[100.11 * k, 100.11 * k + 100.07] for k in range(9)], "height": 1000.0}
    grid = [section(low, high, U_SHAPE) for low, high in gaps["heights"]]
    return [
        stacked_part("cone", *cone, probability=0.123456, tipping_angle=0.4321, tolerance=0.05),
        stacked_part("twisted-U", *twisted),
        stacked_part("long " + 'ÄÖ<&>"部品' * 10, section(0, 900, rectangle(800, 35)), probability=1.0),
        stacked_part("tiny", section(0, 1.25, polygon(5, 0.6))),
        stacked_part(
            "manifold", section(0, 12, rectangle(120, 60), holes=[moved(polygon(24, 8), 0, 40, 30)])
        ),
        stacked_part(
            "storeys", section(0, 5, L_SHAPE), section(5, 9, rectangle(9, 9)), section(9, 70, L_SHAPE)
        ),
        stacked_part("known", section(4.5, 5.5, L_SHAPE), section(9.5, 10.5, rectangle(9, 9)), **known),
        stacked_part("posts", section(0, 30, rectangle(12, 30), rectangle(12, 30, 58))),
        stacked_part("gaps", *grid, **gaps),
    ]


def texts(picture: ET.Element) -> list[tuple[Box, str]]:
    """Every text outside of the legend, with the box that it takes at most."""
    found = []
    for item in picture.findall(f"{NS}text"):
        size, words = float(item.attrib["font-size"]), item.text or ""
        width = text_width(words, size, bold="font-weight" in item.attrib)
        left = float(item.attrib["x"]) - {"end": width, "middle": width / 2}.get(
            item.get("text-anchor", ""), 0
        )
        found.append((Box(left + width / 2, float(item.attrib["y"]) - 0.35 * size, width, 0.7 * size), words))
    return found


def cards(picture: ET.Element) -> list[Box]:
    boxes = []
    for item in picture.findall(f"{NS}rect"):
        if item.get("fill") == CARD:
            x, y = float(item.attrib["x"]), float(item.attrib["y"])
            boxes.append(Box(x + WIDTH / 2, y + HEIGHT / 2, WIDTH, HEIGHT))
    return boxes


def test_texts_cover_no_other_and_stay_inside_of_their_cards(states: Any) -> None:
    picture = drawn(states(*odd_parts()))
    words = texts(picture)
    said = [line for _, line in words]
    assert said.count("feels like state-2; state-3 and 5 more") == 9
    assert any(line.startswith("may feel like bracket") and line.endswith("1 and 1 more") for line in said)
    assert "not known at 9 ranges of height" in said
    for (first, one), (second, other) in combinations(words, 2):
        assert not first.overlaps(second), f"{one!r} and {other!r}"
    frames = cards(picture)
    assert len(frames) == 9
    top = min(frame.top for frame in frames)
    for box, said in words:
        if box.y > top:
            inside = [
                frame
                for frame in frames
                if abs(box.x - frame.x) <= (frame.width - box.width) / 2
                and abs(box.y - frame.y) <= (frame.height - box.height) / 2
            ]
            assert len(inside) == 1, f"{said!r} sticks out of its card"


def test_sections_stay_inside_of_their_cards_and_leave_the_texts_free(states: Any) -> None:
    picture = drawn(states(*odd_parts()))
    frames, words = cards(picture), texts(picture)
    outlines = [item for item in picture.findall(f"{NS}path") if item.get("stroke-linejoin") == "round"]
    assert len(outlines) > 20
    for item in outlines:
        points = [pair.split(",") for ring in item.attrib["d"].split("Z") for pair in ring.strip("M").split()]
        xs, ys = [float(x) for x, _ in points], [float(y) for _, y in points]
        box = Box((min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2, max(xs) - min(xs), max(ys) - min(ys))
        (frame,) = [item for item in frames if item.overlaps(box)]
        assert abs(box.x - frame.x) <= (frame.width - box.width) / 2
        assert not [said for at, said in words if at.overlaps(box)]


def test_the_picture_is_the_same_each_time_and_tells_itself_in_words(states: Any) -> None:
    found = states(*odd_parts())
    told = {state: CardFacts(1, ()) for state in found}
    first, second = (draw_objects("a.json", found, told, FINGERS)[0] for _ in range(2))
    assert first == second
    description = ET.fromstring(first[0]).findtext(f"{NS}desc")
    assert description is not None
    assert description.count("up to") == len(found)


def test_pockets_are_shaded_where_they_are(states: Any) -> None:
    def fills(*rings: Any, holes: Any = ()) -> tuple[int, int]:
        picture = drawn(states(stacked_part("a", section(0, 20, *rings, holes=holes))))
        shown = [item.get("fill") for item in picture.findall(f"{NS}path")]
        return shown.count(CONCAVE), shown.count(UNREACHED)

    hole = moved(polygon(30, 8), 0, 30, 20)
    assert fills(rectangle(60, 40)) == (0, 0)
    assert fills(U_SHAPE) == (1, 1)
    assert fills(rectangle(60, 40), holes=[hole]) == (1, 1)
    assert fills(rectangle(60, 40), rectangle(60, 40, 75)) == (1, 0)
    assert fills(rectangle(60, 40), rectangle(60, 40, 69)) == (1, 1)


@pytest.mark.parametrize(("corners", "rays", "circles"), [(3, 3, 1), (4, 4, 1), (12, 12, 1), (64, 0, 2)])
def test_symmetry_is_drawn_as_rays_or_as_a_circle(states: Any, corners: int, rays: int, circles: int) -> None:
    (state,) = states(stacked_part("a", section(0, 20, moved(polygon(corners, 30), 0.2, 40, 50))))
    found = symmetry_of_region(state.levels[0].region)
    assert found.order == corners
    assert found.centre_mm == pytest.approx([40, 50])
    picture = drawn((state,))
    dashed = [item for item in picture.findall(f"{NS}line") if "stroke-dasharray" in item.attrib]
    assert len(dashed) == rays
    assert len(picture.findall(f"{NS}circle")) == circles
    assert any(f"{corners}-fold symmetric" in said for _, said in texts(picture))


def test_a_part_without_symmetry_has_no_marks_of_it(states: Any) -> None:
    picture = drawn(states(stacked_part("a", section(0, 20, L_SHAPE))))
    assert not picture.findall(f"{NS}circle")
    assert any("not symmetric" in said for _, said in texts(picture))


def test_different_sections_of_a_state_are_one_card(states: Any) -> None:
    (state,) = states(odd_parts()[5])
    (card,), left_out = cards_of([state], FINGERS)
    assert not left_out
    assert card.is_stack
    assert [level.z_mm for level in card.shown] == [(0, 5), (5, 9), (9, 70)]
    assert ranges_words([(0, 5), (9, 70)]) == "0–5 and 9–70"
    assert ranges_words([(0, 1), (2, 3), (4, 5), (6, 7), (8, 9)]) == "0–1, 2–3, 4–5 and 2 more"


def test_of_many_sections_some_are_drawn_with_those_that_fingers_meet(states: Any) -> None:
    found = states(odd_parts()[0])
    (card,), _ = cards_of(found, FINGERS)
    shown = [level.z_mm for level in card.shown]
    assert len(shown) <= MAX_CONTOURS
    assert (0, 0.25) in shown
    assert (49.75, 50) in shown
    assert (5, 5.25) in shown
    picture = drawn(found)
    outlines = [item.get("stroke") for item in picture.findall(f"{NS}path") if item.get("fill") == "none"]
    assert outlines.count(TIP) == sum(low <= z <= high for low, high in shown for z in (5, 6))
    assert FOUND not in outlines
    assert any(said.startswith(f"{len(shown)} of 200 sections up to 50 mm") for _, said in texts(picture))


def test_a_large_file_makes_pages_of_bounded_size_that_say_what_is_left_out(
    states: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("palpate.views.catalogue.picture.MAX_CARDS", 240)
    tall = [
        stacked_part(f"p{k}", *(section(z, z + 1, polygon(60, 30 - z)) for z in range(5))) for k in range(250)
    ]
    found = states(*tall)
    told = {state: CardFacts(1, ()) for state in found}
    pages, left_out = draw_objects("many.json", found, told, FINGERS)
    assert [state.object_name for state in left_out] == [f"p{k}" for k in range(240, 250)]
    assert len(pages) == 4
    assert max(map(len, pages)) < 1e6
    parsed = [ET.fromstring(page) for page in pages]
    assert [len(cards(page)) for page in parsed] == [60] * 4
    assert any("page 3 of 4" in words for _, words in texts(parsed[2]))
    said = " ".join(words for _, words in texts(parsed[3]))
    assert "Not drawn, for want of room: 10 states: p240, s; " in said
    assert "and 4 more" in said


def test_shipped_objects_have_a_card_each() -> None:
    found = state_sections(load_objects(shipped_objects()))
    picture = drawn(found)
    assert len(cards(picture)) == len(found) == 6


def test_names_keep_their_ends_where_they_are_too_long() -> None:
    assert shorten_middle("plate", 12, 100) == "plate"
    short = shorten_middle("bracket-with-a-long-name-rev-C", 12, 120)
    assert short.startswith("bracket")
    assert short.endswith("rev-C")
    assert "…" in short
    assert text_width(short, 12) <= 120
    assert shorten_middle("部" * 50, 12, 5) == "…"


def test_higher_is_darker() -> None:
    colours = [shade(z, 40) for z in (0, 10, 20, 30, 40)]
    light = [sum(int(colour[k : k + 2], 16) for k in (1, 3, 5)) for colour in colours]
    assert light == sorted(light, reverse=True)
    assert len(set(light)) == 5


def test_sections_that_look_alike_are_drawn_as_one(states: Any) -> None:
    """A wall that leans a little is one section; one that leans more is many."""

    def numbers(step: float) -> list[int]:
        levels = [section(9 + k / 8, 9 + (k + 1) / 8, polygon(48, 20 - step * k)) for k in range(8)]
        found, _ = cards_of(states(stacked_part("a", *levels)), FINGERS)
        return [len(card.shown) for card in found]

    assert numbers(0.01) == [1]
    assert numbers(0.15) == [8]
    assert numbers(1.0) == [8]


def test_a_side_view_shows_which_side_is_down(states: Any) -> None:
    """From the file, or from sections that are known at all heights; none where neither says it."""
    tee = [section(0, 10, rectangle(10, 10, 15)), section(10, 20, rectangle(40, 10))]
    (ring,) = side_rings(states(stacked_part("t", *tee))[0].state)
    assert shapely.Polygon(ring).bounds == (0, 0, 40, 20)
    assert shapely.Polygon(ring).area == pytest.approx(500)
    known = {"heights": [[9.5, 10.5]], "height": 20.0}
    partly = stacked_part("t", section(9.5, 10.5, rectangle(40, 10)), **known)
    assert side_rings(states(partly)[0].state) == ()
    partly["states"][0]["side"] = [[[0, 0], [5, 0], [5, 20], [0, 20]], [[1, 5], [1, 9], [3, 9], [3, 5]]]
    (state,) = states(partly)
    assert [len(ring) for ring in side_rings(state.state)] == [4, 4]
    fills = [item.get("fill-rule") for item in drawn((state,)).findall(f"{NS}path")]
    assert fills.count("evenodd") >= 1


# ----------------------------------------------------------------------------------------------------
# Groups of states that feel alike hold the same pairs as the list of pairs; heights are told with care.


def state(number: int) -> StateNameOut:
    return StateNameOut(object=f"part {number // 4}", state=f"s{number % 4}")


def pair(first: int, second: int, likeness: str = "same", apart_mm: float | None = 0.1) -> PairOut:
    return PairOut.model_validate(
        {
            "first": state(first),
            "second": state(second),
            "likeness": likeness,
            "apart_mm": apart_mm,
            "tolerance_mm": 0.2,
            "within_mm": 1.0,
            "compared_mm": (10.0,),
        }
    )


def pairs_of(group: TwinGroup) -> list[frozenset[tuple[str, str]]]:
    """The pairs that a group says."""
    first, second = ([(item.object, item.state) for item in side] for side in (group.first, group.second))
    return [frozenset(names) for names in (product(first, second) if second else combinations(first, 2))]


def test_six_states_of_two_kinds_are_three_groups() -> None:
    kinds = [0, 0, 1, 1, 0, 0]
    twins = [pair(i, k, "same" if kinds[i] == kinds[k] else "doubtful") for i, k in combinations(range(6), 2)]
    within, across, other = group_pairs(twins)
    assert within.first == tuple(map(state, (0, 1, 4, 5)))
    assert not within.second
    assert (across.first, across.second) == (within.first, tuple(map(state, (2, 3))))
    assert {item.likeness for item in across.pairs} == {"doubtful"}
    assert other.first == across.second
    assert [len(group.pairs) for group in (within, across, other)] == [6, 8, 1]


def test_a_chain_stays_a_chain() -> None:
    found = group_pairs([pair(0, 1), pair(1, 2), pair(2, 3)])
    assert [len(group.pairs) for group in found] == [1, 1, 1]


def test_two_that_are_told_apart_are_alike_to_a_third() -> None:
    (group,) = group_pairs([pair(0, 2), pair(1, 2)])
    assert (group.first, group.second) == ((state(0), state(1)), (state(2),))


@given(st.lists(st.sampled_from(["same", "doubtful", None]), min_size=28, max_size=28))
def test_groups_say_every_pair_once_and_no_other(likeness: list[str | None]) -> None:
    ways = zip(combinations(range(8), 2), likeness, strict=True)
    twins = [pair(*both, how) for both, how in ways if how is not None]
    groups = group_pairs(twins)
    said = Counter(both for group in groups for both in pairs_of(group))
    wanted = {frozenset((item.object, item.state) for item in (one.first, one.second)) for one in twins}
    assert said == Counter(wanted)
    for group in groups:
        held = [frozenset((item.object, item.state) for item in (p.first, p.second)) for p in group.pairs]
        assert Counter(held) == Counter(pairs_of(group))
        assert len({item.likeness for item in group.pairs}) == 1


def test_a_group_tells_from_how_far_to_how_far_apart() -> None:
    apart = fit_words(pair(0, 1, apart_mm=0.1), pair(0, 2, apart_mm=0.157))
    assert missing(apart, "0.10–0.16 mm apart", "at 10 mm", "tolerances (0.20 mm)") == []
    assert fit_words(pair(0, 1, apart_mm=0.0), pair(0, 2, apart_mm=0.004)) == "the same at 10 mm"
    assert fit_words(pair(0, 1, apart_mm=None), pair(0, 2, apart_mm=None)).startswith(
        "at 10 mm there is noth"
    )


@pytest.mark.parametrize(
    ("known", "most", "words"),
    [
        ([(4.5, 5.5), (9.5, 10.5)], 3, "known at 4.5–5.5 and 9.5–10.5 mm only"),
        ([(4.501, 5.509)], 3, "known at 4.51–5.5 mm only"),
        ([(4.501, 4.502)], 3, "known at 4.501–4.502 mm only"),
        ([(0, 7.8124), (7.8321, 20)], 3, "not known at 7.81–7.84 mm"),
        ([(0, 7.82), (7.84, 20)], 3, "not known at 7.82–7.84 mm"),
        ([(1, 19.5)], 3, "not known at 0–1 and 19.5–20 mm"),
        ([(1, 2), (3, 4), (5, 19)], 2, "not known at 0–1, 2–3 mm and 2 more ranges"),
        ([(1, 2), (3, 4), (5, 19)], 0, "not known at 4 ranges of height"),
        ([(1, 2), (3, 4), (5, 6)], 0, "known at 3 ranges of height only"),
        ([(0, 20)], 1, "known at 0–20 mm only"),
    ],
)
def test_known_heights(known: list[tuple[float, float]], most: int, words: str) -> None:
    assert known_words(known, 20.0, most) == words
