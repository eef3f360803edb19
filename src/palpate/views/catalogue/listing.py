"""The listing of `palpate objects show`: a table of states, then twins, in groups."""

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from rich.console import Console
from rich.table import Table
from rich.text import Text

from palpate.base.errors import quantity
from palpate.base.vocabulary import PushResponse
from palpate.config.catalogue_results import ObjectsListingOut, PairOut, StateListedOut, StateNameOut
from palpate.views.catalogue.check_text import fit_words, known_words, pair_lines, rig_words
from palpate.views.numerals import ceil_to
from palpate.views.tables import table

_Name = tuple[str, str]
_Relation = tuple[object, ...]


@dataclass(frozen=True)
class TwinGroup:
    """Every state of `first` with every one of `second`; if that is empty, all of `first` with each other.

    `pairs`: all of them, at least one. They are alike in everything but `apart_mm`.
    """

    first: tuple[StateNameOut, ...]
    second: tuple[StateNameOut, ...]
    pairs: tuple[PairOut, ...]


def group_pairs(pairs: Sequence[PairOut]) -> tuple[TwinGroup, ...]:
    """The pairs in groups, ordered by the first pair of each."""
    names = {_key(item): item for pair in pairs for item in (pair.first, pair.second)}
    relations: dict[_Name, dict[_Name, _Relation]] = {name: {} for name in names}
    for pair in pairs:
        one, other = _key(pair.first), _key(pair.second)
        relations[one][other] = relations[other][one] = _relation(pair)
    groups = _groups(relations)
    group_of = {name: number for number, group in enumerate(groups) for name in group}
    together: dict[tuple[int, int], list[PairOut]] = {}
    for pair in pairs:
        first, second = group_of[_key(pair.first)], group_of[_key(pair.second)]
        together.setdefault((min(first, second), max(first, second)), []).append(pair)
    members = [tuple(names[name] for name in group) for group in groups]
    return tuple(
        TwinGroup(members[one], () if one == other else members[other], tuple(found))
        for (one, other), found in together.items()
    )


def _groups(relations: dict[_Name, dict[_Name, _Relation]]) -> list[list[_Name]]:
    """The states in groups. Standing alike to all others is transitive: one of a group stands for it."""
    groups: list[list[_Name]] = []
    for name, own in relations.items():
        for group in groups:
            if _are_equivalent(name, own, group[0], relations[group[0]]):
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _are_equivalent(
    one: _Name, to_one: dict[_Name, _Relation], other: _Name, to_other: dict[_Name, _Relation]
) -> bool:
    if len(to_one) != len(to_other):
        return False
    return all(to_other.get(name) == how for name, how in _other_relations(to_one, other)) and all(
        to_one.get(name) == how for name, how in _other_relations(to_other, one)
    )


def _other_relations(relations: dict[_Name, _Relation], name: _Name) -> Iterator[tuple[_Name, _Relation]]:
    return ((other, how) for other, how in relations.items() if other != name)


def _key(state: StateNameOut) -> _Name:
    return state.object, state.state


def _relation(pair: PairOut) -> _Relation:
    """All that is said of a pair but its distance."""
    return pair.likeness, pair.compared_mm, pair.apart_mm is None, pair.tolerance_mm, pair.within_mm


_MAX_ROWS = 20  # twins, and states of an object
_MAX_RANGES = 3
_MAX_PUSHED = 6
_FULL_WIDTH, _LEAST = 76, ("sections", "edges")  # columns of a terminal, and what narrower ones leave out
_MET = {"all": "all", "some": "some", "none": "none", "unknown": "?*"}
_SIGNS = {"same": "=", "doubtful": "≈", "unknown": "?"}


def print_listing(out: ObjectsListingOut, console: Console, *, every: bool = False) -> None:
    """Print the states object by object, twins, and where the picture is.

    `every`: all states, and each pair that feels alike for itself.
    """
    objects = len({item.object for item in out.states})
    console.print(
        f"{out.objects}: {quantity(objects, 'object', 'objects')}, "
        f"{quantity(len(out.states), 'state', 'states')}\n"
    )
    rows = _table(out, every=every)
    if console.width < _FULL_WIDTH:  # names need the room; the JSON has it all
        rows.columns = [column for column in rows.columns if column.header not in _LEAST]
    console.print(rows)
    console.print()
    for line in rig_words(out.rig):
        console.print(line)
    console.print()
    for line in _known_lines(out, console.width, every=every):
        console.print(line)
    for line in _pushed_lines(out, console.width, every=every):
        console.print(line)
    for line in _twin_lines(out, console.width, every=every):
        console.print(line)
    more = f" to {out.pictures[-1]}" if len(out.pictures) > 1 else ""
    console.print(f"picture {out.picture}{more}")
    if out.left_out:
        console.print(f"not in it, for want of room: {quantity(len(out.left_out), 'state', 'states')}")


