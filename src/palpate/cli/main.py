"""The command line: registration of all commands, and the handling of errors and exit codes.

Errors become one line and an exit code. Results go to stdout (with `--json` one object), progress and
messages for people to stderr. Exit codes: 0 done, 1 not resolved, 2 usage or configuration, 3 device, 4
safety stop, 5 log or disk failed, 129 terminal closed, 130 interrupted, 143 terminated.
"""

import errno
import inspect
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import IntEnum
from io import TextIOWrapper
from types import FrameType
from typing import Annotated

import typer
from typer.exceptions import TyperException

from palpate.base.errors import DeviceError, OutputError, PalpateError, RigWarning, SafetyStop, printable_text
from palpate.cli.calibrate import calibrate, home
from palpate.cli.check import check, doctor
from palpate.cli.identify import identify, plan, recognize, study
from palpate.cli.learn import learn, study_learning
from palpate.cli.objects import (
    check_objects,
    import_objects,
    list_objects,
    merge,
    remove,
    rename,
    show_objects,
)
from palpate.cli.sessions import export, info, list_sessions, prune, replay, report
from palpate.cli.setup import emulate, find_port, init, reboot, scan, schema, setup_motors, stop
from palpate.cli.terminal import print_notices, with_rig_given
from palpate.cli.view import view, watch
from palpate.rig.session.signals import INTERRUPTS, Interrupted

_LIBRARY_WORDS = {
    r"Value error, ": "",
    r"Input should be a valid integer\b.*": "it must be a whole number",
    r"Input should be a valid number\b.*": "it must be a number",
    r"Input should be ": "it must be ",
}
"""Words of typer about an option's value, as patterns, and what stands for it in messages."""

_HELP = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="palpate",
    help="Identifies the known object on a table, its stable state and its exact place, from a few touches.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    context_settings=_HELP,
)
objects = typer.Typer(
    name="objects",
    help="Object models: make them from CAD files, see them, and what a rig can tell apart.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=_HELP,
)
sessions = typer.Typer(
    name="sessions",
    pretty_exceptions_enable=False,
    context_settings=_HELP,
)


class ExitCode(IntEnum):
    """Exit code of a command. A signal's code is 128 + its number, as shells have it."""

    DONE = 0
    NOT_RESOLVED = 1
    INPUT = 2
    DEVICE = 3
    SAFETY = 4
    OUTPUT = 5


_KINDS: dict[type[PalpateError], tuple[str, ExitCode]] = {
    DeviceError: ("device error", ExitCode.DEVICE),
    SafetyStop: ("safety stop", ExitCode.SAFETY),
    OutputError: ("output error", ExitCode.OUTPUT),
    PalpateError: ("error", ExitCode.INPUT),
}


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"palpate {installed('palpate')}")
        raise typer.Exit


def _paragraphs(command: Callable[..., object] | None) -> str:
    """A command's docstring as its help: a line a paragraph, which terminals break where they end."""
    text = inspect.getdoc(command) or ""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


_SETTING_UP = "Setting up a rig"

app.command()(identify)
app.command()(replay)
app.command()(info)
app.command()(view)
app.command()(report)
app.command()(export)
app.command()(recognize)
app.command()(plan)
app.command()(study)
app.command()(emulate)
app.command(rich_help_panel=_SETTING_UP)(init)
app.command(rich_help_panel=_SETTING_UP)(schema)
app.command(rich_help_panel=_SETTING_UP)(find_port)
app.command(rich_help_panel=_SETTING_UP)(scan)
app.command(rich_help_panel=_SETTING_UP)(setup_motors)
app.command(rich_help_panel=_SETTING_UP)(check)
app.command(rich_help_panel=_SETTING_UP)(doctor)
app.command(rich_help_panel=_SETTING_UP)(home)
app.command(rich_help_panel=_SETTING_UP)(calibrate)
app.command(rich_help_panel=_SETTING_UP)(watch)
app.command(rich_help_panel=_SETTING_UP)(reboot)
app.command(rich_help_panel=_SETTING_UP)(stop)
objects.command("import")(import_objects)
objects.command("learn")(learn)
objects.command("study-learning")(study_learning)
objects.command("list")(list_objects)
objects.command("show")(show_objects)
objects.command("check")(check_objects)
objects.command("rename")(rename)
objects.command("remove")(remove)
objects.command("merge")(merge)
app.add_typer(objects)
sessions.callback(invoke_without_command=True)(list_sessions)
sessions.command("prune")(prune)
app.add_typer(sessions)

