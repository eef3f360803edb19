"""Do the parts of a rig go together? Checks across keys, each raising at the key to be changed.

Called while a `RigFile` is made, so a rig that exists is one that fits. Frame W, mm, degrees as in the file.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

import shapely

from palpate.config.problems import Place, problem

if TYPE_CHECKING:
    from palpate.config.rig_file import Finger, RigFile

__all__ = ["MOCK", "check_emulation", "check_identities", "check_obstacles", "check_places"]

MOCK = "mock://"
"""Ports of emulated devices begin so."""


def check_identities(rig: RigFile) -> None:
    """Refuse a finger name, a servo id on the bus or a port that is used twice."""
    names: dict[str, int] = {}
    servos: dict[int, str] = {}
    ports: dict[str, str] = {rig.bus.port: "the bus"}
    for index, finger in enumerate(rig.fingers):
        if finger.name in names:
            raise problem(f"fingers[{names[finger.name]}] has this name already", "fingers", index, "name")
        names[finger.name] = index
        for part, dxl_id in (("aim", finger.aim.dxl_id), ("slide", finger.slide.dxl_id)):
            if dxl_id in servos:
                raise problem(
                    f"{dxl_id} is the id of {servos[dxl_id]} already; every servo on the bus needs its own",
                    *("fingers", index, part, "dxl_id"),
                )
            servos[dxl_id] = f'finger "{finger.name}" ({part})'
        port = finger.array.port
        if port in ports:
            raise problem(
                f'"{port}" is the port of {ports[port]} already; every array needs its own',
                *("fingers", index, "array", "port"),
            )
        ports[port] = f'finger "{finger.name}" (array)'


def check_places(rig: RigFile) -> None:
    """Refuse fingers that cannot wait outside the workspace, never reach into it, or start in each other."""
    radius = rig.workspace.radius_mm
    for index, finger in enumerate(rig.fingers):
        waiting = _nearest_to_origin(finger, finger.slide.range_mm[0])
        needed = radius + finger.tip.radius_mm
        if waiting < needed:
            raise problem(
                f"retracted to {finger.slide.range_mm[0]:g} mm the tip's centre comes within {waiting:.4g} "
                f"mm of the origin; it must wait {needed:g} mm away (workspace.radius_mm + tip.radius_mm)",
                *("fingers", index, "slide", "range_mm"),
            )
        reach = _nearest_to_origin(finger, finger.slide.range_mm[1])
        if reach >= needed:
            raise problem(
                f"the tip's centre stays {reach:.4g} mm or more from the origin, never in the workspace; "
                "check base_mm, heading_deg and slide.range_mm",
                *("fingers", index),
            )
    for (_, first), (index, second) in combinations(enumerate(rig.fingers), 2):
        gap = math.dist(_tip(first), _tip(second)) - first.tip.radius_mm - second.tip.radius_mm
        if gap < rig.closing.clearance_mm:
            raise problem(
                f'retracted, its tip is {gap:.4g} mm from that of finger "{first.name}"; '
                f"closing.clearance_mm asks for {rig.closing.clearance_mm:g}",
                *("fingers", index, "base_mm"),
            )


def check_obstacles(rig: RigFile) -> None:
    """Refuse an obstacle's name given twice, and one that a finger touches where it starts."""
    names: dict[str, int] = {}
    for index, obstacle in enumerate(rig.obstacles):
        if obstacle.name in names:
            raise problem(
                f"obstacles[{names[obstacle.name]}] has this name already", "obstacles", index, "name"
            )
        names[obstacle.name] = index
        shape = shapely.Polygon(obstacle.outline_mm)
        for finger in rig.fingers:
            body = shapely.LineString([finger.base_mm, _tip(finger)])
            gap = shapely.distance(shape, body) - finger.tip.radius_mm
            if gap < rig.closing.clearance_mm:
                raise problem(
                    f'is {gap:.4g} mm from finger "{finger.name}", retracted; '
                    f"closing.clearance_mm asks for {rig.closing.clearance_mm:g}",
                    *("obstacles", index, "outline_mm"),
                )


def check_emulation(rig: RigFile) -> None:
    """Refuse mock ports without [emulation], real ports with it, emulated errors beyond declared bounds."""
    ports: list[tuple[str, Place]] = [(rig.bus.port, ("bus", "port"))]
    ports += [
        (finger.array.port, ("fingers", index, "array", "port")) for index, finger in enumerate(rig.fingers)
    ]
    for port, place in ports:
        if port.startswith(MOCK) and rig.emulation is None:
            raise problem(f'"{port}" is an emulated port, but there is no [emulation] table', *place)
        if not port.startswith(MOCK) and rig.emulation is not None:
            raise problem(
                f'"{port}" is not an emulated port (mock://…), but there is an [emulation] table', *place
            )
    if rig.emulation is None:
        return
    if rig.emulation.placement_radius_mm >= rig.workspace.radius_mm:
        raise problem(
            f"is {rig.emulation.placement_radius_mm:g}; it must be below workspace.radius_mm "
            f"({rig.workspace.radius_mm:g})",
            *("emulation", "placement_radius_mm"),
        )
    for index, finger in enumerate(rig.fingers):
        for key, drawn, declared, bound in (
            ("backlash_mm", rig.emulation.backlash_mm, "slide.backlash_mm", finger.slide.backlash_mm),
            ("aim_backlash_deg", rig.emulation.aim_backlash_deg, "aim.backlash_deg", finger.aim.backlash_deg),
            ("gain_spread", rig.emulation.gain_spread, "array.gain_spread", finger.array.gain_spread),
            (
                "stiffness_spread",
                rig.emulation.stiffness_spread,
                "tip.stiffness_spread",
                finger.tip.stiffness_spread,
            ),
            ("base_error_mm", rig.emulation.base_error_mm, "bounds.base_mm", finger.bounds.base_mm),
            (
                "heading_error_deg",
                rig.emulation.heading_error_deg,
                "bounds.heading_deg",
                finger.bounds.heading_deg,
            ),
        ):
            if drawn > bound:
                raise problem(
                    f"is {drawn:g}, beyond the bound fingers[{index}].{declared} = {bound:g}; "
                    "widen the bound or emulate less",
                    *("emulation", key),
                )


def _tip(finger: Finger) -> tuple[float, float]:
    """Tip centre, fully retracted at aim 0."""
    heading = math.radians(finger.heading_deg)
    distance = finger.slide.range_mm[0]
    return (
        finger.base_mm[0] + distance * math.cos(heading),
        finger.base_mm[1] + distance * math.sin(heading),
    )


def _nearest_to_origin(finger: Finger, extent_mm: float) -> float:
    """Least distance of the tip centre from W's origin over the aim range, slid out to `extent_mm`."""
    x, y = finger.base_mm
    to_origin = math.hypot(x, y)
    inward = math.degrees(math.atan2(-y, -x)) - finger.heading_deg
    lo, hi = finger.aim.range_deg
    first = lo + (inward - lo) % 360
    aims = (first,) if first <= hi else (lo, hi)
    distances = []
    for aim in aims:
        angle = math.radians(finger.heading_deg + aim)
        along = -x * math.cos(angle) - y * math.sin(angle)
        slide = min(max(along, finger.slide.range_mm[0]), extent_mm)
        distances.append(math.sqrt(max(to_origin**2 + slide**2 - 2 * slide * along, 0.0)))
    return min(distances)
