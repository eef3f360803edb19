"""The picture of a recognition or a plan: the table in W, y upwards, in one scale, left of a panel."""

import math
import zlib

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import points_in_polygon
from palpate.views import svg
from palpate.views.table_picture.approaches import approach_labels, draw_approach
from palpate.views.table_picture.frame import (
    LabelPlacer,
    View,
    badge,
    draw_base,
    end_cross,
    grid,
    last_visible_point,
    leader,
    normal_wedge,
    scale_bar,
    ticks,
    view_of,
)
from palpate.views.table_picture.panel import draw_panel, panel_width
from palpate.views.table_picture.values import (
    BoundedPose,
    Picture,
    TouchMark,
)

_WEDGE_RADIUS = 30.0
_AXIS_LENGTH = 44.0
_SAME_OUTLINE_MM = 0.3
_MAX_FILLED_HYPOTHESES = 4  # hypotheses whose outlines are filled
_INSIDE_WEIGHT = 0.12  # weight of the found object's inside: a label may lie there, but rather not


def _draw_view(picture: Picture, view: View, clip: str) -> str:
    """The drawing with its frame, ticks and scale bar. `clip`: an id of its own for the clipping path."""
    placer = LabelPlacer(view.frame)
    frame = {"x": view.left, "y": view.top, "width": view.width, "height": view.height}
    drawn = [
        grid(view),
        _workspace(picture, view),
        _others(picture, view, placer),
        _found_outline(picture, view, placer),
        _axes(view, placer),
        *(_approach(touch, view, placer) for touch in picture.touches),
        *(_tip(touch, view, placer) for touch in picture.touches),
        *(draw_approach(picture, item, view, placer) for item in picture.approaches),
    ]
    labels = [_other_badges(picture, view, placer), _axis_letters(view, placer)]
    labels += [approach_labels(picture, item, view, placer) for item in picture.approaches]
    labels += [_touch_label(touch, view, placer) for touch in picture.touches]
    bases = [draw_base(base, view, placer) for base in picture.bases]
    return "".join(
        [
            svg.element("clipPath", svg.element("rect", **frame), id=clip),
            svg.element("rect", **frame, fill=svg.CARD),
            svg.element("g", *drawn, clip_path=f"url(#{clip})", stroke_linejoin="round"),
            svg.element("rect", **frame, fill="none", stroke=svg.RULE, stroke_width=svg.THIN),
            *bases,
            *labels,
            ticks(view),
            scale_bar(view),
        ]
    )


def _workspace(picture: Picture, view: View) -> str:
    if picture.workspace_radius_mm is None:
        return ""
    x, y = view.at((0.0, 0.0))
    radius = picture.workspace_radius_mm * view.scale
    return svg.circle(
        (x, y),
        radius,
        fill="none",
        stroke=svg.RULE,
        stroke_width=svg.LINE,
        stroke_dasharray="1 4",
        stroke_linecap="round",
    )


def _others(picture: Picture, view: View, placer: LabelPlacer) -> str:
    shown = []
    few = bool(picture.approaches) and len(picture.others) <= _MAX_FILLED_HYPOTHESES
    for index, other in enumerate(picture.others[: svg.MAX_OTHERS]):
        rings = [view.to_page(ring) for ring in other.rings]
        for ring in rings:
            placer.add_ring(ring, 0.7)
        shown.append(
            svg.element(
                "path",
                svg.element("title", svg.escape(f"{other.label}: {other.reason}")),
                d=svg.path_data(rings),
                fill=picture.colour(index) if few else "none",
                fill_opacity=0.04 if few else None,
                fill_rule="evenodd" if few else None,
                stroke=picture.colour(index),
                stroke_width=svg.LINE if picture.approaches else svg.THIN,
                stroke_opacity=(0.75 if few else 0.45) if picture.approaches else None,
                stroke_dasharray=_dash(picture, index),
            )
        )
    return "".join(shown)


