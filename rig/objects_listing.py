"""The listing of `palpate objects show`: a table of states, then twins. From the result to a terminal."""

import math
from itertools import groupby

from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palpate.config.objects_result import ObjectsListingOut, PairOut, StateListedOut
from palpate.rig.answer_words import counted
from palpate.rig.objects_check_words import fit_words, rig_words

__all__ = ["print_listing"]

_SHOWN = 20  # twins
_NAME = 26  # columns for a name
_SIGNS = {"same": "=", "doubtful": "≈", "unknown": "?"}


def print_listing(out: ObjectsListingOut, console: Console) -> None:
    """Print the states object by object, what feels alike, and where the picture is."""
    objects = len({item.object for item in out.states})
    console.print(
        f"{out.objects}: {counted(objects, 'object', 'objects')}, "
        f"{counted(len(out.states), 'state', 'states')}\n"
    )
    console.print(_table(out))
    console.print()
    for line in rig_words(out.rig):
        console.print(line)
    console.print()
    for line in _twin_lines(out):
        console.print(line)
    console.print(f"picture {out.picture}")
    if out.left_out:
        console.print(f"not in it, for want of room: {counted(len(out.left_out), 'state', 'states')}")


def _table(out: ObjectsListingOut) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("object", width=_NAME, no_wrap=True, overflow="ellipsis")
    for title in ("sections", "edges", "top mm", "symmetry", "prob.", "tips"):
        table.add_column(title, justify="right", no_wrap=True)
    for name, states in groupby(out.states, key=lambda item: item.object):
        first, *others = states
        tolerance = f" ±{first.tolerance_mm:.2g} mm" if first.tolerance_mm else ""
        table.add_row(Text(f"{_cut(name, _NAME - len(tolerance))}{tolerance}", style="bold"))
        for state in (first, *others):
            table.add_row(*_cells(state))
    return table


def _cells(state: StateListedOut) -> list[str]:
    low, high = state.edges
    tips = state.tipping_angle_rad
    return [
        f"  {_cut(state.state, _NAME - 2)}",
        str(state.sections),
        str(low) if low == high else f"{low}–{high}",
        f"{state.top_mm:.4g}" + ("" if state.heights_mm is None else "*"),
        "–" if state.symmetry_order == 1 else f"{state.symmetry_order}-fold",
        "–" if state.probability is None else f"{100 * state.probability:.3g} %",
        "–" if tips is None else f"{math.degrees(tips):.3g}°",
    ]


def _twin_lines(out: ObjectsListingOut) -> list[str]:
    lines = []
    for item in out.states:
        if item.heights_mm is not None:
            ranges = ", ".join(f"{low:.4g}–{high:.4g}" for low, high in item.heights_mm)
            lines.append(f"* {item.object}, {item.state} is known at {ranges} mm only")
    if not out.twins:
        return [*lines, "these fingers tell all states apart"]
    lines.append("not told apart by these fingers: = never, ≈ perhaps not, ? as far as known")
    for pair in out.twins[:_SHOWN]:
        lines += _pair_lines(pair)
    if len(out.twins) > _SHOWN:
        lines.append(f"  and {len(out.twins) - _SHOWN} more; --json lists them all")
    return [*lines, "`palpate objects check` says which heights would tell them apart", ""]


def _pair_lines(pair: PairOut) -> list[str]:
    first, second = (f"{item.object}, {item.state}" for item in (pair.first, pair.second))
    sign = _SIGNS[pair.likeness]
    short = len(first) + len(second) <= 72
    names = [f"  {first}  {sign}  {second}"] if short else [f"  {first}", f"  {sign} {second}"]
    return [*names, f"      {fit_words(pair)}"]


def _cut(name: str, room: int) -> str:
    return name if cell_len(name) <= room else f"{set_cell_size(name, room - 1).rstrip()}…"
