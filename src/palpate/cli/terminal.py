"""Common parts of commands: shared options, escaping of text, notices, questions, remaining time.

Every command imports it at start-up, so it depends only on typer, rich, the standard library and palpate's
errors and vocabulary.
"""

import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Self

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.status import Status
from rich.text import Text

from palpate.base.errors import InputError, complete_commands, printable_text
from palpate.base.vocabulary import Strategy

_HANGING = 2  # columns by which a line goes on further to the right

VIEW_PORT = 8765
"""Of the live view, if no other is given."""

RigOption = Annotated[
    Path | None, typer.Option("--rig", help="Rig file (TOML); without it, the shipped emulated rig.")
]
NoCalibrationOption = Annotated[
    bool, typer.Option("--no-calibration", help="Leave out the calibration that lies beside the rig file.")
]
ObjectsOption = Annotated[
    Path | None, typer.Option("--objects", help="Object models (JSON); without it, the six shipped ones.")
]
SceneOption = Annotated[
    Path | None, typer.Option("--scene", help="What lies on the table of an emulated rig (JSON).")
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Draws the scene and the emulated devices' errors.")
]
SessionsOption = Annotated[Path, typer.Option("--sessions", help="Folder for session logs.")]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes at once; as many as there are cores if left out."),
]
ContactsOption = Annotated[Path, typer.Option("--contacts", help="Contacts so far (JSON).")]
StrategyOption = Annotated[
    Strategy,
    typer.Option(
        "--strategy",
        help="How grips are chosen: to distinguish most, at random, or beside the last touches.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
PictureOption = Annotated[Path | None, typer.Option("--picture", help="Also write a picture (SVG) here.")]
PortOption = Annotated[str | None, typer.Option("--port", help="Port of the servos' bus.")]
ObjectsArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="Object models (JSON).", show_default=False)
]
SessionArgument = Annotated[
    Path, typer.Argument(metavar="SESSION", help="A session's folder, or its log.", show_default=False)
]
ViewOption = Annotated[
    bool, typer.Option("--view", help="Show it on a page in the browser; see palpate view.")
]
ViewPortOption = Annotated[
    int, typer.Option("--view-port", min=1, max=65535, help="With --view: its port on this computer.")
]
FOXGLOVE_PORT = 8766
"""Of Foxglove's websocket, if no other is given."""

FoxgloveOption = Annotated[
    bool, typer.Option("--foxglove", help="Serve the run to Foxglove and Lichtblick, over a websocket.")
]
RosOption = Annotated[
    str | None,
    typer.Option("--ros", metavar="HOST:PORT", help="Publish the run to ROS, by the rosbridge there."),
]


def rig_files(rig: Path | None) -> dict[str, Path | None]:
    """The rig file and the calibration beside it, whether it is used or not."""
    from palpate.config import calibration_path

    return {"--rig": rig, "the rig's calibration": None if rig is None else calibration_path(rig)}


def scene_files(scene: Path | None) -> dict[str, Path | None]:
    """The scene and the objects file that it names. Raises InputError for a scene that is wrong."""
    from palpate.config import load_scene

    objects = None if scene is None else load_scene(scene).objects
    return {"--scene": scene, "the scene's objects": None if objects is None else Path(objects)}


def session_files(session: Path | None) -> dict[str, Path | None]:
    """Files that a run recorded in its folder, which its log may name; a report can be written anew."""
    from palpate.rig.session.archive import recorded_files
    from palpate.rig.session.log_file import session_of

    if session is None:
        return {}
    return {f"the session's {file.name}": file for file in recorded_files(session_of(session))}


def several_files(paths: Iterable[Path]) -> dict[str, Path | None]:
    """Files that have no option each."""
    return {str(path): path for path in paths}


_COUNT = re.compile(r"(\d+) of (\d+)")
_MIN_COUNTING_S = 2.0  # of counting, before anything is said of the rest


class TimeLeft:
    """Estimates from the pace so far; a count goes on while its words and its end stay the same."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._count: tuple[str, int] | None = None
        self._begun = 0, 0.0
        self._newest = 0

    def after(self, words: str) -> str:
        """The words, with the time left after the first count in them."""
        found = _COUNT.search(words)
        if found is None:
            return words
        done, total = int(found[1]), int(found[2])
        now, count = self._now_s(), (words[: found.start()], total)
        if count != self._count or done < self._newest:
            self._count, self._begun = count, (done, now)
        self._newest = done
        first, begun_s = self._begun
        if done == first or now - begun_s < _MIN_COUNTING_S:
            return words
        left_s = (now - begun_s) / (done - first) * (total - done)
        return f"{words[: found.end()]} (about {duration_words(left_s)} left){words[found.end() :]}"


def duration_words(seconds: float) -> str:
    """A duration as people say it: 40 s, 3 min, 1 h 20 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