def _dash(picture: Picture, index: int) -> str | None:
    """Dashes of an outline: of a plan's hypotheses only those that lie on another one, so that both show."""
    if not picture.approaches:
        return svg.DASHES[index % len(svg.DASHES)]
    own = np.vstack(picture.others[index].rings)
    for other in picture.others[:index]:
        rings = np.vstack(other.rings)
        if rings.shape == own.shape and np.abs(rings - own).max() < _SAME_OUTLINE_MM:
            return "8 8"
    return None


def _found_outline(picture: Picture, view: View, placer: LabelPlacer) -> str:
    shown = []
    if picture.found:
        rings = [view.to_page(ring) for ring in picture.found]
        for ring in rings:
            placer.add_ring(ring, 3.0)
        placer.add_inside(rings, _INSIDE_WEIGHT)
        shown.append(
            svg.closed_path(
                rings,
                fill=svg.FOUND_FILL,
                fill_opacity=0.85,
                fill_rule="evenodd",
                stroke=svg.FOUND,
                stroke_width=svg.THICK,
            )
        )
    if picture.truth:
        rings = [view.to_page(ring) for ring in picture.truth]
        for ring in rings:
            placer.add_ring(ring, 3.0)
        shown.append(svg.closed_path(rings, fill="none", stroke=svg.TRUTH, stroke_width=svg.LINE))
    if picture.pose is not None:
        shown.append(_pose_mark(picture.pose, view, placer))
    return "".join(shown)


def _pose_mark(pose: BoundedPose, view: View, placer: LabelPlacer) -> str:
    """The origin of the object's frame with its own x axis, which a round part has none of."""
    at = view.at((pose.x_mm[0], pose.y_mm[0]))
    dot = svg.circle(at, 4.0, fill=svg.PAPER, stroke=svg.FOUND, stroke_width=svg.THICK)
    placer.add_disc(at, 4.0, 2.0)
    if pose.turns_freely:
        return dot
    tip = at + 22 * np.array([math.cos(pose.theta_rad[0]), -math.sin(pose.theta_rad[0])])
    placer.add_line(np.array([at, tip]), 2.0)
    line = svg.segment(at, tip, stroke=svg.FOUND, stroke_width=svg.THICK)
    return line + dot


def _axes(view: View, placer: LabelPlacer) -> str:
    if not view.holds((0.0, 0.0)):
        return ""
    x, y = view.at((0.0, 0.0)).tolist()
    placer.add_line(np.array([[x, y - _AXIS_LENGTH], [x, y], [x + _AXIS_LENGTH, y]]), 1.5)
    lines = f"M{svg.number(x)},{svg.number(y - _AXIS_LENGTH)}V{svg.number(y)}H{svg.number(x + _AXIS_LENGTH)}"
    heads = f"M{svg.number(x - 3.5)},{svg.number(y - _AXIS_LENGTH + 7)}l3.5,-7l3.5,7"
    heads += f"M{svg.number(x + _AXIS_LENGTH - 7)},{svg.number(y - 3.5)}l7,3.5l-7,3.5"
    return svg.element("path", d=lines + heads, stroke=svg.AXIS, stroke_width=svg.LINE, fill="none")


def _axis_letters(view: View, placer: LabelPlacer) -> str:
    if not view.holds((0.0, 0.0)):
        return ""
    origin = view.at((0.0, 0.0))
    shown = []
    for letter, offset, towards in (
        ("x", (_AXIS_LENGTH, 0.0), 0.0),
        ("y", (0.0, -_AXIS_LENGTH), math.pi / 2),
    ):
        box = placer.place(origin + np.array(offset), 9.0, 12.0, clear=3.0, towards=towards)
        shown.append(
            svg.text(letter, box.x, box.y + 4, fill=svg.AXIS, anchor="middle", weight="bold", size=12)
        )
    return "".join(shown)


