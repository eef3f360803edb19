"""Archive of sessions in a folder: summaries, information on one session, and removal of old ones.

A summary comes from first and last lines of each log. Sessions are removed file by file of those that
palpate writes.
"""

import json
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError, OutputError
from palpate.base.vocabulary import SessionKind, Strategy
from palpate.config import FingerConfig, RigFile, load_rig
from palpate.config.emulation import MAX_SCENE_PARTS
from palpate.config.session_results import (
    EndOut,
    NamedPartOut,
    PortOfSessionOut,
    SessionInfoOut,
    SessionOut,
    UnreadableOut,
    VersionsOut,
)
from palpate.rig.session.log_file import is_written_now, log_lines, log_path

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
    command = _text(header.get("command")) or SessionKind.IDENTIFY
    if command == SessionKind.LEARN:
        result = _learned(folder / "result.json")
    return SessionOut(
        path=str(folder),
        began=_text(header.get("started")),
        command=command,
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
        parts=tuple(_part(item) for item in result.get("parts") or ()),
    )


def _learned(path: Path) -> Mapping[str, Any]:
    """A result of learning as that of a run: what was learned, or the verdict among known objects."""
    try:
        values = json.loads(path.read_bytes())
    except (OSError, ValueError):  # the run gave none
        return {}
    if not isinstance(values, dict):
        return {}
    if values.get("tolerance") is None:
        return {"verdict": values.get("verdict") or "not learned"}
    return {"verdict": "learned", "object": values.get("name"), "state": values.get("state")}


def _part(values: Mapping[str, Any]) -> NamedPartOut:
    named = {name: _text(values.get(name)) for name in ("object", "state")}
    return NamedPartOut(verdict=_text(values.get("verdict")) or "?", **named)


def _seed(header: Mapping[str, Any]) -> int | None:
    """The seed, if anything was drawn from it: emulated devices, or grips at random."""
    drawn = header.get("emulated") is not False or header.get("strategy") == Strategy.RANDOM
    seed = header.get("seed")
    return seed if drawn and isinstance(seed, int) else None


def _emulated(header: Mapping[str, Any], result: Mapping[str, Any]) -> bool | None:
    """True if devices were emulated: by the rig file, or as they said themselves by the end of the run."""
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


def session_info(folder: Path) -> SessionInfoOut:
    """All that there is to say of a session; InputError if its log cannot be read."""
    summary = summary_of(folder)
    return SessionInfoOut.of(
        summary, devices=_devices(folder / "rig.toml"), versions=VersionsOut(palpate=summary.palpate)
    )


def _devices(path: Path) -> tuple[PortOfSessionOut, ...]:
    try:
        rig = load_rig(path)
    except InputError:  # of an older version, or changed since: the log has the run all the same
        return ()
    bus = PortOfSessionOut(port=rig.bus.port, devices=tuple(_servos(rig)))
    arrays = (item for item in rig.fingers if item.array.has_device)
    return (bus, *(PortOfSessionOut(port=item.array.port, devices=(_array(item),)) for item in arrays))


def _servos(rig: RigFile) -> list[str]:
    stage_last = sorted(rig.servos, key=lambda servo: servo.finger is None)
    return [f"{servo.model}, id {servo.dxl_id}: {servo.owner}" for servo in stage_last]


def _array(finger: FingerConfig) -> str:
    return f"array of {finger.name}, protocol {finger.array.protocol}"


_REPORT = "report.html"

_RECORDED_NAMES = frozenset(
    {
        "contacts.json",
        "objects.json",
        "picture.svg",
        _REPORT,
        "result.json",
        "rig.calibration.toml",
        "rig.confirmed.toml",
        "rig.toml",
        "scene-objects.json",
        *(f"scene-objects-{number}.json" for number in range(1, MAX_SCENE_PARTS + 1)),
        "scene.json",
        "session.jsonl",
        "session.jsonl.zst",
    }
)


@dataclass(frozen=True)
class Pruned:
    """Sessions removed, and folders that stay, as they hold files of others or are being written."""

    sessions: tuple[SessionOut, ...]
    kept_folders: tuple[str, ...]


def select_prunable(
    sessions: Sequence[SessionOut], *, keep: int | None, older_than: timedelta | None, now: datetime
) -> tuple[SessionOut, ...]:
    """Sessions, of those in order of age, that are neither among the newest `keep` nor younger.

    One that is being written stays, and one whose beginning is not known where its age decides. Raises
    InputError if neither is given.
    """
    if keep is None and older_than is None:
        raise InputError("say which sessions may go: how many to keep, or from which age on")
    old = list(sessions if keep is None else sessions[: max(len(sessions) - keep, 0)])
    if older_than is not None:
        old = [item for item in old if (begun := _start_time(item)) is not None and now - begun > older_than]
    return tuple(item for item in old if not item.writing)


def remove_sessions(sessions: Sequence[SessionOut]) -> Pruned:
    """Remove what palpate wrote of them, and their folders if nothing else is in there.

    Raises OutputError for what cannot be removed.
    """
    kept = []
    for item in sessions:
        folder = Path(item.path)
        try:
            if is_written_now(log_path(folder)) or not _remove_recorded(folder):
                kept.append(item.path)
        except OSError as error:
            raise OutputError(f"session {folder} cannot be removed: {error.strerror}") from error
    return Pruned(tuple(sessions), tuple(kept))


def recorded_files(folder: Path) -> list[Path]:
    """Return what a run has written into its session's folder: all but a report, which was made of it."""
    return [folder / name for name in sorted(_RECORDED_NAMES - {_REPORT}) if (folder / name).is_file()]


def discard_session(folder: Path, *, is_ours: bool) -> None:
    """Leave nothing of a run that did not begin; `is_ours`: its log was not another process's."""
    with suppress(OSError):
        if is_ours:
            _remove_recorded(folder)
        else:
            folder.rmdir()


def _remove_recorded(folder: Path) -> bool:
    """Remove what palpate wrote, and the folder if it was all."""
    for path in sorted(folder.iterdir()):
        if path.name in _RECORDED_NAMES and not path.is_dir():
            path.unlink()
    if any(folder.iterdir()):
        return False
    folder.rmdir()
    return True


def _start_time(item: SessionOut) -> datetime | None:
    try:
        begun = datetime.fromisoformat(item.began or "")
    except ValueError:
        return None
    return begun if begun.tzinfo is not None else None
