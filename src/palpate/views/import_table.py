"""The result of an import, for a terminal of 80 columns."""

import math
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.base.errors import quantity
from palpate.config.catalogue_results import ImportedFileOut, ImportedObjectOut, ImportedStateOut, ImportOut
from palpate.config.objects_checks import heights_in_words
from palpate.rig.catalogue.folder_import import Catalogued, some_of
from palpate.views.tables import folding_column, table

_UNKNOWN = "–"
_MAX_STATES = 6
_MAX_REFUSED = 4  # parts of a file whose reasons are shown


def show_import(out: ImportOut, console: Console) -> None:
    """Every object with its states and what was left out, then where they are and what to do next."""
    for item in out.objects:
        _show_object(item, console)
    for warning in out.warnings:
        console.print(f"[yellow]![/] {escape(warning)}")
    _show_refused(out, console)
    count = quantity(len(out.objects), "object", "objects")
    console.print(f"{count} in [bold]{escape(out.objects_file)}[/] ({_size(out.bytes)}), {out.seconds:.1f} s")
    console.print(f"see them: palpate objects show {escape(_quote(out.objects_file))}", soft_wrap=True)


def files_out(made: Catalogued) -> tuple[ImportedFileOut, ...]:
    """Outcome of each of several files."""
    return tuple(
        ImportedFileOut(
            file=str(item.path),
            objects=item.kept or tuple(each.result.name for each in item.objects),
            kept=item.unchanged,
            failure=item.failure,
            refused=item.refused,
            seconds=item.seconds,
        )
        for item in made.files
    )


def show_files(out: ImportOut, console: Console) -> None:
    """A line for each new object of several files, then what was kept, left out or refused."""
    if out.objects:
        console.print(_objects(out.objects))
    kept = [item for item in out.files if item.kept and item.failure is None]
    if kept:
        console.print(f"{quantity(len(kept), 'file has', 'files have')} not changed")
    for item in out.objects:
        for left in item.left_out:
            count = quantity(left.states, "state", "states")
            text = f"{item.name}: left out: {count}, {_percent(left.probability)}: {left.reason}"
            console.print(f"[yellow]![/] {escape(text)}", soft_wrap=True)
    for warning in out.warnings:
        console.print(f"[yellow]![/] {escape(warning)}", soft_wrap=True)
    _show_refused(out, console)
    failed = [item for item in out.files if item.failure is not None]
    for file in failed:
        console.print(f"[red]✗[/] {escape(file.failure or '')}", soft_wrap=True)
    if failed:
        console.print(
            "what a file does not say, such as its units, palpate-import.toml can: --write-settings"
        )
    good = len(out.files) - len(failed)
    refused = sum(len(item.refused) for item in out.files if item.failure is None)
    count = f"{good} of {quantity(len(out.files), 'file', 'files')}"
    count += f", without {quantity(refused, 'refused part', 'refused parts')}" if refused else ""
    if good:
        size = _size(out.bytes)
        console.print(f"{count} in [bold]{escape(out.objects_file)}[/] ({size}), {out.seconds:.1f} s")
        console.print(f"see them: palpate objects show {escape(_quote(out.objects_file))}", soft_wrap=True)
    else:
        kept_words = f"{escape(out.objects_file)} keeps its objects" if out.bytes else "nothing was written"
        console.print(f"{count} could be read; {kept_words}", soft_wrap=True)


def _show_refused(out: ImportOut, console: Console) -> None:
    """Parts that are refused although others of their file are not, as many of each file as can be read."""
    for item in out.files:
        for line in item.refused[:_MAX_REFUSED]:
            console.print(f"[red]✗[/] {escape(f'{item.file}: {line}')}", soft_wrap=True)
        if more := item.refused[_MAX_REFUSED:]:
            names = some_of([line.partition(":")[0] for line in more])
            count = quantity(len(more), "more part is", "more parts are")
            console.print(f"[red]✗[/] {escape(f'{item.file}: {count} refused: {names}')}", soft_wrap=True)


def _objects(objects: Sequence[ImportedObjectOut]) -> Table:
    numbers = "size", "states", "sections", "tolerance"
    rows = table(folding_column("object"), *numbers, numbers=numbers)
    for item in objects:
        rows.add_row(
            escape(item.name) + (", replaced" if item.replaced else ""),
            " × ".join(f"{side:.4g}" for side in item.size),
            str(len(item.states)),
            str(sum(state.sections for state in item.states)),
            f"{item.tolerance:.4f} mm",
        )
    return rows


def _show_object(item: ImportedObjectOut, console: Console) -> None:
    console.print(f"[bold]{escape(item.name)}[/]{', replaced' if item.replaced else ''}: {_body(item)}")
    console.print(_states(item))
    for left in item.left_out:
        count = quantity(left.states, "state", "states")
        console.print(f"left out: {count}, {_percent(left.probability)} together: {escape(left.reason)}")
    for line in (*_known_heights_lines(item), *_tolerance(item)):
        console.print(line)
    console.print()


def _body(item: ImportedObjectOut) -> str:
    size = " × ".join(f"{side:.4g}" for side in item.size)
    if item.volume is None:
        return f"drawing, {size} mm"
    return f"{size} mm, {item.volume / 1000:.4g} cm³, {item.facets} facets, closed"


def _states(item: ImportedObjectOut) -> Table:
    numbers = "prob.", "tips at", "height", "sections", "edges", "off by"
    rows = table(folding_column("state"), *numbers, numbers=numbers)
    for state in item.states:
        tips = state.tipping_angle
        rows.add_row(
            escape(state.name),
            _UNKNOWN if state.probability is None else _percent(state.probability),
            _UNKNOWN if tips is None else f"{math.degrees(tips):.1f}°",
            f"{state.height:.2f} mm",
            str(state.sections),
            _edges(state),
            f"{state.section_tolerance + state.merged_tolerance:.4f} mm",
        )
    return rows


def _edges(state: ImportedStateOut) -> str:
    least, most = state.edges
    return str(least) if least == most else f"{least}–{most}"


def _tolerance(item: ImportedObjectOut) -> list[str]:
    """The tolerance and its parts, those that are none left out."""
    worst = max(item.states, key=lambda state: state.section_tolerance + state.merged_tolerance)
    parts = [
        (item.curve_tolerance, "curves"),
        (worst.section_tolerance, "sections"),
        (worst.merged_tolerance, "merged states"),
        (item.deviation, "deviation of the made part"),
    ]
    some = [f"{value:.4f} {what}" for value, what in parts if value > 0]
    total = f"tolerance {item.tolerance:.4f} mm" if item.tolerance else "tolerance 0: exact"
    return [f"{total} = {' + '.join(some)}" if some else total]


def _known_heights_lines(item: ImportedObjectOut) -> list[str]:
    """Say which states are not known at all heights, a line each as long as these are few."""
    some = [state for state in item.states if state.heights is not None]
    lines = [
        f"{state.name} is known at {heights_in_words(state.heights or ())} only"
        for state in some[:_MAX_STATES]
    ]
    if len(some) > _MAX_STATES:
        lines.append(f"and so are {len(some) - _MAX_STATES} further states")
    return [*lines, "a rig with a finger elsewhere leaves them out"] if some else []


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{max(count / 1e3, 0.1):.1f} kB"


def _quote(path: str) -> str:
    return f'"{path}"' if " " in path else path