def _approach(touch: TouchMark, view: View, placer: LabelPlacer) -> str:
    """The way of the tip's centre; what a miss has swept is shaded."""
    start, end = view.at(touch.start_mm), view.at(touch.end_mm)
    placer.add_line(np.array([start, end]), 1.0)
    begin = svg.circle(start, 2.2, fill=svg.TIP if touch.touched else svg.MISS)
    if touch.touched:
        return svg.segment(start, end, stroke=svg.TIP, stroke_width=svg.LINE) + begin
    swept = svg.segment(
        start,
        end,
        stroke=svg.MISS,
        stroke_opacity=0.12,
        stroke_width=2 * touch.tip_radius_mm * view.scale,
        stroke_linecap="butt" if touch.has_face else "round",
    )
    way = svg.segment(start, end, stroke=svg.MISS, stroke_width=svg.LINE, stroke_dasharray="6 4")
    return swept + way + begin


def _tip(touch: TouchMark, view: View, placer: LabelPlacer) -> str:
    centre, radius = view.at(touch.end_mm), touch.tip_radius_mm * view.scale
    placer.add_disc(centre, max(radius, 4.0) + 2, 2.0)
    if not touch.touched:
        dashed: dict[str, str | float] = {
            "fill": "none",
            "stroke": svg.MISS,
            "stroke_width": svg.LINE,
            "stroke_dasharray": "3 3",
        }
        return _outline_of_tip(touch, view, **dashed) + end_cross(centre, svg.MISS)
    shown = [_outline_of_tip(touch, view, fill=svg.TIP_FILL, stroke=svg.TIP, stroke_width=svg.LINE)]
    if touch.normal_rad is not None:
        lo, hi = touch.normal_rad
        reach = max(_WEDGE_RADIUS, radius + 20)
        shown.append(normal_wedge(centre, reach, lo, hi))
        for angle in np.linspace(lo, hi, 5):
            placer.add_line(
                np.array([centre, centre + reach * np.array([math.cos(angle), -math.sin(angle)])]), 2.0
            )
    for u, v in map(view.at, touch.points_mm) if touch.has_face else [centre]:
        shown.append(svg.circle((u, v), 2.6, fill=svg.TIP))
    return "".join(shown)


def _outline_of_tip(touch: TouchMark, view: View, **style: str | float) -> str:
    """A disc where the tip was in the end, or a pad's face."""
    (x, y), radius = view.at(touch.end_mm).tolist(), touch.tip_radius_mm * view.scale
    if not touch.has_face:
        return svg.circle((x, y), radius, **style)
    along = view.at(touch.end_mm) - view.at(touch.start_mm)
    u, v = (radius * along / max(float(np.hypot(*along)), 1e-9)).tolist()
    return svg.segment((x - v, y + u), (x + v, y - u), **style | {"stroke_width": 3.0})


def _touch_label(touch: TouchMark, view: View, placer: LabelPlacer) -> str:
    content = f"{svg.shorten(touch.finger, svg.LABEL_SIZE, 90, bold=True)} · {touch.grip}"
    width = svg.text_width(content, svg.LABEL_SIZE, bold=True)
    end, start = view.at(touch.end_mm), view.at(touch.start_mm)
    back = math.atan2(end[1] - start[1], start[0] - end[0])
    shown = last_visible_point(start, end, view)
    if shown is None:
        return ""
    end = shown
    clear = max(touch.tip_radius_mm * view.scale, 5.0) + 4
    box = placer.place(end, width + 4, 15.0, clear=clear, towards=back + math.pi / 2)
    verb = "touched" if touch.touched else "missed"
    colour = svg.TIP if touch.touched else svg.MISS
    return svg.element(
        "g",
        svg.element("title", svg.escape(f"finger {touch.finger}, grip {touch.grip}: {verb}")),
        leader(end, box, clear, colour),
        svg.text(content, box.x, box.y + 4, size=svg.LABEL_SIZE, fill=colour, anchor="middle", weight="bold"),
    )