for _group in (app, objects, sessions):
    for _command in _group.registered_commands:
        _command.help = _paragraphs(_command.callback)


def main() -> None:
    """Run the command line; ends the process with an `ExitCode`."""
    _fill_closed_streams()
    _choose_encodings()
    for number in INTERRUPTS:
        if (
            INTERRUPTS[number] != "hung_up" or signal.getsignal(number) is not signal.SIG_IGN
        ):  # as nohup has it
            signal.signal(number, _interrupt)
    sys.exit(_run())


def _fill_closed_streams() -> None:
    """Open what the caller has closed of the standard streams: no port or log may get their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
    if sys.stdin is None:  # what Python makes of one that was closed
        sys.stdin = os.fdopen(0, closefd=False)


def _choose_encodings() -> None:
    """Let every word be written: files and pipes are UTF-8 on all systems, a terminal shows what it can."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            is_terminal = stream.isatty()
            stream.reconfigure(encoding=None if is_terminal else "utf-8", errors="replace")


def _run() -> int:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", RigWarning)
            warnings.showwarning = _notice
            # In its own "standalone" mode typer would print several lines for an error.
            return _flush(int(app(standalone_mode=False) or 0))
    except typer.Exit as end:
        return _flush(int(end.exit_code))
    except TyperException as error:
        problem = _in_own_words(error.format_message())  # empty where the help has been shown for no command
        return _say(f"error: {problem}", ExitCode.INPUT) if problem else _flush(ExitCode.INPUT)
    except (Interrupted, PalpateError, MemoryError) as error:
        return _report(error)
    except OSError as error:
        return _report_broken_output(error)
    except SystemExit as end:  # typer's, when it finds standard output closed
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return _report_broken_output(end.__context__)


def _in_own_words(problem: str) -> str:
    """A problem with an option, without the words of the library that found it."""
    for pattern, words in _LIBRARY_WORDS.items():
        problem = re.sub(pattern, words, problem)
    return problem


def _notice(message: Warning | str, *_: object, **__: object) -> None:
    """A warning as one line; those of other packages are nothing that an operator can act on."""
    if isinstance(message, RigWarning):
        print_notices([str(message)])


def _report(error: Interrupted | PalpateError | MemoryError) -> int:
    """Say what ended the command."""
    match error:
        case Interrupted():
            return _say("interrupted", 128 + error.signal, _notes(error))
        case MemoryError():
            return _say("error: out of memory", ExitCode.OUTPUT, _notes(error))
    word, code = next(found for kind, found in _KINDS.items() if isinstance(error, kind))
    return _say(f"{word}: {error}", code, _notes(error))


def _flush(code: int) -> int:
    try:
        if sys.stdout is not None:  # it is None if the caller has closed it
            sys.stdout.flush()
    except OSError as error:
        return _report_broken_output(error)
    return code


def _report_broken_output(error: OSError) -> int:
    """Return the exit code of a command whose standard output, or error output, takes nothing more."""
    with suppress(OSError):  # or the interpreter tries once more, and complains
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if error.errno == errno.EPIPE:
        return ExitCode.OUTPUT  # whoever read it has heard enough
    return _say(f"error: the output cannot be written: {error.strerror or error}", ExitCode.OUTPUT)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Unwind once; further signals wait until torque is off."""
    del frame
    for other in INTERRUPTS:
        signal.signal(other, signal.SIG_IGN)
    raise Interrupted(signal.Signals(number))


def _notes(error: BaseException) -> list[str]:
    return getattr(error, "__notes__", [])


def _say(message: str, code: int, notes: Sequence[str] = ()) -> int:
    with suppress(OSError):
        for line in (message, *notes):
            typer.echo(printable_text(with_rig_given(line)), err=True)
    return code
