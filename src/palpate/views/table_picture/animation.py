"""Moving picture of a recorded run: SVG that moves by itself (SMIL), and shows the end where it does not."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.config.recognition_results import IdentificationOut
from palpate.rig.session.logged_values import (
    LoggedHypothesis,
    LoggedTouch,
    by_part,
    hypotheses_in,
    sort_by_weight,
    touches_in,
)
from palpate.rig.session.recorded_session import EventSample, SessionSamples, TipSample
from palpate.views import svg
from palpate.views.answer import headline, part_answer, rest_words
from palpate.views.numerals import at_least, at_most, decimal
from palpate.views.run_scene import heaviest, outlines_in_w, widest_place
from palpate.views.table_picture.frame import View, grid, normal_wedge, scale_bar, ticks

_FILM_S, _HOLD_S, _FADE_S = 14.0, 6.0, 1.2  # the run, how long its end stands still, how long outlines fall
_TABLE, _TICKS, _GAP, _PANEL, _MARGIN = 420.0, 44.0, 28.0, 340.0, 18.0
_SPACE_BELOW = 46.0
_ROW, _LINE, _MAX_ROWS = 46.0, 19.0, 12
_MARGIN_SHARE = 0.32  # of the window, around outlines and contacts
_MOVED_MM = 0.25  # tracks are thinned by as much
_SAME_MM, _SAME_RAD = 12.0, 0.5  # farther apart, two outlines are not one hypothesis before and after a grip
_WEDGE = 26.0

Points = tuple[tuple[float, float], ...]


@dataclass
class _Story:
    """Course of a run: tracks of fingers (joints and tip, mm), contacts, hypotheses after each grip."""

    tracks: dict[str, list[tuple[float, Points]]] = field(default_factory=dict)
    widths_mm: dict[str, float] = field(default_factory=dict)
    touches: list[tuple[float, float, LoggedTouch]] = field(default_factory=list)
    left: list[tuple[float, int, list[LoggedHypothesis]]] = field(default_factory=list)
    divisions: dict[int, int] = field(default_factory=dict)  # after a grip, where several parts are sought
    stages: list[tuple[float, str]] = field(default_factory=list)
    answer: IdentificationOut | None = None
    is_chosen: bool = False  # grips were a program's
    end_s: float = 0.0

    def take(self, sample: TipSample) -> None:
        """Take a place of a finger."""
        places = (*sample.joints_mm, (sample.x_mm, sample.y_mm))
        self.tracks.setdefault(sample.finger, []).append((sample.t_s, places))
        self.widths_mm[sample.finger] = sample.link_width_mm

    def take_event(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Take an event."""
        match kind:
            case "stage":
                self.stages.append((t_s, f"grip {values['grip']}: {values['stage']}"))
            case "touches":
                self.touches += [(t_s, math.inf, touch) for touch in touches_in(values)]
            case "moved":  # earlier contacts do not count any more
                self.touches = [(begin, min(t_s, end), touch) for begin, end, touch in self.touches]
            case "recognised":
                self.left.append((t_s, values["grip"], sort_by_weight(hypotheses_in(kind, values))))
                if "divisions" in values:
                    self.divisions[values["grip"]] = values["divisions"]
            case "grip":
                self.is_chosen = True
            case "result":
                self.answer = IdentificationOut.model_validate(values["result"])


class _Film:
    """Times of the run as shares of the film, and elements that change in it."""

    def __init__(self, end_s: float) -> None:
        self.fade_s = _FADE_S / _FILM_S * end_s
        self._end_s = end_s

    def _share(self, t_s: float) -> float:
        return min(max(t_s / self._end_s, 0.0), 1.0) * _FILM_S / (_FILM_S + _HOLD_S)

    def animate(self, name: str, track: Sequence[tuple[float, str]]) -> str:
        """Change an attribute along a track of (s, value)."""
        shares = [0.0, *(self._share(t_s) for t_s, _ in track), 1.0]
        return svg.element(
            "animate",
            attributeName=name,
            values=";".join([track[0][1], *(value for _, value in track), track[-1][1]]),
            keyTimes=";".join(f"{share:.4f}".rstrip("0").rstrip(".") or "0" for share in shares),
            dur=f"{_FILM_S + _HOLD_S:g}s",
            repeatCount="indefinite",
        )

    def shown(self, content: str, begin_s: float, end_s: float = math.inf, fade_s: float = 0.0) -> str:
        """Show content from an instant of the run on, or until another, when it fades."""
        track = [(begin_s, "0"), (begin_s, "1")]
        track += [] if math.isinf(end_s) else [(end_s, "1"), (end_s + fade_s, "0")]
        return svg.element("g", self.animate("opacity", track), content, opacity=float(track[-1][1]))

    def moving(self, tag: str, track: Sequence[tuple[float, Mapping[str, str]]], **style: svg.Style) -> str:
        """Draw an element whose attributes follow a track."""
        names = track[0][1].keys()
        parts = [self.animate(name, [(t_s, values[name]) for t_s, values in track]) for name in names]
        return svg.element(tag, *parts, **track[-1][1], **style)


