"""`palpate home`: drive slides back against their stops, so that the turn in which each stands is known."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption, NoCalibrationOption

__all__ = ["home"]


@if_interrupted("torque is off")
def home(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).", show_default=False)],
    yes: Annotated[bool, typer.Option("--yes", help="Fingers may move: do not ask.")] = False,
    no_calibration: NoCalibrationOption = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices.")] = 0,
    json: JsonOption = False,
) -> int:
    """Find the turn that each slide stands in, after its servo was without power. Fingers move.

    One after the other, slides go back until they meet their back stop (stops_mm in the rig file). Runs
    home slides whose turn is unknown by themselves; this command homes all of them.
    """
    from palpate.cli.commissioning.confirm_motion import ask_to_move
    from palpate.cli.terminal import Terminal
    from palpate.config.home_result import HomedSlideOut, HomeOut
    from palpate.config.results import to_json
    from palpate.jobs.rig import open_rig

    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    opened.check_homable()
    err = Terminal(stderr=True, highlight=False, soft_wrap=True)
    if not yes:
        ask_to_move(err, "Slides go back to their stops, one after the other. Are hands away?")
    found = opened.home(notice=err.print)
    if json:
        slides = tuple(HomedSlideOut(**vars(slide)) for slide in found)
        typer.echo(to_json(HomeOut(slides=slides)))
    out = err if json else Terminal(highlight=False, soft_wrap=True)
    for slide in found:
        out.print(
            f"{slide.finger}: slide (servo {slide.dxl_id}) is homed; its count is {_ahead(slide.turns)}"
        )
    return 0


def _ahead(turns: int) -> str:
    if turns == 0:
        return "that of its first turn"
    plural = "" if abs(turns) == 1 else "s"
    return f"{abs(turns)} turn{plural} {'ahead' if turns > 0 else 'behind'}"
