"""Homing of a rig from Python: every slide that has stops, against its back stop."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from palpate.base.errors import InputError
from palpate.config import SlideFingerConfig
from palpate.rig.bench import connect, set_up
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.motion.homing import Home

__all__ = ["HomedSlide", "check_homable", "home_rig"]


@dataclass(frozen=True)
class HomedSlide:
    """A slide whose turn is known now: servo `dxl_id` counts `turns` ahead of the rig file's angles."""

    finger: str
    dxl_id: int
    turns: int


def check_homable(on_bench: RigOnBench) -> None:
    """Raise InputError for a rig without a slide of which the stops are known."""
    if not _names(on_bench):
        raise InputError(
            f'rig "{on_bench.rig.name}" has no slide with stops_mm: there is nothing to home against; '
            "measure where slides meet their hard stops, and say so in the rig file"
        )


def home_rig(on_bench: RigOnBench, seed: int, notice: Callable[[str], None]) -> list[HomedSlide]:
    """Connect, home, disconnect. Arguments and errors as `Rig.home`."""
    check_homable(on_bench)
    names = _names(on_bench)
    bench = replace(set_up(on_bench.described, None, seed), rig=on_bench.rig)
    with connect(bench, notice=notice) as hand:
        hand.prepare(home=Home.ALL)
        found = [(finger.name, finger.drive.servos[1]) for finger in hand.fingers if finger.name in names]
    return [HomedSlide(name, slide.dxl_id, slide.turns) for name, slide in found]


def _names(on_bench: RigOnBench) -> list[str]:
    """Fingers whose slides can be homed."""
    return [
        spec.name
        for spec in on_bench.rig.fingers
        if isinstance(spec, SlideFingerConfig) and spec.slide.stops_mm is not None
    ]
