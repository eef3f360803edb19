"""Groups of states that feel alike hold the same pairs as the list of pairs; heights are told with care."""

from collections import Counter
from itertools import combinations, product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wording import missing

from palpate.config.catalogue_results import PairOut, StateNameOut
from palpate.views.catalogue.check_text import fit_words
from palpate.views.catalogue.layout import known_words
from palpate.views.catalogue.listing import TwinGroup, group_pairs


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
