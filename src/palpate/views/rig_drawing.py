"""Drawing of a rig as its file describes it: plan view in W, heights from the side, and the wiring."""

import math
from collections.abc import Iterator

import numpy as np

from palpate.base.geometry import Floats
from palpate.config import FingerConfig, RigFile
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import mechanism_of
from palpate.views.svg import (
    AXIS,
    CARD,
    FAINT,
    FOUND,
    INK,
    LINE,
    MISS,
    MUTED,
    PAPER,
    RULE,
    THIN,
    TIP,
    TIP_FILL,
    element,
    number,
    path_data,
    shorten_middle,
    text,
)

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
        element("rect", x=0, y=0, width=width, height=height, fill=PAPER),
        text(f"rig {rig.name}", _MARGIN, 32, size=18, weight="bold"),
        text(shorten_middle(bus, 12, width - 2 * _MARGIN), _MARGIN, 52, size=12, fill=MUTED),
        *_table(rig, plan),
        element(
            "clipPath",
            element("rect", x=_MARGIN, y=_TOP_HEIGHT, width=_PLAN_SIZE, height=_PLAN_SIZE),
            id="plan",
        ),
        element("g", *(_reach(finger, plan) for finger in rig.fingers), clip_path="url(#plan)"),
        *(part for finger in rig.fingers for part in _finger(finger, plan)),
        *_cards(rig, column),
    ]
    box = f"0 0 {number(width)} {number(height)}"
    return element(
        "svg",
        element("title", f"rig {rig.name}, from above"),
        *parts,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=box,
        width=width,
        height=height,
        font_family="sans-serif",
        role="img",
    )


def _table(rig: RigFile, plan: _Plan) -> Iterator[str]:
    (x, y), radius = plan.at(np.zeros(2)), rig.workspace.radius_mm
    yield element("circle", cx=x, cy=y, r=radius * plan.scale, fill=CARD, stroke=RULE, stroke_width=LINE)
    below = y + radius * plan.scale + 16
    yield text(f"workspace, radius {radius:g} mm", x, below, size=11, fill=MUTED, anchor="middle")
    for along, name in (((1.0, 0.0), "x"), ((0.0, 1.0), "y")):
        end = plan.at(0.3 * radius * np.array(along))
        yield element("line", x1=x, y1=y, x2=end[0], y2=end[1], stroke=AXIS, stroke_width=LINE)
        label = plan.at(0.34 * radius * np.array(along))
        yield text(name, label[0], label[1] + 4, size=12, fill=MUTED, anchor="middle")
    stage = Stage.of(rig)
    if stage.turns:
        centre = plan.at(np.array(stage.centre_mm))
        far = max(math.dist(finger.base_mm, stage.centre_mm) for finger in rig.fingers)
        yield element(
            "circle",
            cx=centre[0],
            cy=centre[1],
            r=far * plan.scale,
            fill="none",
            stroke=AXIS,
            stroke_dasharray="6 4",
        )
    for obstacle in rig.obstacles:
        outline = plan.at(np.array(obstacle.outline_mm))
        yield element("path", d=path_data([outline]), fill=FAINT, stroke=MISS, stroke_width=LINE)
        middle = outline.mean(axis=0)
        yield text(obstacle.name, middle[0], middle[1] + 4, size=11, fill=MISS, anchor="middle")


