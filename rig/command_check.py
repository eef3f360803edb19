"""`palpate check`: is everything there, healthy and set up as the rig file says? Moves nothing."""

from datetime import UTC, datetime
from pathlib import Path

import typer
from rich.console import Console

from palpate.config.results import to_json
from palpate.rig.bus_place import bus_of
from palpate.rig.calibrated_rig import load_calibrated
from palpate.rig.check_calibration import with_calibration
from palpate.rig.check_table import show
from palpate.rig.checking import check_rig
from palpate.rig.terminal import Doing

__all__ = ["run_check"]


def run_check(*, rig: Path | None, json: bool, calibration: bool = True) -> int:
    """Check and show; returns the exit code: 3 if something is wrong, 0 with warnings alone."""
    on_bench = load_calibrated(rig, calibration=calibration)
    err = Console(stderr=True, soft_wrap=True)
    with Doing(err, "checking") as doing:
        out = check_rig(on_bench.rig, bus_of(on_bench.described), doing.now)
    out = with_calibration(out, on_bench, datetime.now(UTC))
    if json:
        typer.echo(to_json(out))
    show(out, err if json else Console(soft_wrap=True))
    return 0 if out.well else 3