class Terminal(Console):
    """A console on which nothing that comes from devices or files can act on the terminal: it is escaped.

    Into a file or a pipe lines go without the blanks that fill up a table's columns at their end.
    """

    def render_str(self, text: str, **options: Any) -> Text:
        """What rich makes of text, whose commands name the rig file that was given."""
        markup = options.get("markup")
        quote = escape if (self._markup and markup is None) or markup else str
        return super().render_str(with_rig_given(text, quote), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield what rich makes of something, without control characters but its own."""
        rendered = map(_escape_segment, super().render(renderable, options))
        return rendered if self.is_terminal else _strip_line_ends(rendered)


def _escape_segment(segment: Segment) -> Segment:
    if segment.control or segment.text.isprintable():
        return segment
    return segment._replace(text="\n".join(map(printable_text, segment.text.split("\n"))))


def _strip_line_ends(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Segments without blanks before the end of a line; those that no end of a line follows stay."""
    blanks: list[Segment] = []
    for segment in segments:
        for part in segment.text.splitlines(keepends=True):
            line = part.rstrip("\n")
            text = line.rstrip(" ")
            if text:
                yield from blanks
                blanks = []
                yield segment._replace(text=text)
            if line != part:
                blanks = []
                yield Segment.line()
            elif text != line:
                blanks.append(segment._replace(text=line[len(text) :]))
    yield from blanks


def can_ask() -> bool:
    """True if somebody can be asked: standard input is a terminal."""
    return sys.stdin.isatty()


def check_can_ask(why: str, instead: str) -> None:
    """Raise InputError if nobody can be asked: `why` somebody has to be, and what to do `instead`."""
    if not can_ask():
        raise InputError(f"{why}, and there is no terminal to ask on: {instead}")


def with_rig_given(text: str, quote: Callable[[str], str] = str) -> str:
    """Text whose commands name the rig file that --rig gave to this one, so that they can be copied."""
    found = re.findall(r"\0--rig[=\0]([^\0]+)", "\0".join(["", *sys.argv[1:]]))
    return complete_commands(text, quote(found[-1])) if found else text


def fit_to_screen(text: str) -> str:
    """Text whose lines break between words where stdout is a terminal; else as it is."""
    if not sys.stdout.isatty():
        return text
    width = max(shutil.get_terminal_size().columns, 2 * _HANGING)
    lines = []
    for line in text.splitlines():
        indent = " " * (len(line) - len(line.lstrip()) + _HANGING)
        wrapper = textwrap.TextWrapper(
            width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
        lines += wrapper.wrap(line) or [""]
    return "\n".join(lines)


def print_notices(lines: Iterable[str]) -> None:
    """Tell the operator what does not stop the command, a line each."""
    for line in lines:
        typer.echo(f"notice: {printable_text(with_rig_given(line))}", err=True)


class StatusLine:
    """A moving line on a terminal while something is done. Use as a context manager.

    `written_every_s`: into a file or a pipe a line is written so often; never, if it is None.
    """

    def __init__(self, console: Console, what: str, written_every_s: float | None = None) -> None:
        self._left = TimeLeft()
        self.console, self._every_s, self._written_s = console, written_every_s, time.monotonic()
        self._status: Status | None = console.status(escape(what)) if console.is_terminal else None

    def __enter__(self) -> Self:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()

    def now(self, what: str) -> None:
        """Say what is done now; how much time is left stands after a count such as "3 of 40"."""
        words = self._left.after(what)
        if self._status is not None:
            self._status.update(escape(words))
        elif self._every_s is not None and time.monotonic() - self._written_s >= self._every_s:
            self._written_s = time.monotonic()
            self.console.print(escape(words), soft_wrap=True)


@contextmanager
def note_on_interruption(note: str) -> Iterator[None]:
    """Add `note` to an interruption that says nothing yet; errors say themselves what they leave behind."""
    try:
        yield
    except Exception:
        raise
    except BaseException as interruption:
        if not getattr(interruption, "__notes__", ()):
            interruption.add_note(note)
        raise


_CLEAR_QUESTION = "Is the table clear, and are hands away?"


def ask_to_move(console: Console, ready: str = _CLEAR_QUESTION) -> None:
    """Ask whether fingers may move: `ready`, a question. InputError unless the answer is yes."""
    check_can_ask_to_move()
    answer = console.input(f"Fingers are going to move. {ready} \\[y/N] ")
    if answer.strip().lower() not in ("y", "yes"):
        raise InputError("nothing was moved: the question was not answered with yes")


def check_can_ask_to_move() -> None:
    """Raise InputError if there is no terminal to ask on. For commands that do much before they ask."""
    check_can_ask("fingers are going to move", "say --yes if they may")
