"""`palpate identify`: the main job, from a rig file to a verdict, a session log and a picture."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.errors import PalpateError
from palpate.base.vocabulary import SESSIONS_FOLDER, IdentificationVerdict, Strategy
from palpate.cli.options import (
    VIEW_PORT,
    JsonOption,
    NoCalibrationOption,
    ObjectsOption,
    PictureOption,
    RigOption,
    SceneOption,
    SeedOption,
    StrategyOption,
    ViewOption,
    ViewPortOption,
)

__all__ = ["identify"]

_SESSIONS = Path(SESSIONS_FOLDER)


def identify(
    rig: RigOption = None,
    objects: ObjectsOption = None,
    scene: SceneOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
    picture: PictureOption = None,
    strategy: StrategyOption = Strategy.PLANNED,
    sessions: Annotated[Path, typer.Option("--sessions", help="Folder for session logs.")] = _SESSIONS,
    no_calibration: NoCalibrationOption = False,
    view: ViewOption = False,
    view_port: ViewPortOption = VIEW_PORT,
) -> int:
    """Touch what lies on the table until it is known which object it is and where."""
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.identification_progress import Progress, answer_lines
    from palpate.cli.output_places import rig_files, scene_files
    from palpate.cli.terminal import Terminal, print_notices
    from palpate.cli.view_process import view_starter
    from palpate.jobs.rig import open_rig

    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    read = {**rig_files(rig), "--objects": objects, **scene_files(scene)}
    check_places({"--picture": picture}, read)
    terminal = Terminal(stderr=True, highlight=False, markup=False)
    with Progress(terminal) as progress:
        answer = opened.identify(
            objects,
            scene=scene,
            strategy=strategy.value,
            sessions=sessions,
            on_event=progress,
            on_session=view_starter(view_port) if view else lambda _: None,
            notice=progress.notice,
            warn=lambda line: print_notices([line]),
            progress=progress.doing,
        )
    failure = answer.failure
    try:
        if picture is not None:
            write_text(picture, answer.picture())
    except PalpateError as error:  # an answer that could not be written down is still an answer
        failure = failure or error
    place = picture or Path(answer.session or "", "picture.svg")
    typer.echo(answer.to_json() if json else "\n".join(answer_lines(answer, place)))
    if failure is not None:
        raise failure
    answered = (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)
    return 0 if answer.verdict in answered else 1
