"""The listing of `palpate objects show`: a table of states, then twins.

What goes on a screen is what a person reads there; `--all` lists every state and every pair.
"""

import math
import textwrap
from collections.abc import Iterable, Iterator
from itertools import groupby

from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from palpate.base.errors import counted
from palpate.base.vocabulary import PushResponse
from palpate.config.objects_result import ObjectsListingOut, StateListedOut, StateNameOut
from palpate.views.catalogue.check_text import fit_words, pair_lines, rig_words
from palpate.views.catalogue.equivalent_pairs import TwinGroup, group_pairs
from palpate.views.catalogue.known_heights import known_words
from palpate.views.tables import table

__all__ = ["print_listing"]

_SHOWN = 20  # twins, and states of an object
_RANGES = 3
_SHOWN_PUSHED = 6
_NAME = 20  # columns for a name
_MET = {"all": "all", "some": "some", "none": "none", "unknown": "?*"}
_SIGNS = {"same": "=", "doubtful": "≈", "unknown": "?"}


def print_listing(out: ObjectsListingOut, console: Console, *, every: bool = False) -> None:
    """Print the states object by object, twins, and where the picture is.

    `every`: all states, and each pair that feels alike for itself.
    """
    objects = len({item.object for item in out.states})
    console.print(
        f"{out.objects}: {counted(objects, 'object', 'objects')}, "
        f"{counted(len(out.states), 'state', 'states')}\n"
    )
    console.print(_table(out, every=every))
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
        console.print(f"not in it, for want of room: {counted(len(out.left_out), 'state', 'states')}")


def _table(out: ObjectsListingOut, *, every: bool) -> Table:
    numbers = "sections", "edges", "top mm", "symmetry", "prob.", "tips", "met by"
    rows = table(Column("object", width=_NAME, no_wrap=True), *numbers, numbers=numbers)
    for name, states in groupby(out.states, key=lambda item: item.object):
        listed = list(states)
        first = listed[0]
        tolerance = f" ±{_up(first.tolerance_mm):g} mm" if first.tolerance_mm else ""
        rows.add_row(Text(f"{_cut(name, _NAME - len(tolerance))}{tolerance}", style="bold"))
        shown = len(listed) if every or len(listed) <= _SHOWN + 1 else _SHOWN
        for state in listed[:shown]:
            rows.add_row(*_cells(state))
        if shown < len(listed):
            rows.add_row(f"  and {len(listed) - shown} more; --all")
    return rows


def _cells(state: StateListedOut) -> list[str]:
    low, high = state.edges
    tips = state.tipping_angle_rad
    return [
        f"  {_cut(state.state, _NAME - 2)}",
        str(state.sections),
        str(low) if low == high else f"{low}–{high}",
        f"{state.top_mm:.4g}",
        {0: "round", 1: "–"}.get(state.symmetry_order, f"{state.symmetry_order}-fold"),
        "–" if state.probability is None else f"{100 * state.probability:.3g} %",
        "–" if tips is None else f"{math.degrees(tips):.3g}°",
        _MET[state.fingers],
    ]


def _up(tolerance_mm: float) -> float:
    """Rounded up to thousandths."""
    return math.ceil(1000 * tolerance_mm - 1e-6) / 1000


def _known_lines(out: ObjectsListingOut, width: int, *, every: bool) -> Iterator[str]:
    """Which states are not known at the fingers' heights, a line for those of an object that are known alike.

    `every`: not at all heights.
    """
    alike: dict[tuple[str, str], list[StateNameOut]] = {}
    for item in out.states:
        if item.heights_mm is not None and (every or item.fingers == "unknown"):
            words = known_words(item.heights_mm, item.top_mm, len(item.heights_mm) + 1 if every else _RANGES)
            name = StateNameOut(object=item.object, state=item.state)
            alike.setdefault((item.object, words), []).append(name)
    shown = len(alike) if every or len(alike) <= _SHOWN + 1 else _SHOWN
    for (_, words), states in list(alike.items())[:shown]:
        yield from _wrapped(f"{_names(states)} {'is' if len(states) == 1 else 'are'} {words}", "* ", width)
    left = sum(len(states) for states in list(alike.values())[shown:])
    if left:
        yield f"* and {counted(left, 'more state is', 'more states are')} not known there; --all"


def _pushed_lines(out: ObjectsListingOut, width: int, *, every: bool) -> Iterator[str]:
    """Which states the fingers may tip or roll, for which bounds would not hold."""
    unsteady = [item for item in out.states if item.when_pushed is not PushResponse.SLIDES]
    if not unsteady:
        return
    yield "when pushed (bounds hold for parts that slide):"
    shown = len(unsteady) if every or len(unsteady) <= _SHOWN_PUSHED + 1 else _SHOWN_PUSHED
    for item in unsteady[:shown]:
        yield from _wrapped(f"{item.object}, {item.state} {item.why}", "  ", width)
    if shown < len(unsteady):
        yield f"  and {counted(len(unsteady) - shown, 'more state', 'more states')}; --all"
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
        for group in groups[:_SHOWN]:
            lines += _group_lines(group, width)
        if len(groups) > _SHOWN:
            pairs = sum(len(group.pairs) for group in groups[_SHOWN:])
            lines.append(f"  and {counted(pairs, 'more pair', 'more pairs')}; --all lists them")
    return [*lines, "`palpate objects check` says which heights would distinguish them", ""]


def _group_lines(group: TwinGroup, width: int) -> Iterator[str]:
    """States of which each is like each, or each of some like each of others."""
    sign = _SIGNS[group.pairs[0].likeness]
    if len(group.pairs) == 1:
        yield from pair_lines(group.pairs[0], sign)
        return
    if group.second:
        yield from _wrapped(f"each of {_names(group.first)}", f"  {sign} ", width)
        yield from _wrapped(f"and each of {_names(group.second)}", "    ", width)
    else:
        yield from _wrapped(f"each two of {_names(group.first)}", f"  {sign} ", width)
    yield f"      {fit_words(*group.pairs)}"


def _names(states: Iterable[StateNameOut]) -> str:
    """Such as "angle: state-1, state-2; block: state-1"."""
    return "; ".join(
        f"{name}: {', '.join(item.state for item in found)}"
        for name, found in groupby(states, key=lambda item: item.object)
    )


def _wrapped(words: str, begin: str, width: int) -> list[str]:
    return textwrap.wrap(
        words, width, initial_indent=begin, subsequent_indent=" " * (len(begin) + 2), break_long_words=False
    )


def _cut(name: str, room: int) -> str:
    return name if cell_len(name) <= room else f"{set_cell_size(name, room - 1).rstrip()}…"