def _finger(finger: FingerConfig, plan: _Plan) -> Iterator[str]:
    base, heading = np.array(finger.base_mm), math.radians(finger.heading_deg)
    mechanism = mechanism_of(finger)
    is_slide = mechanism.push is not None
    tip_mm = mechanism.reach[2] if is_slide else 60.0  # where it waits
    tip = plan.at(base + tip_mm * np.array([math.cos(heading), math.sin(heading)]))
    (x, y), radius = plan.at(base), finger.tip.radius_mm * plan.scale
    way = {"stroke_width": 3.0} if is_slide else {"stroke_width": LINE, "stroke_dasharray": "2 3"}
    yield element("line", x1=x, y1=y, x2=tip[0], y2=tip[1], stroke=INK, **way)
    if finger.tip.kind.has_face:
        across = radius * np.array([math.sin(heading), math.cos(heading)])
        (x1, y1), (x2, y2) = tip - across, tip + across
        yield element("line", x1=x1, y1=y1, x2=x2, y2=y2, stroke=TIP, stroke_width=4.0)
    elif is_slide:  # where both joints of an arm are at 0, it is stretched out: no posture to draw
        yield element("circle", cx=tip[0], cy=tip[1], r=radius, fill=TIP_FILL, stroke=TIP, stroke_width=LINE)
    yield element("circle", cx=x, cy=y, r=7.0, fill=PAPER, stroke=INK, stroke_width=2.0)
    outward = base / max(float(np.linalg.norm(base)), 1e-9)
    label = plan.at(base + outward * 20.0 / plan.scale)
    yield text(finger.name, label[0], label[1] + 4, size=13, anchor="middle", weight="bold", fill=TIP)


def _reach(finger: FingerConfig, plan: _Plan) -> str:
    """Sector in which the middle of the tip can be."""
    low, high, near, far = mechanism_of(finger).reach
    angles = np.radians(finger.heading_deg + np.linspace(low, high, 91))
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    ring = np.concatenate((near * directions, far * directions[::-1])) + np.array(finger.base_mm)
    return element(
        "path",
        d=path_data([plan.at(ring)]),
        fill=TIP_FILL,
        fill_opacity=0.25,
        stroke=TIP,
        stroke_width=THIN,
        stroke_dasharray="3 4",
    )


def _cards(rig: RigFile, left: float) -> Iterator[str]:
    y = _TOP_HEIGHT
    for finger in rig.fingers:
        yield text(finger.name, left, y + 11, size=13, weight="bold", fill=TIP)
        for row in _wiring(finger):
            y += _LINE_HEIGHT
            yield text(shorten_middle(row, 11, _COLUMN_WIDTH), left, y + 11, size=11)
        y += 1.8 * _LINE_HEIGHT
    for servo in rig.servos:
        if servo.finger is None:
            yield text(f"{servo.joint}: servo {servo.dxl_id}, {servo.model}", left, y + 11, size=11)
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
    size = f"{finger.tip.kind.noun} {finger.tip.kind.size_text(finger.tip.radius_mm)}{high}"
    yield f"{size}, its middle {finger.height_mm:g} mm above the table"


def _side(rig: RigFile, left: float, top: float) -> Iterator[str]:
    """Tips from the side, on one scale."""
    highest = max(
        finger.height_mm + max(2 * finger.tip.radius_mm, finger.tip.half_length_mm) for finger in rig.fingers
    )
    scale = min(_SIDE_HEIGHT / highest, 3.0)
    ground, step = top + _SIDE_HEIGHT + 14, _COLUMN_WIDTH / len(rig.fingers)
    yield text("from the side", left, top + 8, size=11, fill=MUTED)
    yield element(
        "line", x1=left, y1=ground, x2=left + _COLUMN_WIDTH, y2=ground, stroke=INK, stroke_width=LINE
    )
    for k, finger in enumerate(rig.fingers):
        x, middle = left + (k + 0.5) * step, ground - finger.height_mm * scale
        radius = finger.tip.radius_mm * scale
        half = radius if finger.tip.length_mm is None else finger.tip.half_length_mm * scale
        yield element(
            "rect",
            x=x - radius,
            y=middle - half,
            width=2 * radius,
            height=2 * half,
            rx=2 if finger.tip.kind.is_upright else radius,
            fill=TIP_FILL,
            stroke=TIP,
            stroke_width=LINE,
        )
        yield element(
            "line",
            x1=x + radius + 5,
            y1=middle,
            x2=x + radius + 5,
            y2=ground,
            stroke=FOUND,
            stroke_width=THIN,
        )
        yield text(f"{finger.height_mm:g} mm", x + radius + 9, (middle + ground) / 2 + 4, size=11, fill=FOUND)
        yield text(finger.name, x, ground + 14, size=11, anchor="middle")
