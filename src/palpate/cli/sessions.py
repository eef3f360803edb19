"""Commands on recorded sessions: `sessions` and its `prune`, `info`, `replay`, `report` and `export`."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.vocabulary import SESSIONS_FOLDER
from palpate.cli.terminal import JsonOption, SessionArgument

_FOLDER = Path(SESSIONS_FOLDER)
_PIPED_COLUMNS = 1000
FolderOption = Annotated[Path, typer.Option("--sessions", help="Folder with sessions.")]


def list_sessions(context: typer.Context, folder: FolderOption = _FOLDER, json: JsonOption = False) -> int:
    """List recorded sessions, the oldest first: what was found, how they ended, what they take.

    Nothing is removed by itself: `palpate sessions prune` does.
    """
    if context.invoked_subcommand is not None:
        return 0
    from palpate.cli.terminal import Terminal
    from palpate.config.fields import to_json
    from palpate.config.session_results import SessionsOut
    from palpate.rig.session.archive import find_sessions
    from palpate.views.sessions_text import show_sessions

    found = find_sessions(_check_folder(folder))
    if json:
        out = SessionsOut(folder=str(folder), sessions=found.sessions, unreadable=found.unreadable)
        typer.echo(to_json(out))
    else:
        terminal = Terminal()
        if not terminal.is_terminal:
            terminal.width = _PIPED_COLUMNS  # a line for each session, for what reads it
        show_sessions(found.sessions, found.unreadable, terminal)
    return 0


def info(
    session: SessionArgument,
    json: JsonOption = False,
) -> int:
    """Say what a session is: rig, seed, answer, how it ended, how long it took."""
    from palpate.config.fields import to_json
    from palpate.rig.session.archive import session_info
    from palpate.rig.session.log_file import session_of
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

    from palpate.base.errors import InputError, quantity
    from palpate.rig.session.archive import find_sessions, remove_sessions, select_prunable
    from palpate.views.sessions_text import size_words

    if keep is None and older_than is None:
        raise InputError("say which sessions may go: --keep N, --older-than DAYS, or both")
    age = None if older_than is None else timedelta(days=older_than)
    old = select_prunable(
        find_sessions(_check_folder(folder)).sessions, keep=keep, older_than=age, now=datetime.now(UTC)
    )
    for item in old:
        typer.echo(f"{'would remove' if dry_run else 'removing'} {item.path}, {size_words(item.bytes)}")
    removed = None if dry_run else remove_sessions(old)
    total = f"{quantity(len(old), 'session', 'sessions')}, {size_words(sum(item.bytes for item in old))}"
    typer.echo(f"{'would remove' if dry_run else 'removed'} {total}")
    for name in () if removed is None else removed.kept_folders:
        typer.echo(f"{name} stays: it holds other files, or is being written", err=True)
    return 0


def _check_folder(folder: Path) -> Path:
    from palpate.base.errors import InputError

    if not folder.is_dir():
        usual = "; runs make it where they are started" if folder == _FOLDER else ""
        raise InputError(f"--sessions {folder}: there is no such folder{usual}")
    return folder


def replay(
    session: SessionArgument,
    json: JsonOption = False,
) -> int:
    """Run a recorded session again, against what was recorded; no device is needed, nothing moves.

    Exit code 0: every byte sent and the result are as recorded, 1: something differs, 2: not a whole session.
    """
    from importlib.metadata import version

    from palpate.config.fields import to_json
    from palpate.jobs.session import open_session
    from palpate.views.sessions_text import replay_lines, replay_out

    recorded = open_session(session)
    replayed = recorded.replay()
    if recorded.changed is not None:
        typer.echo(recorded.changed, err=True)
    by, now = recorded.recorded_by, version("palpate")
    if by != now:
        typer.echo(f"recorded by palpate {by}, replayed by {now}", err=True)
    out = replay_out(recorded.log, replayed, by, str(recorded.folder))
    typer.echo(to_json(out) if json else "\n".join(replay_lines(recorded.log, out)))
    return 0 if out.same else 1


def report(
    session: SessionArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Default: report.html in the session's folder."),
    ] = None,
) -> int:
    """Write a recorded run as one HTML page, to be read, sent and printed; it needs nothing else.

    Verdict and bounds, each grip's picture, why each rival fell, timing, devices, calibration, settings.
    """
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.terminal import session_files
    from palpate.rig.session.archive import summary_of
    from palpate.rig.session.log_file import session_of
    from palpate.rig.session.log_reader import read_session
    from palpate.rig.session.recorded_session import open_samples
    from palpate.views.report.run import run_report

    folder = session_of(session)
    place = out or folder / "report.html"
    check_places({"--out": place}, session_files(folder))
    recorded = read_session(folder)
    samples = open_samples(recorded, folder)
    write_text(place, run_report(samples, summary_of(folder), folder))
    typer.echo(str(place))
    return 0


def export(
    session: SessionArgument,
    mcap: Annotated[
        Path | None, typer.Option("--mcap", metavar="FILE", help="An MCAP file, for Foxglove and others.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FOLDER", help="A CSV file for each topic.")
    ] = None,
    rosbag: Annotated[
        Path | None, typer.Option("--rosbag", metavar="FOLDER", help="A ROS 2 bag of standard messages.")
    ] = None,
    animation: Annotated[
        Path | None, typer.Option("--animation", metavar="FILE", help="A moving picture (SVG) of the run.")
    ] = None,
    urdf: Annotated[
        Path | None,
        typer.Option("--urdf", metavar="FILE", help="The rig's joints and tips as URDF; a rig file will do."),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Write a recorded session as MCAP, CSV or a ROS 2 bag: servos, tips, taxels, contacts, hypotheses.

    Or as a moving picture for a page. MCAP and bags need the extra `export`. With --urdf alone SESSION may be
    a rig file.
    """
    from palpate.base.errors import InputError, quantity
    from palpate.base.file_io import check_different, check_places, write_text
    from palpate.cli.terminal import Terminal, rig_files, session_files
    from palpate.config import load_calibrated
    from palpate.config.fields import to_json
    from palpate.config.session_results import ExportedOut, ExportOut
    from palpate.rig.session.log_file import session_of
    from palpate.rig.session.log_reader import read_session
    from palpate.rig.session.recorded_session import open_samples
    from palpate.views.exports.csv_files import write_csv
    from palpate.views.exports.foxglove import write_mcap
    from palpate.views.exports.rosbag import write_rosbag
    from palpate.views.exports.urdf import rig_urdf
    from palpate.views.table_picture.animation import draw_animation

    folders = {"--csv": csv, "--mcap": mcap, "--rosbag": rosbag}
    files = {"--animation": animation, "--urdf": urdf}
    if not any([*folders.values(), *files.values()]):
        raise InputError("say what to write: --mcap, --csv, --rosbag, --animation or --urdf, or several")
    of_run = animation is not None or any(folders.values())
    folder = session_of(session) if of_run or session.suffix != ".toml" else None
    rig = session if folder is None else folder / "rig.toml"
    check_different({**folders, **files}, rig_files(rig) if folder is None else session_files(folder))
    check_places(files, {})
    if urdf is not None:
        write_text(urdf, rig_urdf(load_calibrated(rig).rig))
    if folder is None or not of_run:
        return 0
    samples = open_samples(read_session(folder), folder)
    terminal, written = Terminal(stderr=True, highlight=False, markup=False), []
    for target, write in ((csv, write_csv), (mcap, write_mcap), (rosbag, write_rosbag)):
        if target is None:
            continue
        with terminal.status(f"writing {target}"):
            counts = write(samples, target)
        written.append(ExportedOut(path=str(target), messages=dict(sorted(counts.items()))))
    if animation is not None:
        write_text(animation, draw_animation(samples))
        written.append(ExportedOut(path=str(animation), messages={}))
    if json:
        typer.echo(to_json(ExportOut(session=str(folder), written=tuple(written))))
        return 0
    for item in written:
        total = quantity(sum(item.messages.values()), "message", "messages")
        topics = f": {total} on {quantity(len(item.messages), 'topic', 'topics')}" if item.messages else ""
        typer.echo(f"{item.path}{topics}")
    return 0
