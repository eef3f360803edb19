"""Picture of a felt outline: its bounds, where it was touched, and the model's outline between them."""

from collections.abc import Sequence

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.rig.learning.felt_outline import FeltOutline
from palpate.rig.learning.learned_model import known_outline
from palpate.views import svg

_WIDTH, _MARGIN, _HEAD, _FOOT = 560.0, 24.0, 54.0, 30.0
_AROUND_MM = 8.0
_SCALE_MM = 10.0


def felt_outline_picture(
    name: str, outlines: Sequence[FeltOutline], open_mm: Sequence[tuple[float, float]], summary: str
) -> str:
    """SVG of each outline, one below the other; W has x to the right and y up.

    `open_mm`: places that are not closed, rings in the drawing.
    """
    parts = [svg.text(f"{name}, as tips have felt it", _MARGIN, 26.0, size=16.0, weight="bold")]
    parts += [
        svg.text(line, _MARGIN, 44.0 + 15.0 * k)
        for k, line in enumerate(svg.wrap(summary, 12.0, _WIDTH - 2 * _MARGIN, most_lines=2))
    ]
    top = _HEAD + 18.0
    for felt in outlines:
        drawn, height = _drawn(felt, open_mm, top)
        parts, top = [*parts, *drawn], top + height
    parts += _legend(top + 8.0)
    return svg.document((_WIDTH, top + _FOOT), *parts, title=f"{name}: {summary}", is_sized=True)


def _drawn(felt: FeltOutline, open_mm: Sequence[tuple[float, float]], top: float) -> tuple[list[str], float]:
    """Drawing of one outline from `top` on, and its height."""
    corners = felt.touched.middles_mm if len(felt.touched.middles_mm) else np.zeros((1, 2))
    low, high = corners.min(axis=0) - _AROUND_MM, corners.max(axis=0) + _AROUND_MM
    scale = (_WIDTH - 2 * _MARGIN) / max(float((high - low).max()), 1.0)
    frame = shapely.box(*low, *high)

    def place(points: Floats) -> Floats:
        x, y = points.T
        return np.column_stack([_MARGIN + scale * (x - low[0]), top + scale * (high[1] - y)])

    def rings(shape: shapely.Geometry) -> list[Floats]:
        pieces = shapely.get_parts(shape.intersection(frame))
        found = [
            ring
            for item in pieces
            if isinstance(item, shapely.Polygon)
            for ring in (item.exterior, *item.interiors)
        ]
        return [place(shapely.get_coordinates(ring)[:-1]) for ring in found]

    parts = [
        svg.closed_path(rings(felt.outer), fill=svg.FAINT, fill_rule="evenodd", stroke=svg.AXIS),
        svg.closed_path(rings(felt.inner), fill=svg.TIP_FILL, fill_rule="evenodd", stroke=svg.TIP),
    ]
    if (known := known_outline(felt)) is not None:
        model = place(known.points_mm)
        parts.append(svg.closed_path([model], fill="none", stroke=svg.FOUND, stroke_width=svg.LINE))
    parts += [svg.circle((x, y), 2.0, fill=svg.TRUTH) for x, y in place(felt.touched.middles_mm).tolist()]
    ringed = place(np.array(open_mm).reshape(-1, 2)).tolist()
    parts += [svg.circle((x, y), 5.0, fill="none", stroke=svg.MISS) for x, y in ringed]
    height = scale * float(high[1] - low[1])
    at = _WIDTH - _MARGIN - scale * _SCALE_MM, top + height + 16.0
    parts.append(svg.segment(at, (at[0] + scale * _SCALE_MM, at[1]), stroke=svg.INK, stroke_width=svg.LINE))
    parts.append(svg.text("10 mm", at[0] + scale * _SCALE_MM / 2, at[1] - 5.0, anchor="middle"))
    return parts, height + 24.0


def _legend(top: float) -> list[str]:
    entries = (
        ("solid to a tip", svg.TIP_FILL, svg.TIP),
        ("may be solid", svg.FAINT, svg.AXIS),
        ("model", "none", svg.FOUND),
        ("touched", svg.TRUTH, svg.TRUTH),
        ("not closed", "none", svg.MISS),
    )
    parts, x = list[str](), _MARGIN
    for words, fill, line in entries:
        parts.append(svg.rectangle((x, top), (12.0, 12.0), fill=fill, stroke=line))
        parts.append(svg.text(words, x + 17.0, top + 10.5))
        x += 34.0 + svg.text_width(words, 12.0)
    return parts
