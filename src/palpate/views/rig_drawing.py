"""Drawing of a rig as its file describes it: plan view in W, heights from the side, and the wiring."""

import math
from collections.abc import Iterator

import numpy as np

from palpate.base.geometry import Floats
from palpate.config import FingerConfig, RigFile
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import mechanism_of
from palpate.views import svg

_PLAN_SIZE = 620.0
_COLUMN_WIDTH = 372.0
_MARGIN = 24.0
_TOP_HEIGHT = 70.0
_SIDE_HEIGHT = 90.0
_LINE_HEIGHT = 15.0
_MAX_CARD_LINES = 6


class _Plan:
    """The plan view: W in SVG units."""

    def __init__(self, rig: RigFile) -> None:
        far = [math.hypot(*finger.base_mm) + 25.0 for finger in rig.fingers]
        far += [math.hypot(*point) for obstacle in rig.obstacles for point in obstacle.outline_mm]
        self.reach_mm = max([rig.workspace.radius_mm, *far]) * 1.06
        self.scale = _PLAN_SIZE / (2 * self.reach_mm)
        self._middle = np.array([_MARGIN + _PLAN_SIZE / 2, _TOP_HEIGHT + _PLAN_SIZE / 2])

    def at(self, point_mm: Floats) -> Floats:
        """Points (…, 2) of W."""
        return self._middle + np.asarray(point_mm) * (self.scale, -self.scale)


def draw_rig(rig: RigFile) -> str:
    """The drawing (SVG)."""
    plan = _Plan(rig)
    column = _MARGIN + _PLAN_SIZE + _MARGIN
    cards = _TOP_HEIGHT + len(rig.fingers) * (_MAX_CARD_LINES + 1.2) * _LINE_HEIGHT + _SIDE_HEIGHT + 60
    width, height = column + _COLUMN_WIDTH + _MARGIN, max(_TOP_HEIGHT + _PLAN_SIZE + _MARGIN, cards + _MARGIN)
    bus = f"bus {rig.bus.port}, {rig.bus.baudrate_bps} bit/s"
    parts = [
        svg.text(f"rig {rig.name}", _MARGIN, 32, size=18, weight="bold"),
        svg.text(svg.shorten_middle(bus, 12, width - 2 * _MARGIN), _MARGIN, 52, size=12, fill=svg.MUTED),
        *_table(rig, plan),
        svg.element("clipPath", svg.rectangle((_MARGIN, _TOP_HEIGHT), (_PLAN_SIZE, _PLAN_SIZE)), id="plan"),
        svg.element("g", *(_reach(finger, plan) for finger in rig.fingers), clip_path="url(#plan)"),
        *(part for finger in rig.fingers for part in _finger(finger, plan)),
        *_cards(rig, column),
    ]
    return svg.document((width, height), *parts, title=f"rig {rig.name}, from above", is_sized=True)


def _table(rig: RigFile, plan: _Plan) -> Iterator[str]:
    (x, y), radius = plan.at(np.zeros(2)), rig.workspace.radius_mm
    yield svg.circle((x, y), radius * plan.scale, fill=svg.CARD, stroke=svg.RULE, stroke_width=svg.LINE)
    below = y + radius * plan.scale + 16
    yield svg.text(f"workspace, radius {radius:g} mm", x, below, size=11, fill=svg.MUTED, anchor="middle")
    for along, name in (((1.0, 0.0), "x"), ((0.0, 1.0), "y")):
        end = plan.at(0.3 * radius * np.array(along))
        yield svg.segment((x, y), end, stroke=svg.AXIS, stroke_width=svg.LINE)
        label = plan.at(0.34 * radius * np.array(along))
        yield svg.text(name, label[0], label[1] + 4, size=12, fill=svg.MUTED, anchor="middle")
    stage = Stage.of(rig)
    if stage.turns:
        centre = plan.at(np.array(stage.centre_mm))
        far = max(math.dist(finger.base_mm, stage.centre_mm) for finger in rig.fingers)
        yield svg.circle(centre, far * plan.scale, fill="none", stroke=svg.AXIS, stroke_dasharray="6 4")
    for obstacle in rig.obstacles:
        outline = plan.at(np.array(obstacle.outline_mm))
        yield svg.closed_path([outline], fill=svg.FAINT, stroke=svg.MISS, stroke_width=svg.LINE)
        middle = outline.mean(axis=0)
        yield svg.text(obstacle.name, middle[0], middle[1] + 4, size=11, fill=svg.MISS, anchor="middle")


