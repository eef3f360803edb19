"""Summaries of recorded sessions: what a list of them shows, from first and last lines of each log."""

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError
from palpate.base.vocabulary import Strategy
from palpate.config.replay_result import EndOut
from palpate.config.sessions_result import SessionOut, UnreadableOut
from palpate.rig.session.log_file import is_written_now, log_lines, log_path

__all__ = ["FoundSessions", "find_sessions", "summary_of"]

_LAST_LINES = 4  # truth, result, end, and one more
_TOUCHES, _TOUCHED = b'"event":"touches"', b'"touched":true'


@dataclass(frozen=True)
class FoundSessions:
    """Sessions of a folder, the oldest first, and folders whose logs cannot be read, with the reason."""

    sessions: tuple[SessionOut, ...]
    unreadable: tuple[UnreadableOut, ...]


def find_sessions(root: Path) -> FoundSessions:
    """Summaries of all sessions in a folder; none if there is no such folder."""
    found, unreadable = [], []
    for folder in sorted(root.iterdir()) if root.is_dir() else ():
        if folder.is_symlink() or not log_path(folder).is_file():
            continue
        try:
            found.append(summary_of(folder))
        except InputError as error:
            unreadable.append(UnreadableOut(path=str(folder), why=str(error)))
    found.sort(key=lambda item: (item.began or "", item.path))
    return FoundSessions(tuple(found), tuple(unreadable))


def summary_of(folder: Path) -> SessionOut:
    """Summary of one session; InputError if its log cannot be read."""
    path = log_path(folder)
    lines = log_lines(folder)
    first = next(lines, None)
    if first is None:
        raise InputError(f"{path}: has no whole line")
    header = _event(path, first)
    if header.get("event") != "session":
        raise InputError(f'{path}: line 1: must be the event "session"')
    grips, ending = [], deque([first], _LAST_LINES)
    for line in lines:
        ending.append(line)
        if _TOUCHES in line:
            grips.append(line.count(_TOUCHED))
    last = [_event(path, line) for line in ending]
    end = last[-1] if last[-1].get("event") == "end" else None
    results = (item["result"] for item in last if isinstance(item.get("result"), dict))
    result: Mapping[str, Any] = next(results, {})
    return SessionOut(
        path=str(folder),
        began=_text(header.get("started")),
        command=_text(header.get("command")) or "identify",
        palpate=_text(header.get("palpate")),
        rig=_text(header.get("rig")),
        seed=_seed(header),
        emulated=_emulated(header, result),
        calibration=header.get("calibration") is True,
        writing=end is None and is_written_now(path),
        ended=end and EndOut(how=str(end.get("how")), message=_text(end.get("message"))),
        duration=_number(last[-1].get("t_s")),
        grips=len(grips),
        touches=sum(grips),
        verdict=_text(result.get("verdict")),
        object=_text(result.get("object")),
        state=_text(result.get("state")),
        bytes=sum(item.stat().st_size for item in folder.iterdir() if item.is_file()),
    )


def _seed(header: Mapping[str, Any]) -> int | None:
    """The seed, if anything was drawn from it: emulated devices, or grips at random."""
    drawn = header.get("emulated") is not False or header.get("strategy") == Strategy.RANDOM
    seed = header.get("seed")
    return seed if drawn and isinstance(seed, int) else None


def _emulated(header: Mapping[str, Any], result: Mapping[str, Any]) -> bool | None:
    """Whether devices were emulated: by the rig file, or as they said themselves by the end of the run."""
    said = (item.get("emulated") for item in (result, header))
    return next((item for item in said if isinstance(item, bool)), None)


def _event(path: Path, line: bytes) -> dict[str, Any]:
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds a line that is no JSON object")
    return values


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0