def _table(out: ObjectsListingOut, *, every: bool) -> Table:
    numbers = "sections", "edges", "top mm", "symmetry", "prob.", "tips", "met by"
    rows = table("object", *numbers, numbers=numbers)
    for name, states in groupby(out.states, key=lambda item: item.object):
        listed = list(states)
        first = listed[0]
        tolerance = f" ±{ceil_to(first.tolerance_mm, 3):g} mm" if first.tolerance_mm else ""
        rows.add_row(Text(f"{name}{tolerance}", style="bold"))
        shown = len(listed) if every or len(listed) <= _MAX_ROWS + 1 else _MAX_ROWS
        for state in listed[:shown]:
            rows.add_row(*_cells(state))
        if shown < len(listed):
            rows.add_row(f"  and {len(listed) - shown} more; --all")
    return rows


def _cells(state: StateListedOut) -> list[Text | str]:
    low, high = state.edges
    tips = state.tipping_angle_rad
    return [
        Text(f"  {state.state}"),
        str(state.sections),
        str(low) if low == high else f"{low}–{high}",
        f"{state.top_mm:.4g}",
        {0: "round", 1: "–"}.get(state.symmetry_order, f"{state.symmetry_order}-fold"),
        "–" if state.probability is None else f"{100 * state.probability:.3g} %",
        "–" if tips is None else f"{math.degrees(tips):.3g}°",
        _MET[state.fingers],
    ]


def _known_lines(out: ObjectsListingOut, width: int, *, every: bool) -> Iterator[str]:
    """List states not known at the fingers' heights, a line for those of an object that are known alike.

    `every`: not at all heights.
    """
    alike: dict[tuple[str, str], list[StateNameOut]] = {}
    for item in out.states:
        if item.heights_mm is not None and (every or item.fingers == "unknown"):
            words = known_words(
                item.heights_mm, item.top_mm, len(item.heights_mm) + 1 if every else _MAX_RANGES
            )
            name = StateNameOut(object=item.object, state=item.state)
            alike.setdefault((item.object, words), []).append(name)
    shown = len(alike) if every or len(alike) <= _MAX_ROWS + 1 else _MAX_ROWS
    for (_, words), states in list(alike.items())[:shown]:
        yield from _wrap(f"{_names(states)} {'is' if len(states) == 1 else 'are'} {words}", "* ", width)
    left = sum(len(states) for states in list(alike.values())[shown:])
    if left:
        yield f"* and {quantity(left, 'more state is', 'more states are')} not known there; --all"


def _pushed_lines(out: ObjectsListingOut, width: int, *, every: bool) -> Iterator[str]:
    """Say which states the fingers may tip or roll, for which bounds would not hold."""
    unsteady = [item for item in out.states if item.when_pushed is not PushResponse.SLIDES]
    if not unsteady:
        return
    yield "when pushed (bounds hold for parts that slide):"
    shown = len(unsteady) if every or len(unsteady) <= _MAX_PUSHED + 1 else _MAX_PUSHED
    for item in unsteady[:shown]:
        yield from _wrap(f"{item.object}, {item.state} {item.why}", "  ", width)
    if shown < len(unsteady):
        yield f"  and {quantity(len(unsteady) - shown, 'more state', 'more states')}; --all"
    yield ""


def _twin_lines(out: ObjectsListingOut, width: int, *, every: bool) -> list[str]:
    if not out.twins:
        return ["these fingers distinguish all states"]
    lines = ["not distinguished by these fingers: = never, ≈ perhaps not, ? as far as known"]
    if every:
        for pair in out.twins:
            lines += pair_lines(pair, _SIGNS[pair.likeness])
    else:
        groups = group_pairs(out.twins)
        for group in groups[:_MAX_ROWS]:
            lines += _group_lines(group, width)
        if len(groups) > _MAX_ROWS:
            pairs = sum(len(group.pairs) for group in groups[_MAX_ROWS:])
            lines.append(f"  and {quantity(pairs, 'more pair', 'more pairs')}; --all lists them")
    return [*lines, "`palpate objects check` says which heights would distinguish them", ""]


def _group_lines(group: TwinGroup, width: int) -> Iterator[str]:
    """States of which each is like each, or each of some like each of others."""
    sign = _SIGNS[group.pairs[0].likeness]
    if len(group.pairs) == 1:
        yield from pair_lines(group.pairs[0], sign)
        return
    if group.second:
        yield from _wrap(f"each of {_names(group.first)}", f"  {sign} ", width)
        yield from _wrap(f"and each of {_names(group.second)}", "    ", width)
    else:
        yield from _wrap(f"each two of {_names(group.first)}", f"  {sign} ", width)
    yield f"      {fit_words(*group.pairs)}"


def _names(states: Iterable[StateNameOut]) -> str:
    """List of names such as "angle: state-1, state-2; block: state-1"."""
    return "; ".join(
        f"{name}: {', '.join(item.state for item in found)}"
        for name, found in groupby(states, key=lambda item: item.object)
    )


def _wrap(words: str, begin: str, width: int) -> list[str]:
    return textwrap.wrap(
        words, width, initial_indent=begin, subsequent_indent=" " * (len(begin) + 2), break_long_words=False
    )
