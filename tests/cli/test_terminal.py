"""What stands on the terminal: streams, text, time left, help."""

import io
import json
import math
import subprocess
from collections.abc import Iterator
from itertools import pairwise, product
from pathlib import Path

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table
from rich.text import Text
from typer.testing import CliRunner

from palpate.base.errors import printable_text
from palpate.cli.main import app
from palpate.cli.run_display import IdentificationProgress
from palpate.cli.terminal import StatusLine, Terminal, TimeLeft, duration_words
from palpate.rig.identification.events import MoveEvent
from palpate.views.tables import show_unplugged
from palpate.views.tables import table as plain_table
from support.benches.rigs import firm_rig, quicken, small, small_parts
from support.campaign.sampling import sample
from support.commands.command import PALPATE, log_events, missing
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Standard output that is full, closed, or read by somebody who has heard enough.

ASKING = ("setup-motors --rig rig.toml", "calibrate --rig rig.toml", "doctor --move", "check --hold")
STDIN = ("<&-", "</dev/null")
QUESTIONS = tuple(product(ASKING, STDIN))


def shell(line: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a line with PALPATE for the command."""
    text = line.replace("PALPATE", str(PALPATE))
    return subprocess.run(["sh", "-c", text], cwd=cwd, capture_output=True, text=True, check=False)


def test_a_full_device_is_one_line(tmp_path: Path) -> None:
    done = shell("PALPATE --version > /dev/full", tmp_path)
    assert done.returncode == 5
    assert missing(done.stderr, "error: ", "output", "No space left on device") == []
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", ">&- 2>&- <&-"])
def test_closed_streams_are_no_error(tmp_path: Path, closed: str) -> None:
    done = shell(f"PALPATE --version {closed}", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("command", "stdin"), sample(QUESTIONS, zip(ASKING[::3], STDIN, strict=True)))
def test_a_question_that_nobody_hears_is_a_line(tmp_path: Path, command: str, stdin: str) -> None:
    """Of commands that somebody has to answer; the rig's devices are not even looked at."""
    (tmp_path / "rig.toml").write_text((EXAMPLES / "fresh-rig.toml").read_text(encoding="utf-8"))
    done = shell(f"PALPATE {command} {stdin}", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "and there is no terminal to ask on" in done.stderr


def test_a_display_that_fails_at_the_end_leaves_the_answer(tmp_path: Path) -> None:
    text = quicken(small(firm_rig())).replace("max_grips = 12", "max_grips = 1")
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    small_parts(tmp_path)
    done = shell("PALPATE identify --rig rig.toml --objects small-parts.json --json 2> /dev/full", tmp_path)
    assert done.returncode == 5
    assert json.loads(done.stdout)["grips"] == 1
    (session,) = (tmp_path / "palpate-sessions").iterdir()
    assert (session / "result.json").exists()
    assert log_events(session / "session.jsonl.zst")[-1]["how"] == "done"


@pytest.mark.parametrize(
    "command", sample(["--help", "schema rig", "check --json"], ["--help", "check --json"])
)
def test_a_reader_that_has_gone_is_exit_code_5_and_no_traceback(tmp_path: Path, command: str) -> None:
    done = shell(f"{{ PALPATE {command}; echo $? > code; }} | true", tmp_path)
    assert ((tmp_path / "code").read_text(), done.stderr) == ("5\n", "")


def test_no_command_shows_the_help_and_no_error(tmp_path: Path) -> None:
    for command in ("PALPATE", "PALPATE objects"):
        done = shell(command, tmp_path)
        assert (done.returncode, done.stderr) == (2, "")
        assert "Usage: palpate" in done.stdout


def test_a_picture_that_finds_no_room_is_one_line(tmp_path: Path) -> None:
    """`ulimit -f` lets no file grow beyond so many blocks, as a full disk: EFBIG in place of ENOSPC."""
    done = shell(
        "trap '' XFSZ; ulimit -f 0; PALPATE plan --contacts CONTACTS --picture p.svg".replace(
            "CONTACTS", str(EXAMPLES / "first-grip.json")
        ),
        tmp_path,
    )
    assert done.returncode == 5
    assert done.stderr.startswith("output error: p.svg cannot be written: File too large")


# ----------------------------------------------------------------------------------------------------
# Text from devices and files cannot act on the terminal that it is shown on.

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


@given(st.integers(1, 70), st.integers(40, 140))
def test_a_narrow_terminal_keeps_marks_and_names(length: int, width: int) -> None:
    columns = ("", "name", "frames a second", "supply", "torque")
    rows = plain_table(*columns, numbers=("supply",))
    rows.add_row("✗", "Ω" * length, "500 of 500", "12.0 V", "off")
    file = io.StringIO()
    Terminal(file=file, width=width).print(rows)
    assert "\n✗" in file.getvalue()
    assert file.getvalue().count("Ω") == length
    assert max(map(len, file.getvalue().splitlines())) <= width


def test_markup_in_names_is_shown_as_it_is() -> None:
    file = io.StringIO()
    with IdentificationProgress(Terminal(file=file, markup=False, highlight=False)) as progress:
        progress.console.print("finger [red]f1[/] waits")
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


# ----------------------------------------------------------------------------------------------------
# Time left of long work, estimated from the counts that it tells.


class Watch:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@given(st.integers(2, 500), st.integers(1, 120))
def test_an_even_pace_is_predicted_exactly(total: int, quarters: int) -> None:
    watch = Watch()
    left, pace_s = TimeLeft(watch), quarters / 4
    for done in range(1, total + 1):
        words = left.after(f"placing, touch {done} of {total} by f1")
        expected = duration_words(pace_s * (total - done))
        if done > 1 and pace_s * (done - 1) >= 2.0 + 1e-6:
            assert words == f"placing, touch {done} of {total} (about {expected} left) by f1"
        elif pace_s * (done - 1) < 2.0 - 1e-6:
            assert words == f"placing, touch {done} of {total} by f1"
        watch.now_s += pace_s


def test_each_count_has_its_own_pace() -> None:
    watch = Watch()
    left = TimeLeft(watch)
    said = []
    for words in (
        "press 1 of 3",
        "press 2 of 3",
        "press 3 of 3",
        "press 1 of 3",
        "touch 2 of 3",
        "touch 3 of 3",
    ):
        said.append(left.after(words))
        watch.now_s += 5.0
    assert said == [
        "press 1 of 3",
        "press 2 of 3 (about 5 s left)",
        "press 3 of 3 (about 0 s left)",
        "press 1 of 3",
        "touch 2 of 3",
        "touch 3 of 3 (about 0 s left)",
    ]
    assert left.after("12 of them, 7 taxels of 8") == "12 of them, 7 taxels of 8"


def test_durations_are_said_as_people_do() -> None:
    assert [duration_words(value) for value in (0.4, 89.4, 90, 5399, 5400)] == [
        "0 s",
        "89 s",
        "2 min",
        "1 h 30 min",
        "1 h 30 min",
    ]


# ----------------------------------------------------------------------------------------------------
# `--help`: sentences are broken by the terminal, where its lines end, and not by the source's.


def commands() -> Iterator[tuple[str, ...]]:
    root = typer.main.get_command(app)
    assert isinstance(root, typer.core.TyperGroup)
    for name, command in root.commands.items():
        yield from [(name, inner) for inner in getattr(command, "commands", ())] or [(name,)]


@pytest.mark.parametrize("words", list(commands()))
def test_a_paragraph_is_broken_only_where_a_line_is_full(words: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80", "TERM": "dumb"}).stdout
    text = shown.split("╭")[0].splitlines()[3:]
    assert any(line.strip() for line in text)
    for line, following in pairwise(text):
        first = following.split()[:1]
        if line.strip() and first:
            assert len(line.rstrip()) + 1 + len(first[0]) > 78, f"{line!r} has room for {first[0]!r}"
