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
    from palpate.config.rig_file import EmulationConfig, RigFile, StageConfig
    from palpate.config.rig_fingers import ArmFingerConfig, FingerConfig, SlideFingerConfig

__all__ = ["ARM_MARGIN_MM", "MOCK", "check_emulation", "check_identities", "check_obstacles", "check_places"]

ARM_MARGIN_MM = 2.0
"""The tip of an arm waits this far outside of the workspace."""

MOCK = "mock://"
"""Ports of emulated devices begin so."""


def check_identities(rig: RigFile) -> None:
    """Refuse a finger name, a servo id on the bus or a port that is used twice."""
    names: dict[str, int] = {}
    servos: dict[int, str] = {}
    ports: dict[str, str] = {rig.bus.port: "the bus"}
    if rig.stage is not None:
        servos[rig.stage.dxl_id] = "the stage"
    for index, finger in enumerate(rig.fingers):
        if finger.name in names:
            raise problem(f"fingers[{names[finger.name]}] has this name already", "fingers", index, "name")
        names[finger.name] = index
        for part, dxl_id in ((part, servo.dxl_id) for part, servo in finger.servos.items()):
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
    radius = rig.clear_radius_mm
    for index, finger in enumerate(rig.fingers):
        if finger.type == "two-link":
            _check_arm(finger, radius, index)
            continue
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
        gap = (
            math.dist(_tip(first, radius), _tip(second, radius)) - first.tip.radius_mm - second.tip.radius_mm
        )
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
            body = shapely.LineString([finger.base_mm, _tip(finger, rig.clear_radius_mm)])
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
    _check_stage(rig.stage, rig.emulation)
    for index, finger in enumerate(rig.fingers):
        for key, drawn, declared, bound in (
            *_mechanical(finger, rig.emulation),
            *_any(finger, rig.emulation),
        ):
            if drawn > bound:
                raise problem(
                    f"is {drawn:g}, beyond the bound fingers[{index}].{declared} = {bound:g}; "
                    "widen the bound or emulate less",
                    *("emulation", key),
                )


def _check_stage(stage: StageConfig | None, drawn: EmulationConfig) -> None:
    """Refuse emulated errors of the stage beyond its bounds."""
    if stage is None:
        return
    for key, amount, declared, bound in (
        ("stage_backlash_deg", drawn.stage_backlash_deg, "stage.backlash_deg", stage.backlash_deg),
        ("stage_error_deg", drawn.stage_error_deg, "stage.bound_deg", stage.bound_deg),
    ):
        if amount > bound:
            raise problem(
                f"is {amount:g}, beyond the bound {declared} = {bound:g}; widen the bound or emulate less",
                *("emulation", key),
            )


def _any(finger: FingerConfig, drawn: EmulationConfig) -> list[tuple[str, float, str, float]]:
    """What the emulation draws of fingers of any type: its key, how much, and the declared bound's key."""
    tip, array, bounds = finger.tip, finger.array, finger.bounds
    turned, drift = drawn.array_heading_error_deg, drawn.drift_counts_per_s
    return [
        ("gain_spread", drawn.gain_spread, "array.gain_spread", array.gain_spread),
        ("drift_counts_per_s", drift, "array.drift_counts_per_s", array.drift_counts_per_s),
        ("array_heading_error_deg", turned, "array.heading_bound_deg", array.heading_bound_deg),
        ("stiffness_spread", drawn.stiffness_spread, "tip.stiffness_spread", tip.stiffness_spread),
        ("tip_radius_error_mm", drawn.tip_radius_error_mm, "tip.radius_bound_mm", tip.radius_bound_mm),
        ("base_error_mm", drawn.base_error_mm, "bounds.base_mm", bounds.base_mm),
        ("heading_error_deg", drawn.heading_error_deg, "bounds.heading_deg", bounds.heading_deg),
    ]


def _mechanical(finger: FingerConfig, drawn: EmulationConfig) -> list[tuple[str, float, str, float]]:
    """What the emulation draws of a finger's mechanics; likewise."""
    if finger.type == "two-link":
        play, length = drawn.joint_backlash_deg, drawn.link_error_mm
        return [
            ("joint_backlash_deg", play, "shoulder.backlash_deg", finger.shoulder.backlash_deg),
            ("joint_backlash_deg", play, "elbow.backlash_deg", finger.elbow.backlash_deg),
            ("link_error_mm", length, "links.bound_mm", finger.links.bound_mm),
        ]
    slide, travel = finger.slide, drawn.mm_per_turn_error
    return [
        ("backlash_mm", drawn.backlash_mm, "slide.backlash_mm", slide.backlash_mm),
        ("aim_backlash_deg", drawn.aim_backlash_deg, "aim.backlash_deg", finger.aim.backlash_deg),
        ("zero_error_mm", drawn.zero_error_mm, "slide.zero_bound_mm", slide.zero_bound_mm),
        ("mm_per_turn_error", travel, "slide.mm_per_turn_spread", slide.mm_per_turn_spread),
    ]


def _check_arm(finger: ArmFingerConfig, radius_mm: float, index: int) -> None:
    """Refuse an arm with its base in the workspace, or that cannot wait between its base and that."""
    away = math.hypot(*finger.base_mm)
    if away <= radius_mm + finger.tip.radius_mm:
        raise problem(
            f"is {away:.4g} mm from the origin; the base must stand outside of the workspace, beyond "
            f"{radius_mm + finger.tip.radius_mm:g} mm (workspace.radius_mm + tip.radius_mm)",
            *("fingers", index, "base_mm"),
        )
    tip = _tip(finger, radius_mm)
    x, y = tip[0] - finger.base_mm[0], tip[1] - finger.base_mm[1]
    upper, fore = finger.links.upper_mm, finger.links.fore_mm
    bend = (x * x + y * y - upper**2 - fore**2) / (2 * upper * fore)
    if abs(bend) > 1:
        raise problem(
            f"cannot put the tip where it waits, at ({tip[0]:.4g}, {tip[1]:.4g}), {math.hypot(x, y):.4g} mm "
            "from the base",
            *("fingers", index, "links"),
        )
    elbow = math.copysign(math.acos(bend), finger.elbow.range_deg[0])
    across = math.atan2(fore * math.sin(elbow), upper + fore * math.cos(elbow))
    shoulder = math.degrees(math.atan2(y, x) - across) - finger.heading_deg
    for key, angle, (lo, hi) in (
        ("shoulder", math.remainder(shoulder, 360.0), finger.shoulder.range_deg),
        ("elbow", math.degrees(elbow), finger.elbow.range_deg),
    ):
        if not lo < angle < hi:
            raise problem(
                f"is [{lo:g}, {hi:g}]; with the tip where it waits, at ({tip[0]:.4g}, {tip[1]:.4g}), the "
                f"{key} stands at {angle:.4g}",
                *("fingers", index, key, "range_deg"),
            )


def _tip(finger: FingerConfig, radius_mm: float) -> tuple[float, float]:
    """Tip centre where a finger must start: a slide retracted at aim 0, an arm beside the workspace."""
    if finger.type == "two-link":
        x, y = finger.base_mm
        share = (radius_mm + finger.tip.radius_mm + ARM_MARGIN_MM) / math.hypot(x, y)
        return share * x, share * y
    heading = math.radians(finger.heading_deg)
    distance = finger.slide.range_mm[0]
    return (
        finger.base_mm[0] + distance * math.cos(heading),
        finger.base_mm[1] + distance * math.sin(heading),
    )


def _nearest_to_origin(finger: SlideFingerConfig, extent_mm: float) -> float:
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