def _other_badges(picture: Picture, view: View, placer: LabelPlacer) -> str:
    """A badge beside every dashed outline, where it is farthest from all that is drawn."""
    shown = []
    frame = view.frame
    middle = np.array([frame.x, frame.y])
    rivals = [view.to_page(ring) for ring in (*picture.found, *picture.truth)]
    drawn = [
        np.vstack([view.to_page(ring) for ring in other.rings]) for other in picture.others[: svg.MAX_OTHERS]
    ]
    for index, own in enumerate(drawn):
        inside = np.all(np.abs(own - middle) < np.array([frame.width, frame.height]) / 2 - 12, axis=1)
        points = own[inside] if inside.any() else own
        if picture.found:
            open_points = points[~points_in_polygon(points, rivals[: len(picture.found)])]
            points = open_points if len(open_points) else points
        points = _thin_out(points, 200)
        crowd = _thin_out(np.vstack([*rivals, *drawn[:index], *drawn[index + 1 :], middle[None]]), 3000)
        apart = np.hypot(*(points[:, None] - crowd).transpose(2, 0, 1)).min(axis=1)
        anchor = points[int(np.argmax(apart))]
        outward = math.atan2(middle[1] - anchor[1], anchor[0] - middle[0])
        box = placer.place(anchor, 17.0, 17.0, clear=1.0, towards=outward)
        shown.append(
            leader(anchor, box, 4.0, picture.colour(index))
            + badge(index, picture.colour(index), box.x, box.y)
        )
    return "".join(shown)


def _thin_out(points: Floats, most: int) -> Floats:
    """Pick at most `most` of the points (n, 2), evenly."""
    result: Floats = points[:: -(-len(points) // most)]
    return result


_PAGE_MARGIN = 28.0
_TICKS_WIDTH = 44.0  # left of the drawing
_PANEL_GAP = 36.0
_SPACE_BELOW = 46.0


def draw(picture: Picture) -> str:
    """The picture as an SVG document of its own, which may also be pasted into an HTML page."""
    left = _PAGE_MARGIN + _TICKS_WIDTH
    title = svg.wrap(picture.title, 24, 1080, most_lines=2, bold=True)
    subtitle = [part for line in picture.subtitle for part in svg.wrap(line, 13.5, 1080, most_lines=2)]
    y = _PAGE_MARGIN - 6
    head = []
    for line in title:
        y += 30
        head.append(svg.text(line, left, y, size=24, fill=svg.INK, weight="bold"))
    for line in subtitle:
        y += 21
        head.append(svg.text(line, left, y, size=13.5, fill=svg.MUTED))
    top = y + 24
    view = view_of(picture, left, top)
    column = svg.Column(left + view.width + _PANEL_GAP, panel_width(picture))
    _, panel_end = draw_panel(picture, view, column, top - 2)
    view = view.taller(panel_end - _SPACE_BELOW - top)
    panel, panel_end = draw_panel(picture, view, column, top - 2)
    width = column.right + _PAGE_MARGIN
    height = max(top + view.height + _SPACE_BELOW, panel_end) + _PAGE_MARGIN - 8
    clip = f"window-{zlib.crc32(repr((view, picture.title)).encode()):08x}"
    return svg.document(
        (width, height),
        *head,
        _draw_view(picture, view, clip),
        panel,
        title=picture.title or "Recognition",
        description=_description(picture),
    )


def _description(picture: Picture) -> str:
    """The picture in words, for those who do not see it."""
    touched = sum(touch.touched for touch in picture.touches)
    grips = len({touch.grip for touch in picture.touches})
    words = [*picture.subtitle]
    missed = len(picture.touches) - touched
    words.append(f"Grips: {grips}; contacts: {touched}; approaches that touched nothing: {missed}.")
    words.append(f"{'Hypotheses' if picture.approaches else 'Other hypotheses'}: {len(picture.others)}.")
    words += [f"Next, {item.finger}: {', '.join(item.words)}." for item in picture.approaches]
    if picture.pose is not None:
        x, y, theta = picture.pose.x_mm[0], picture.pose.y_mm[0], picture.pose.theta_rad[0]
        angle = "any" if picture.pose.turns_freely else f"{theta:.4f} rad"
        words.append(f"Configuration: x {x:.2f} mm, y {y:.2f} mm, θ {angle}.")
    return " ".join(words)
