"""Hierarchy of errors. It is the lowest layer: it imports nothing from palpate, and any module may import it.

Every message says what was wrong, where, and what to do next, in one line, for a person who has not
read the code. The command line turns the branches into exit codes (see `docs/conventions.md`).
"""

import difflib
import re
import shlex
import warnings
from collections.abc import Iterable, Sequence


class PalpateError(Exception):
    """Root of every error that palpate raises on purpose."""


class InputError(PalpateError):
    """A file, option or value from outside is not usable. Exit code 2."""


class MissingPackageError(InputError):
    """A package of an extra is not installed: nothing is said of a file."""


class OutputError(PalpateError):
    """Failure of something beside the devices: a log, a disk, standard output, an observer. Exit code 5."""


class DeviceError(PalpateError):
    """A port or device is missing, silent or reports a fault; the message names it. Exit code 3."""


class SafetyStop(PalpateError):
    """A limit would be or was exceeded and the motion was stopped. Exit code 4."""


class RigWarning(UserWarning):
    """Warning about a run that the operator should know and that does not stop it."""


def warn_operator(text: str) -> None:
    """Warn with `text`."""
    warnings.warn(text, RigWarning, stacklevel=2)


def printable_text(text: str) -> str:
    r"""Text from a device or a file as a terminal may show it: what does not print is escaped, as \x1b is."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


_RIG_COMMAND = re.compile(
    r"(palpate (?:calibrate|check|doctor|home|identify|reboot|setup-motors|stop|watch))\b"
    r"(?!-)(?!(?:(?!palpate)[^;,`:()])* --rig )"
)


def complete_commands(text: str, rig: str) -> str:
    """Text whose commands of palpate for a rig name its rig file, as the user would type them."""
    option = f" --rig {shlex.quote(rig)}"
    text = text.replace(" --rig FILE", option)
    return _RIG_COMMAND.sub(lambda found: found[1] + option, text)


def quantity(count: int, one: str, many: str) -> str:
    """A number with its noun."""
    return f"{count} {one if count == 1 else many}"


def join_words(words: Sequence[str]) -> str:
    """Words as a sentence lists them: "a, b and c"; empty for none."""
    *others, last = words or [""]
    return f"{', '.join(others)} and {last}" if others else last


def nearest(word: str, allowed: Iterable[str]) -> str | None:
    """The word of `allowed` that `word` was probably meant to be, or None."""
    matches = difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.6)
    return matches[0] if matches else None
