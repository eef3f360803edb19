"""`palpate sessions` and `palpate info`: recorded sessions listed, described and removed."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.vocabulary import SESSIONS_FOLDER
from palpate.cli.options import JsonOption, SessionArgument

__all__ = ["info", "list_sessions", "prune"]

_FOLDER = Path(SESSIONS_FOLDER)
_WIDE = 1000
FolderOption = Annotated[Path, typer.Option("--sessions", help="Folder with sessions.")]


def list_sessions(context: typer.Context, folder: FolderOption = _FOLDER, json: JsonOption = False) -> int:
    """List recorded sessions, the oldest first: what was found, how they ended, what they take.

    Nothing is removed by itself: `palpate sessions prune` does.
    """
    if context.invoked_subcommand is not None:
        return 0
    from palpate.cli.terminal import Terminal
    from palpate.config.results import to_json
    from palpate.config.sessions_result import SessionsOut
    from palpate.rig.session.summary import find_sessions
    from palpate.views.sessions_text import show_sessions

    found = find_sessions(_existing(folder))
    if json:
        out = SessionsOut(folder=str(folder), sessions=found.sessions, unreadable=found.unreadable)
        typer.echo(to_json(out))
    else:
        terminal = Terminal()
        if not terminal.is_terminal:
            terminal.width = _WIDE  # a line for each session, for what reads it
        show_sessions(found.sessions, found.unreadable, terminal)
    return 0


def info(
    session: SessionArgument,
    json: JsonOption = False,
) -> int:
    """Say what a session is: rig, seed, answer, how it ended, how long it took."""
    from palpate.config.results import to_json
    from palpate.rig.session.log_file import session_of
    from palpate.rig.session.session_info import session_info
    from palpate.views.sessions_text import info_lines

    item = session_info(session_of(session))
    if json:
        typer.echo(to_json(item))
    else:
        typer.echo("\n".join(info_lines(item)))
    return 0


def prune(
    folder: FolderOption = _FOLDER,
    keep: Annotated[int | None, typer.Option("--keep", min=0, help="Keep so many of the newest.")] = None,
    older_than: Annotated[
        float | None, typer.Option("--older-than", min=0, metavar="DAYS", help="Remove only older ones.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be removed.")] = False,
) -> int:
    """Remove old sessions; palpate itself never does. What others put into their folders stays.

    With both options a session goes only if both allow it.
    """
    from datetime import UTC, datetime, timedelta

    from palpate.base.errors import InputError, counted
    from palpate.rig.session.pruning import remove_sessions, to_prune
    from palpate.rig.session.summary import find_sessions
    from palpate.views.sessions_text import size_words

    if keep is None and older_than is None:
        raise InputError("say which sessions may go: --keep N, --older-than DAYS, or both")
    age = None if older_than is None else timedelta(days=older_than)
    old = to_prune(
        find_sessions(_existing(folder)).sessions, keep=keep, older_than=age, now=datetime.now(UTC)
    )
    for item in old:
        typer.echo(f"{'would remove' if dry_run else 'removing'} {item.path}, {size_words(item.bytes)}")
    removed = None if dry_run else remove_sessions(old)
    total = f"{counted(len(old), 'session', 'sessions')}, {size_words(sum(item.bytes for item in old))}"
    typer.echo(f"{'would remove' if dry_run else 'removed'} {total}")
    for name in () if removed is None else removed.kept_folders:
        typer.echo(f"{name} stays: it holds other files, or is being written", err=True)
    return 0


def _existing(folder: Path) -> Path:
    from palpate.base.errors import InputError

    if not folder.is_dir():
        usual = "; runs make it where they are started" if folder == _FOLDER else ""
        raise InputError(f"--sessions {folder}: there is no such folder{usual}")
    return folder
