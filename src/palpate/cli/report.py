"""`palpate report`: a recorded run as one HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.options import SessionArgument

__all__ = ["report"]


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
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.output_places import session_files
    from palpate.rig.session.log_file import session_of
    from palpate.rig.session.log_reader import read_session
    from palpate.rig.session.samples import open_samples
    from palpate.rig.session.summary import summary_of
    from palpate.views.report.run import run_report

    folder = session_of(session)
    place = out or folder / "report.html"
    check_places({"--out": place}, session_files(folder))
    recorded = read_session(folder)
    samples = open_samples(recorded, folder)
    write_text(place, run_report(samples, summary_of(folder), folder))
    typer.echo(str(place))
    return 0