def draw_animation(samples: SessionSamples) -> str:
    """The moving picture of a recorded run. Raises InputError if nothing moves in the session."""
    story = _Story()
    for sample in samples:
        if isinstance(sample, TipSample):
            story.take(sample)
        elif isinstance(sample, EventSample):
            story.take_event(sample.t_s, sample.kind, sample.values)
        story.end_s = max(story.end_s, sample.t_s)
    if not story.tracks or not story.end_s:
        raise InputError("the session has no motion of fingers that could be animated")
    film = _Film(story.end_s)
    models = {model.name: model for model in samples.objects}
    rings = {
        (t_s, number): outlines_in_w(item, models)
        for t_s, _, items in story.left
        for number, item in _drawn(items)
    }
    panel, end = _panel(story, len(samples.objects), film)
    height = max(_TABLE + _SPACE_BELOW, end + _SPACE_BELOW - _MARGIN)
    view = _view(story, rings, samples.rig.workspace.radius_mm)
    frame = {"x": view.left, "y": view.top, "width": view.width, "height": view.height}
    table = svg.element(
        "g",
        grid(view),
        svg.circle(
            view.at((0.0, 0.0)),
            samples.rig.workspace.radius_mm * view.scale,
            fill="none",
            stroke=svg.RULE,
            stroke_width=svg.LINE,
            stroke_dasharray="4 4",
        ),
        *_hypotheses(story, rings, film, view),
        *(_contact(touch, begin, end, film, view) for begin, end, touch in story.touches),
        *_fingers(story, samples, film, view),
        clip_path="url(#table)",
    )
    return svg.document(
        (_TICKS + _TABLE + _GAP + _PANEL + _MARGIN, height + 2 * _MARGIN),
        svg.element("clipPath", svg.element("rect", **frame), id="table"),
        svg.element("rect", **frame, fill=svg.CARD),
        table,
        svg.element("rect", **frame, fill="none", stroke=svg.RULE),
        *_stage_words(story, film, view),
        ticks(view),
        scale_bar(view),
        panel,
        title=f"A recorded run: {headline(story.answer) if story.answer else 'no answer'}",
        is_sized=True,
    )


def _view(
    story: _Story, rings: Mapping[tuple[float, int], tuple[Floats, ...]], workspace_radius_mm: float
) -> View:
    """A square window that shows every outline and every contact."""
    parts = [ring for found in rings.values() for ring in found]
    parts += [np.array([touch.contact.end_mm]) for *_, touch in story.touches if touch.contact.touched]
    parts = parts or [np.array([[-workspace_radius_mm] * 2, [workspace_radius_mm] * 2])]
    points = np.vstack(parts)
    low, high = points.min(axis=0), points.max(axis=0)
    half = max(float((high - low).max()) * (0.5 + _MARGIN_SHARE), 1.0)
    (x, y), scale = ((low + high) / 2).tolist(), _TABLE / (2 * half)
    return View((x - half, x + half), (y - half, y + half), _TICKS + 4, _MARGIN, scale)


def _colours(story: _Story) -> list[list[str]]:
    """A colour of each hypothesis after each grip, which it keeps; the only one of a part is blue."""
    found: list[list[str]] = []
    known: list[tuple[LoggedHypothesis, str]] = []
    count = 0
    for _, _, items in story.left:
        colours = []
        for item in items:
            same = [pair for pair in known if _is_same(item, pair[0]) and pair[1] not in colours]
            if not same:
                count += 1
            colours.append(same[0][1] if same else svg.HUES[1 + (count - 1) % (len(svg.HUES) - 1)])
        known = list(zip(items, colours, strict=True))
        found.append(
            [
                svg.FOUND if _is_only(item, items) else colour
                for item, colour in zip(items, colours, strict=True)
            ]
        )
    return found