def _finger(finger: FingerConfig, plan: _Plan) -> Iterator[str]:
    base, heading = np.array(finger.base_mm), math.radians(finger.heading_deg)
    mechanism = mechanism_of(finger)
    is_slide = mechanism.push is not None
    tip_mm = mechanism.reach[2] if is_slide else 60.0  # where it waits
    tip = plan.at(base + tip_mm * np.array([math.cos(heading), math.sin(heading)]))
    (x, y), radius = plan.at(base), finger.tip.radius_mm * plan.scale
    way = {"stroke_width": 3.0} if is_slide else {"stroke_width": svg.LINE, "stroke_dasharray": "2 3"}
    yield svg.segment((x, y), tip, stroke=svg.INK, **way)
    if outline := finger.tip.kind.plan_mm(finger.tip.radius_mm, finger.tip.width_mm):
        ahead = np.array([math.cos(heading), math.sin(heading)])
        ring = np.array(outline) @ [ahead, [-ahead[1], ahead[0]]] + base + tip_mm * ahead
        wide = 4.0 if len(ring) == 2 else svg.LINE
        yield svg.closed_path([plan.at(ring)], fill=svg.TIP_FILL, stroke=svg.TIP, stroke_width=wide)
    elif is_slide:  # where both joints of an arm are at 0, it is stretched out: no posture to draw
        yield svg.circle(tip, radius, fill=svg.TIP_FILL, stroke=svg.TIP, stroke_width=svg.LINE)
    yield svg.circle((x, y), 7.0, fill=svg.PAPER, stroke=svg.INK, stroke_width=2.0)
    outward = base / max(float(np.linalg.norm(base)), 1e-9)
    label = plan.at(base + outward * 20.0 / plan.scale)
    yield svg.text(finger.name, label[0], label[1] + 4, size=13, anchor="middle", weight="bold", fill=svg.TIP)


def _reach(finger: FingerConfig, plan: _Plan) -> str:
    """Sector in which the middle of the tip can be."""
    low, high, near, far = mechanism_of(finger).reach
    angles = np.radians(finger.heading_deg + np.linspace(low, high, 91))
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    ring = np.concatenate((near * directions, far * directions[::-1])) + np.array(finger.base_mm)
    return svg.closed_path(
        [plan.at(ring)],
        fill=svg.TIP_FILL,
        fill_opacity=0.25,
        stroke=svg.TIP,
        stroke_width=svg.THIN,
        stroke_dasharray="3 4",
    )


def _cards(rig: RigFile, left: float) -> Iterator[str]:
    y = _TOP_HEIGHT
    for finger in rig.fingers:
        yield svg.text(finger.name, left, y + 11, size=13, weight="bold", fill=svg.TIP)
        for row in _wiring(finger):
            y += _LINE_HEIGHT
            yield svg.text(svg.shorten_middle(row, 11, _COLUMN_WIDTH), left, y + 11, size=11)
        y += 1.8 * _LINE_HEIGHT
    for servo in rig.servos:
        if servo.finger is None:
            yield svg.text(f"{servo.joint}: servo {servo.dxl_id}, {servo.model}", left, y + 11, size=11)
            y += 1.8 * _LINE_HEIGHT
    yield from _side(rig, left, y)


def _wiring(finger: FingerConfig) -> Iterator[str]:
    x, y = finger.base_mm
    yield f"base ({x:g}, {y:g}) mm, heading {finger.heading_deg:g}°"
    mechanism, moves = mechanism_of(finger), {}
    if (aim := mechanism.aim) is not None:
        moves["aim"] = f", {aim.gear_ratio:g} : 1, {aim.range_deg[0]:g}° to {aim.range_deg[1]:g}°"
    if (slide := mechanism.push) is not None:
        moves["slide"] = f", {slide.mm_per_turn:g} mm/turn, {slide.range_mm[0]:g}–{slide.range_mm[1]:g} mm"
    for name, servo in finger.servos.items():
        yield f"{name}: servo {servo.dxl_id}, {servo.model}{moves.get(name, '')}"
    yield f"array: {finger.array.port}"
    high = "" if finger.tip.length_mm is None else f", {finger.tip.length_mm:g} mm high"
    size = f"{finger.tip.kind.noun} {finger.tip.size_text}{high}"
    yield f"{size}, its middle {finger.height_mm:g} mm above the table"


def _side(rig: RigFile, left: float, top: float) -> Iterator[str]:
    """Tips from the side, on one scale."""
    highest = max(
        finger.height_mm + max(2 * finger.tip.radius_mm, finger.tip.half_length_mm) for finger in rig.fingers
    )
    scale = min(_SIDE_HEIGHT / highest, 3.0)
    ground, step = top + _SIDE_HEIGHT + 14, _COLUMN_WIDTH / len(rig.fingers)
    yield svg.text("from the side", left, top + 8, size=11, fill=svg.MUTED)
    yield svg.segment((left, ground), (left + _COLUMN_WIDTH, ground), stroke=svg.INK, stroke_width=svg.LINE)
    for k, finger in enumerate(rig.fingers):
        x, middle = left + (k + 0.5) * step, ground - finger.height_mm * scale
        radius = finger.tip.half_width_mm * scale
        half = scale * (finger.tip.radius_mm if finger.tip.length_mm is None else finger.tip.half_length_mm)
        yield svg.rectangle(
            (x - radius, middle - half),
            (2 * radius, 2 * half),
            rx=2 if finger.tip.kind.is_upright else radius,
            fill=svg.TIP_FILL,
            stroke=svg.TIP,
            stroke_width=svg.LINE,
        )
        yield svg.segment(
            (x + radius + 5, middle), (x + radius + 5, ground), stroke=svg.FOUND, stroke_width=svg.THIN
        )
        yield svg.text(
            f"{finger.height_mm:g} mm", x + radius + 9, (middle + ground) / 2 + 4, size=11, fill=svg.FOUND
        )
        yield svg.text(finger.name, x, ground + 14, size=11, anchor="middle")
