"""Text from devices and files cannot act on the terminal that it is shown on."""

import io
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table
from rich.text import Text

from palpate.base.errors import printable_text
from palpate.cli.run_display import IdentificationProgress
from palpate.cli.terminal import StatusLine, Terminal
from palpate.rig.identification.observers import MoveEvent
from palpate.views.ports_table import show_unplugged
from palpate.views.tables import table as plain_table

EVIL = "v1\x1b[2J\x1b]0;title\x07\u202e\x9b31m\r"


def shown(what: object, *, terminal: bool = False) -> str:
    """What reaches the terminal."""
    file = io.StringIO()
    Terminal(file=file, force_terminal=terminal, width=80).print(what)
    return file.getvalue()


def table() -> Table:
    out = Table()
    out.add_column(EVIL)
    out.add_row(EVIL)
    return out


@pytest.mark.parametrize("what", [EVIL, Text(EVIL), Text.assemble((EVIL, "bold")), table()])
def test_a_terminal_shows_what_does_not_print_escaped(what: object) -> None:
    out = shown(what)
    assert r"v1\x1b[2J\x1b]0;" in out
    assert not set("\x1b\x07\u202e\x9b") & set(out)


def test_its_own_colours_and_lines_stay() -> None:
    assert shown("[red]wrong[/]\n\nnext", terminal=True) == "\x1b[31mwrong\x1b[0m\n\nnext\n"


@given(st.text())
def test_printable_text_prints_and_says_the_same(text: str) -> None:
    safe = printable_text(text)
    assert safe.isprintable()
    assert printable_text(safe) == safe
    assert safe == text or not text.isprintable()


@given(st.lists(st.sampled_from(["", " ", "a", " b  ", "c\n", "  \n", " d \n  e "]), max_size=12))
def test_into_a_file_no_line_ends_with_blanks(parts: list[str]) -> None:
    """The last line's stay where no end of a line follows: something may be written behind them."""
    file = io.StringIO()
    Terminal(file=file, width=80, soft_wrap=True).print(Text("").join(map(Text, parts)), end="")
    *lines, last = "".join(parts).split("\n")
    assert file.getvalue() == "".join(f"{line.rstrip()}\n" for line in lines) + last


def test_tables_are_filled_up_on_a_terminal_only() -> None:
    rows = plain_table("what", "is")
    rows.add_row("a", "[red]b[/] ")
    assert shown(rows) == "what  is\na     b\n"
    assert shown(rows, terminal=True).splitlines()[0].endswith("is\x1b[0m")


def test_markup_in_names_is_shown_as_it_is() -> None:
    file = io.StringIO()
    with IdentificationProgress(Terminal(file=file, markup=False, highlight=False)) as progress:
        progress.notice("finger [red]f1[/] waits")
    with StatusLine(Terminal(file=file), "reading [bold]plate[/bold].stl") as doing:
        doing.now("[/]")
    assert "finger [red]f1[/] waits" in file.getvalue()
    show_unplugged([], Terminal(file=file))


def test_why_earlier_grips_are_dropped() -> None:
    console = Terminal(file=io.StringIO(), width=100)
    with IdentificationProgress(console) as progress:
        progress(MoveEvent(2))
        progress(MoveEvent(3, 3.84))
        progress(MoveEvent(4, math.inf))
    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue().splitlines() == [
        "        contradicts earlier grips: the part may have moved, they are dropped",
        "        fingers may have moved the part by 3.8 mm: earlier grips are dropped",
        "        fingers may have moved the part without a bound: earlier grips are dropped",
    ]


@pytest.mark.parametrize(("every_s", "lines"), [(None, 0), (0.0, 3), (1e9, 0)])
def test_how_far_long_work_is_goes_into_a_file_as_plain_lines_now_and_then(
    every_s: float | None, lines: int
) -> None:
    file = io.StringIO()
    with StatusLine(Terminal(file=file, width=40), "preparing", written_every_s=every_s) as doing:
        for number in range(3):
            doing.now(f"runs: {number} of 3 {EVIL} {'long ' * 20}")
    assert file.getvalue().count("\n") == lines
    assert not set("\x1b\x07\u202e\x9b") & set(file.getvalue())