def _is_only(item: LoggedHypothesis, items: Sequence[LoggedHypothesis]) -> bool:
    """Return whether nothing else is left of the hypothesis's part."""
    return sum(other.part == item.part for other in items) == 1


def _drawn(items: Sequence[LoggedHypothesis]) -> list[tuple[int, LoggedHypothesis]]:
    """Hypotheses whose outlines are drawn, with their places in the list."""
    chosen = {id(item) for item in heaviest(items, svg.MAX_OTHERS)}
    return [(number, item) for number, item in enumerate(items) if id(item) in chosen]


def _is_same(one: LoggedHypothesis, other: LoggedHypothesis) -> bool:
    a, b = one.configuration, other.configuration
    turn = abs(math.remainder(a.theta_rad - b.theta_rad, math.tau))
    near = math.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm) < _SAME_MM and turn < _SAME_RAD
    return near and one.name == other.name


def _hypotheses(
    story: _Story, rings: Mapping[tuple[float, int], tuple[Floats, ...]], film: _Film, view: View
) -> Iterator[str]:
    """Outlines of the hypotheses after each grip; those that the next one rules out fade."""
    colours = _colours(story)
    for at, (t_s, _, items) in enumerate(story.left):
        end_s = story.left[at + 1][0] if at + 1 < len(story.left) else math.inf
        after = story.left[at + 1][2] if at + 1 < len(story.left) else items
        for number, item in reversed(_drawn(items)):
            colour, is_only = colours[at][number], _is_only(item, items)
            pages = [view.to_page(ring) for ring in rings[t_s, number]]
            path = svg.closed_path(
                pages,
                fill=colour,
                fill_opacity=0.18 if is_only else 0.07,
                fill_rule="evenodd",
                stroke=colour,
                stroke_width=svg.THICK if is_only else 2.0,
            )
            if is_only and story.divisions and pages:
                x, y = widest_place(pages)
                path += svg.text(item.object, x, y + 5, size=14, fill=colour, anchor="middle", weight="bold")
            falls = not any(_is_same(item, other) for other in after)
            yield film.shown(path, t_s, end_s, film.fade_s if falls else 0.0)


def _contact(touch: LoggedTouch, begin_s: float, end_s: float, film: _Film, view: View) -> str:
    """The way of a touch, the tip where it stopped with the number of the grip, and the normal's range."""
    contact = touch.contact
    start, end = view.at(contact.start_mm), view.at(contact.end_mm)
    colour = svg.TIP if contact.touched else svg.MISS
    shown = svg.segment(
        start, end, stroke=colour, stroke_width=svg.LINE, stroke_dasharray=None if contact.touched else "6 4"
    )
    if contact.touched:
        radius = max(contact.finger.tip_radius_mm * view.scale, 8.0)
        if contact.normal is not None:
            shown += normal_wedge(end, radius + _WEDGE, contact.normal.lo_rad, contact.normal.hi_rad)
        if contact.finger.tip.has_face:
            ends = _face(np.array([start, end]), contact.finger.tip_radius_mm * view.scale)
            shown += svg.segment(ends[0], ends[1], stroke=svg.TIP, stroke_width=svg.THICK)
            shown += "".join(svg.circle(view.at(place.end_mm), 3.0, fill=svg.TIP) for place in touch.places)
            radius, end = 8.0, end + 12.0 * (start - end) / max(float(np.hypot(*(start - end))), 1e-9)
        shown += svg.circle(end, radius, fill=svg.TIP_FILL, stroke=svg.TIP, stroke_width=svg.LINE)
        shown += svg.text(
            str(touch.grip), end[0], end[1] + 4, size=12, fill=svg.TIP, anchor="middle", weight="bold"
        )
    return film.shown(shown, begin_s, end_s)


def _fingers(story: _Story, samples: SessionSamples, film: _Film, view: View) -> Iterator[str]:
    """Bodies and tips of the fingers, as they moved."""
    for finger in samples.rig.fingers:
        track = _thin(story.tracks.get(finger.name, []))
        if not track:
            continue
        pages = [(t_s, view.to_page(np.array(places))) for t_s, places in track]
        way = [(t_s, {"d": _line(page)}) for t_s, page in pages]
        width = story.widths_mm[finger.name] * view.scale
        yield film.moving(
            "path",
            way,
            fill="none",
            stroke=svg.AXIS,
            stroke_width=width,
            stroke_opacity=0.35,
            stroke_linejoin="round",
        )
        if finger.tip.kind.has_face:
            half = finger.tip.half_width_mm * view.scale
            face = [(t_s, {"d": _line(_face(page, half))}) for t_s, page in pages]
            yield film.moving("path", face, stroke=svg.INK, stroke_width=5.0, stroke_linecap="round")
            continue
        centre = [
            (t_s, {"cx": svg.number(page[-1, 0]), "cy": svg.number(page[-1, 1])}) for t_s, page in pages
        ]
        yield film.moving("circle", centre, r=finger.tip.radius_mm * view.scale, fill=svg.INK)


