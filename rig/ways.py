"""Straight ways that a finger's mechanics allow, and what it sweeps on each. Between rig file and reach."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.config import Finger, RigFile
from palpate.drivers.finger import Line
from palpate.recognizer.arrays import Floats
from palpate.rig.convert import kinematics_of
from palpate.rig.drives import AIM_SPEED_RAD_S
from palpate.rig.room import Pieces, Swept
from palpate.rig.waiting import body_of, wait_distance_mm

__all__ = ["Way", "joined", "ways_of"]

_MARGIN_MM = 1.0


@dataclass(frozen=True, eq=False)
class Way:
    """A finger's way along `line`, at most `travel_mm`; `aiming_s` is roughly how long it takes to get there.

    `pieces` are what it sweeps, counted from travels `since` (s,) on; those that `grow` (s,) have ends that
    move along the line.
    """

    finger_index: int
    line: Line
    travel_mm: float
    aiming_s: float
    pieces: Pieces
    since: Floats
    grows: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    def up_to(self, travel_mm: float) -> "Way":
        """The same way, not as far."""
        return replace(self, travel_mm=travel_mm)


def joined(ways: Sequence[Way]) -> Swept:
    """What several ways sweep, numbered in their order."""
    count = [len(way.since) for way in ways]
    empty = np.empty((0, 2))
    return Swept(
        Pieces(
            np.concatenate([empty, *(way.pieces.start for way in ways)]),
            np.concatenate([empty, *(way.pieces.end for way in ways)]),
            np.concatenate([empty[:, 0], *(way.pieces.half_width for way in ways)]),
            np.repeat(np.arange(len(ways)), count),
        ),
        np.concatenate([empty[:, 0], *(way.since for way in ways)]),
        np.concatenate([np.empty(0, bool), *(way.grows for way in ways)]),
        np.array([_heading(way.line) for way in ways]).reshape(-1, 2),
    )


def ways_of(rig: RigFile, finger_index: int, aims_rad: Floats) -> list[Way]:
    """Ways of a finger from some of its aims."""
    spec = rig.fingers[finger_index]
    radius = rig.workspace.radius_mm
    ways = (_slide_way(spec, finger_index, float(aim), radius) for aim in aims_rad)
    return [way for way in ways if way.travel_mm > _MARGIN_MM]


def crossing_mm(line: Line, radius_mm: float) -> float:
    """Travel at which a line leaves the circle round the origin; 0 if it misses it."""
    middle = line.travel_mm((0.0, 0.0))
    miss = math.hypot(*line.point_mm(middle))
    return 0.0 if miss >= radius_mm else middle + math.sqrt(radius_mm**2 - miss**2)


def _slide_way(spec: Finger, finger_index: int, aim_rad: float, workspace_radius_mm: float) -> Way:
    """Until the tip has left the workspace on the far side, or the slide ends."""
    kinematics = kinematics_of(spec)
    wait = wait_distance_mm(spec, workspace_radius_mm)
    line = kinematics.line(aim_rad, wait)
    room = spec.slide.range_mm[1] - _MARGIN_MM - wait
    travel = min(crossing_mm(line, workspace_radius_mm), room)
    # The bounds are largest at the far end; there they hold for all of the way.
    far = body_of(kinematics, kinematics.servos_rad(line, max(travel, 0.0)), spec.tip.radius_mm)
    here = kinematics.body(kinematics.servos_rad(line, 0.0), spec.tip.radius_mm)
    one = np.zeros(1)
    return Way(
        finger_index,
        line,
        travel,
        abs(kinematics.gear_ratio * aim_rad) / AIM_SPEED_RAD_S,
        Pieces(here.start, here.end, far.half_width, np.zeros(1, np.int64)),
        one - 1.0,
        np.ones(1, bool),
    )


def _heading(line: Line) -> tuple[float, float]:
    return math.cos(line.direction_rad), math.sin(line.direction_rad)
