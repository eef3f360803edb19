"""`palpate replay`: a recorded session run again, without devices, and compared byte by byte."""

import typer

from palpate.cli.options import JsonOption, SessionArgument

__all__ = ["replay"]


def replay(
    session: SessionArgument,
    json: JsonOption = False,
) -> int:
    """Run a recorded session again, against what was recorded; no device is needed, nothing moves.

    Exit code 0: every byte sent and the result are as recorded, 1: something differs, 2: not a whole session.
    """
    from importlib.metadata import version

    from palpate.config.results import to_json
    from palpate.jobs.session import open_session
    from palpate.views.replay_text import replay_lines, replay_out

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