def _face(page: Floats, half: float) -> Floats:
    """Ends (2, 2) of a pad's face, across the last link."""
    along = page[-1] - page[-2]
    across = half * np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
    return np.array([page[-1] - across, page[-1] + across])


def _line(page: Floats) -> str:
    return "M" + "L".join(f"{svg.number(x)} {svg.number(y)}" for x, y in page.tolist())


def _thin(track: list[tuple[float, Points]]) -> list[tuple[float, Points]]:
    """Leave out what even motion between kept places explains (Douglas and Peucker, in time)."""
    kept, open_spans = {0, len(track) - 1}, [(0, len(track) - 1)]
    times, places = np.array([t_s for t_s, _ in track]), np.array([item for _, item in track])
    while open_spans:
        a, b = open_spans.pop()
        if b - a < 2:
            continue
        share = ((times[a:b] - times[a]) / max(times[b] - times[a], 1e-9))[:, None, None]
        off = np.abs(places[a:b] - places[a] - share * (places[b] - places[a])).max(axis=(1, 2))
        k = a + int(np.argmax(off))
        if off[k - a] > _MOVED_MM:
            kept.add(k)
            open_spans += [(a, k), (k, b)]
    return [track[k] for k in sorted(kept)] if track else []


def _stage_words(story: _Story, film: _Film, view: View) -> Iterator[str]:
    """Stages of the grips, in a corner of the table."""
    for (begin_s, words), (end_s, _) in pairwise([*story.stages, (story.end_s, "")]):
        line = svg.text(words, view.left + 8, view.top + 18, size=12.5, fill=svg.MUTED)
        yield film.shown(line, begin_s, end_s)


def _panel(story: _Story, objects: int, film: _Film) -> tuple[str, float]:
    """Hypotheses that are left after each grip, and the answer with its bounds; the y at which they end."""
    left, y = _TICKS + _TABLE + _GAP, _MARGIN + 16
    verb = "lie" if story.divisions else "lies"
    question = "What lies here?" if story.is_chosen else f"Which of {objects} known parts {verb} here?"
    shown = [svg.text(question, left, y, size=15, weight="bold")]
    colours = _colours(story)
    for at in _rows(story):
        t_s, grip, items = story.left[at]
        y += _ROW
        label = svg.text(f"grip {grip}", left, y - 8, size=13.5, fill=svg.MUTED)
        if grip in story.divisions:
            row, y = _part_rows(story.divisions[grip], items, colours[at], left, y)
        else:
            row = _only_row(items, colours[at], left, y)
        shown.append(film.shown(label + row, t_s))
    if story.answer is not None:
        answer, y = _answer(story.answer, left, y + 54)
        shown.append(film.shown(answer, story.end_s))
    return "".join(shown), y


def _rows(story: _Story) -> list[int]:
    """Grips (indices) that have a row: all, or of many those that have left something else, and the last."""
    last = len(story.left) - 1
    if last < _MAX_ROWS:
        return list(range(last + 1))
    names = [[(item.part, item.name) for item in items] for *_, items in story.left]
    return [at for at in range(last + 1) if at in (0, last) or names[at] != names[at - 1]]


def _only_row(items: Sequence[LoggedHypothesis], colours: Sequence[str], left: float, y: float) -> str:
    """Hypotheses of the only part, beside each other."""
    count = f"{len(items)} possible" if len(items) != 1 else "1 left"
    row, x = svg.text(count, left, y + 9, size=13.5, weight="bold"), left + 92
    for item, colour in zip(items, colours, strict=True):
        name = svg.shorten(item.object, 13.5, 120, bold=True)
        width = max(svg.text_width(name, 13.5, bold=True), 44.0)
        if x + width > left + _PANEL - 24:
            return row + svg.text("…", x, y, size=13.5, fill=svg.MUTED)
        row += svg.text(name, x, y - 8, size=13.5, fill=colour, weight="bold")
        words = f"{100 * item.weight:.0f} %" if len(items) > 1 else _half_widths(item)
        row += svg.text(words, x, y + 9, size=13, fill=svg.MUTED)
        x += width + 18
    return row


