"""The table of `palpate objects list`: what an objects file holds, object by object; nothing is compared."""

import math
from collections.abc import Iterable, Sequence
from pathlib import PurePath

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.base.errors import quantity
from palpate.config.catalogue_results import InventoryObjectOut, InventoryOut, InventoryStateOut
from palpate.config.objects_file import FLAT
from palpate.config.objects_tables import ObjectsFileText, ObjectText, StateText
from palpate.views.tables import folding_column, table

_UNKNOWN = "–"
_MAX_SHARES = 3  # states whose probability is listed
_FILE_WIDTH = 110  # columns of a terminal that has room for files' names
_ALONG_AXIS = math.cos(math.radians(0.5))
_Range = tuple[float, float]


def inventory_out(name: str, text: ObjectsFileText) -> InventoryOut:
    """`palpate/objects-inventory@1` of the objects file `name`."""
    objects = tuple(map(_object_out, text.objects))
    refused = tuple(item.source.file for item in text.refused or ())
    return InventoryOut(objects_file=name, objects=objects, refused=refused)


def _object_out(item: ObjectText) -> InventoryObjectOut:
    states = [_state_out(state) for state in item.states or ()]
    return InventoryObjectOut(
        name=item.name,
        tags=tuple(item.tags or ()),
        size=item.size,
        mass_g=item.mass_g,
        tolerance=item.tolerance,
        states=tuple(states or [_flat_out(item)]),
        source=None if item.source is None else item.source.file,
    )


def _flat_out(item: ObjectText) -> InventoryStateOut:
    return InventoryStateOut(
        name=FLAT, probability=None, down=None, tipping_angle=None, height=item.height, heights=None
    )


def _state_out(state: StateText) -> InventoryStateOut:
    heights = None if state.heights is None else tuple(state.heights)
    top = state.height or max(section.z[1] for section in state.sections)
    return InventoryStateOut.of(state, height=top, heights=heights)


def print_inventory(out: InventoryOut, console: Console) -> None:
    """Print the table, and how many objects and states there are."""
    console.print(_table(out, with_files=console.width >= _FILE_WIDTH))
    states = sum(len(item.states) for item in out.objects)
    count = quantity(len(out.objects), "object", "objects")
    console.print(f"\n{count}, {quantity(states, 'state', 'states')} in [bold]{escape(out.objects_file)}[/]")
    if out.refused:
        console.print(f"{quantity(len(out.refused), 'file was', 'files were')} refused by the import")


def _table(out: InventoryOut, *, with_files: bool) -> Table:
    has_mass = any(item.mass_g is not None for item in out.objects)
    has_tags = any(item.tags for item in out.objects)
    has_source = with_files and any(item.source is not None for item in out.objects)
    rows = table(
        "object",
        "size mm",
        *(["mass"] if has_mass else []),
        "states",
        "known at mm",
        *([folding_column("tags")] if has_tags else []),
        *([folding_column("from")] if has_source else []),
        numbers=("size mm", "mass"),
    )
    for item in out.objects:
        mass = _UNKNOWN if item.mass_g is None else f"{round(item.mass_g, 1):g} g"
        rows.add_row(
            escape(item.name),
            _size(item),
            *([mass] if has_mass else []),
            _states(item.states),
            _known(item.states),
            *([escape(", ".join(item.tags))] if has_tags else []),
            *([escape(PurePath(item.source or _UNKNOWN).name)] if has_source else []),
        )
    return rows


def print_states(out: InventoryOut, console: Console) -> None:
    """Print the states of each object: which side is down, how often, how high, and where they are known."""
    numbers = "probability", "height mm", "tips"
    rows = table("object", "down", *numbers, "known at mm", numbers=numbers)
    for item in out.objects:
        rows.add_row(f"[bold]{escape(item.name)}[/]")
        for state in item.states:
            share, tips = state.probability, state.tipping_angle
            rows.add_row(
                f"  {escape(state.name)}",
                _UNKNOWN if state.down is None else direction_words(state.down),
                _UNKNOWN if share is None else f"{100 * share:.2g} %",
                f"{state.height:.4g}",
                _UNKNOWN if tips is None else f"{math.degrees(tips):.3g}°",
                _known([state]),
            )
    console.print(rows)


def direction_words(direction: Sequence[float]) -> str:
    """An axis of the CAD file, such as −z, or the direction's three cosines."""
    for axis, value in zip("xyz", direction, strict=True):
        if abs(value) >= _ALONG_AXIS:
            return f"{'−' if value < 0 else '+'}{axis}"
    return f"({', '.join(f'{value:.2g}' for value in direction)})"


def _size(item: InventoryObjectOut) -> str:
    return _UNKNOWN if item.size is None else " × ".join(f"{round(length, 1):g}" for length in item.size)


def _states(states: Sequence[InventoryStateOut]) -> str:
    """How many there are, and the largest probabilities."""
    shares = sorted((item.probability for item in states if item.probability is not None), reverse=True)
    if not shares:
        return str(len(states))
    words = ", ".join(f"{100 * share:.2g}" for share in shares[:_MAX_SHARES])
    return f"{len(states)}: {words}{', …' if len(shares) > _MAX_SHARES else ''} %"


def _known(states: Sequence[InventoryStateOut]) -> str:
    """Heights at which every state is known, in words."""
    if all(item.heights is None for item in states):
        return "all heights"
    common = common_heights_mm(states)
    if not common:
        return "none in common"
    low, high = common[0][0], common[-1][1]
    words = f"{low:.4g} and up" if math.isinf(high) else f"{low:.4g}–{high:.4g}"
    return f"{words}, in part" if len(common) > 1 else words


def common_heights_mm(states: Iterable[InventoryStateOut]) -> list[_Range]:
    """Ranges of height at which every state is known, ascending: above a part there is nothing."""
    common: list[_Range] = [(0.0, math.inf)]
    for state in states:
        if state.heights is None:
            continue
        own = [*state.heights, (state.height, math.inf)]
        both = [(max(a, c), min(b, d)) for a, b in common for c, d in own]
        common = sorted((low, high) for low, high in both if low < high)
    top = max((item.height for item in states), default=0.0)
    return [item for item in common if item[0] < top]
