"""`palpate export`: a recorded session for viewers and programs of others."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.options import JsonOption, SessionArgument

__all__ = ["export"]


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
    json: JsonOption = False,
) -> int:
    """Write a recorded session as MCAP, CSV or a ROS 2 bag: servos, tips, taxels, contacts, hypotheses.

    MCAP and bags need the extra `export`.
    """
    from palpate.base.errors import InputError, counted
    from palpate.base.files.writing import check_different
    from palpate.cli.output_places import session_files
    from palpate.cli.terminal import Terminal
    from palpate.config.export_result import ExportedOut, ExportOut
    from palpate.config.results import to_json
    from palpate.rig.session.log_file import session_of
    from palpate.rig.session.log_reader import read_session
    from palpate.rig.session.samples import open_samples
    from palpate.views.exports.csv_files import write_csv
    from palpate.views.exports.mcap import write_mcap
    from palpate.views.exports.rosbag import write_rosbag

    if mcap is None and csv is None and rosbag is None:
        raise InputError("say what to write: --mcap FILE, --csv FOLDER or --rosbag FOLDER, or several")
    folder = session_of(session)
    check_different({"--csv": csv, "--mcap": mcap, "--rosbag": rosbag}, session_files(folder))
    samples = open_samples(read_session(folder), folder)
    terminal, written = Terminal(stderr=True, highlight=False, markup=False), []
    for target, write in ((csv, write_csv), (mcap, write_mcap), (rosbag, write_rosbag)):
        if target is None:
            continue
        with terminal.status(f"writing {target}"):
            counts = write(samples, target)
        written.append(ExportedOut(path=str(target), messages=dict(sorted(counts.items()))))
    if json:
        typer.echo(to_json(ExportOut(session=str(folder), written=tuple(written))))
        return 0
    for item in written:
        total = counted(sum(item.messages.values()), "message", "messages")
        typer.echo(f"{item.path}: {total} on {counted(len(item.messages), 'topic', 'topics')}")
    return 0