def _part_rows(
    divisions: int, items: Sequence[LoggedHypothesis], colours: Sequence[str], left: float, y: float
) -> tuple[str, float]:
    """A line for each part with its hypotheses; the y of the last line, as that of a row for one part."""
    ways = f"{divisions} ways" if divisions > 1 else ""
    row = svg.text(ways, left, y + 9, size=13.5, fill=svg.MUTED)
    hues, parts = iter(colours), by_part(items)
    for number, own in enumerate(parts):
        x, line = left + 70, y - 8 + number * _LINE
        for item, colour in [(item, next(hues)) for item in own]:
            only = len(own) == 1
            words = _half_widths(item) if only else f"{100 * item.weight:.0f} %"
            name = svg.shorten(item.object, 13.5, 110, bold=True)
            width = svg.text_width(name, 13.5, bold=True) + 6
            if not only and x + width + 90 > left + _PANEL:
                row += svg.text(f"of {len(own)}", x, line, size=13, fill=svg.MUTED)
                break
            row += svg.text(name, x, line, size=13.5, fill=colour, weight="bold")
            row += svg.text(words, x + width, line, size=13, fill=svg.MUTED)
            x += width + svg.text_width(words, 13) + 12
    return row, y + _LINE * max(len(parts) - 2, 0)


def _half_widths(item: LoggedHypothesis) -> str:
    bounds = item.bounds
    x, y = (at_most((hi - lo) / 2) for lo, hi in (bounds.x_mm, bounds.y_mm))
    turn = at_most(math.degrees(bounds.theta_rad[1] - bounds.theta_rad[0]) / 2)
    return f"± {x}, ± {y} mm" + (f", ± {turn}°" if item.symmetry_order else "")


def _answer(out: IdentificationOut, left: float, y: float) -> tuple[str, float]:
    """Verdict and place, or those of each part and what else may lie there; the y at which they end."""
    first, *more = svg.wrap(headline(out), 19, _PANEL, most_lines=2, bold=True)
    shown = svg.text(first, left, y, size=19, fill=svg.FOUND, weight="bold")
    for line in more:
        y += 24
        shown += svg.text(line, left, y, size=19, fill=svg.FOUND, weight="bold")
    if out.table is None:
        place, y = _place(out, left, y)
        return shown + place, y
    for number, part in enumerate(out.parts, start=1):
        one = part_answer(out, part)
        words = svg.shorten(f"part {number}, {headline(one).lower()}", 14, _PANEL, bold=True)
        place, end = _place(one, left, y + 30)
        shown += svg.text(words, left, y + 30, size=14, weight="bold") + place
        y = end
    y += 12
    for line in svg.wrap(rest_words(out.table), 13, _PANEL, most_lines=3):
        y += 18
        shown += svg.text(line, left, y, size=13, fill=svg.MUTED)
    return shown, y


def _place(out: IdentificationOut, left: float, y: float) -> tuple[str, float]:
    """Configuration with bounds, and the truth of an emulated table; the y at which they end."""
    if out.configuration is None or out.bounds is None or out.object is None:
        return "", y
    rows = [("x", out.configuration.x, out.bounds.x, " mm"), ("y", out.configuration.y, out.bounds.y, " mm")]
    turn = math.degrees(out.configuration.theta)
    lo, hi = (math.degrees(value) for value in out.bounds.theta)
    rows += [("θ", turn, (lo, hi), "°")] if out.symmetry_order else []
    shown = ""
    for name, value, (low, high), unit in rows:
        y += 23
        shown += svg.text(name, left, y, size=15, fill=svg.MUTED)
        shown += svg.text(f"{decimal(value)}{unit}", left + 112, y, size=15, anchor="end")
        shown += svg.text(f"in [{at_least(low)}, {at_most(high)}]", left + 128, y, size=15, fill=svg.MUTED)
    if out.truth is not None and out.truth.position_error_mm is not None:
        where = "inside" if out.truth.inside_bounds else "OUTSIDE"
        words = f"the truth is {out.truth.position_error_mm:.2f} mm away, {where} the bounds"
        y += 26
        shown += svg.text(words, left, y, size=13, fill=svg.MUTED)
    return shown, y
