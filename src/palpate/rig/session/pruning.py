"""Pruning: old sessions removed, file by file of those that palpate writes."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from palpate.base.errors import InputError, OutputError
from palpate.config.sessions_result import SessionOut
from palpate.rig.session.log_file import is_written_now, log_path

__all__ = ["Pruned", "discard_session", "recorded_files", "remove_sessions", "to_prune"]

_REPORT = "report.html"

_WRITTEN = frozenset(
    {
        "contacts.json",
        "objects.json",
        "picture.svg",
        _REPORT,
        "result.json",
        "rig.calibration.toml",
        "rig.toml",
        "scene-objects.json",
        "scene.json",
        "session.jsonl",
        "session.jsonl.zst",
    }
)


@dataclass(frozen=True)
class Pruned:
    """What was removed, and folders that stay, as they hold files of others or are being written."""

    sessions: tuple[SessionOut, ...]
    kept_folders: tuple[str, ...]


def to_prune(
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
        old = [item for item in old if (begun := _begun(item)) is not None and now - begun > older_than]
    return tuple(item for item in old if not item.writing)


def remove_sessions(sessions: Sequence[SessionOut]) -> Pruned:
    """Remove what palpate wrote of them, and their folders if nothing else is in there.

    Raises OutputError for what cannot be removed.
    """
    kept = []
    for item in sessions:
        folder = Path(item.path)
        try:
            if is_written_now(log_path(folder)) or not _removed(folder):
                kept.append(item.path)
        except OSError as error:
            raise OutputError(f"session {folder} cannot be removed: {error.strerror}") from error
    return Pruned(tuple(sessions), tuple(kept))


def recorded_files(folder: Path) -> list[Path]:
    """What a run has written into its session's folder: all but a report, which was made of it."""
    return [folder / name for name in sorted(_WRITTEN - {_REPORT}) if (folder / name).is_file()]


def discard_session(folder: Path, *, is_ours: bool) -> None:
    """Leave nothing of a run that did not begin; `is_ours`: its log was not another process's."""
    with suppress(OSError):
        if is_ours:
            _removed(folder)
        else:
            folder.rmdir()


def _removed(folder: Path) -> bool:
    """Remove what palpate wrote, and the folder if it was all."""
    for path in sorted(folder.iterdir()):
        if path.name in _WRITTEN and not path.is_dir():
            path.unlink()
    if any(folder.iterdir()):
        return False
    folder.rmdir()
    return True


def _begun(item: SessionOut) -> datetime | None:
    try:
        begun = datetime.fromisoformat(item.began or "")
    except ValueError:
        return None
    return begun if begun.tzinfo is not None else None
