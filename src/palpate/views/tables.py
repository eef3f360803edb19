"""Tables on the terminal: one look for all of them, without frames, so that piped output is plain columns."""

from collections.abc import Collection

from rich.table import Column, Table


def table(*columns: str | Column, numbers: Collection[str] = ()) -> Table:
    """A table without rows. Columns given by name stay on one line, those in `numbers` aligned right."""
    made = [_single_line(item, numbers) if isinstance(item, str) else item for item in columns]
    return Table(*made, box=None, pad_edge=False, header_style="bold")


def folding_column(name: str, width: int | None = None) -> Column:
    """A column of text that may be long: it is broken into lines, and never cut."""
    return Column(name, overflow="fold", width=width)


def _single_line(name: str, numbers: Collection[str]) -> Column:
    return Column(name, justify="right" if name in numbers else "left", no_wrap=True)
