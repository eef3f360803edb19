"""Moving picture of a recorded run, as in the README: `python docs/images/draw_run.py SESSION run.svg`.

Fingers move as the session's log says. Where pictures do not move, the end of
the run is shown. `--at SECONDS` writes the picture as it stands at that time of the film, to look at.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from palpate.views.live.frames import SessionFeed
from palpate.views.svg import element, number, text

FILM_S, HOLD_S = 12.0, 4.0  # the run, and how long its end stands still
TABLE_PX, PANEL_PX = 400.0, 330.0
MOVED_MM = 0.25  # a finger's track is thinned by as much
BLUE, ORANGE, INK, GREY = "#0b6e99", "#d9480f", "#1f2933", "#7b8794"

Frame = dict[str, Any]
Point = tuple[float, float]
Place = tuple[float, Point]


class Film:
    """Frames of a session, written as tracks over time, or as they are at one time."""

    def __init__(self, folder: Path, at_s: float | None) -> None:
        feed = SessionFeed(folder)
        feed.update()
        self.setting: Any = feed.setting
        self.frames: list[Frame] = [json.loads(line) for line in feed.store.texts]
        self._end_s = float(self.frames[-1]["t"])
        self._at_s = at_s

    def share(self, t_s: float) -> float:
        """Share of the film at which an instant of the run is shown."""
        return t_s / self._end_s * FILM_S / (FILM_S + HOLD_S)

    def moving(self, tag: str, track: Sequence[Place], names: tuple[str, str], **style: Any) -> str:
        """Return an element whose two attributes `names` follow a track of (s, place)."""
        if self._at_s is not None:
            now = min(track, key=lambda item: abs(item[0] - self._run_time()))
            return element(tag, **dict(zip(names, now[1], strict=True)), **style)
        times = [0.0, *(self.share(t) for t, _ in track[1:]), 1.0]
        places = [*(place for _, place in track), track[-1][1]]
        tracks = [
            self._animate(name, [number(place[k]) for place in places], times, "linear")
            for k, name in enumerate(names)
        ]
        return element(tag, *tracks, **dict(zip(names, places[-1], strict=True)), **style)

    def shown(self, content: str, from_s: float, until_s: float | None = None) -> str:
        """Return content that is seen from an instant of the run on, or until another."""
        if self._at_s is not None:
            seen = from_s <= self._run_time() and (until_s is None or self._run_time() < until_s)
            return content if seen else ""
        times, values = [0.0, self.share(from_s)], ["0", "1"]
        if until_s is not None:
            times, values = [*times, self.share(until_s)], [*values, "0"]
        return element("g", self._animate("opacity", values, times, "discrete"), content, opacity=values[-1])

    def _run_time(self) -> float:
        assert self._at_s is not None
        return min(self._at_s / FILM_S, 1.0) * self._end_s

    @staticmethod
    def _animate(name: str, values: Sequence[str], times: Sequence[float], mode: str) -> str:
        return element(
            "animate",
            attributeName=name,
            values=";".join(values),
            keyTimes=";".join(f"{time:.4f}".rstrip("0").rstrip(".") for time in times),
            calcMode=mode,
            dur=f"{FILM_S + HOLD_S:g}s",
            repeatCount="indefinite",
        )


def thin(track: list[Place]) -> list[Place]:
    """Leave out what an even motion between kept places explains (Douglas and Peucker, in time)."""
    if len(track) < 3:
        return track
    (t0, a), (t1, b) = track[0], track[-1]
    span = max(t1 - t0, 1e-9)

    def off(item: Place) -> float:
        share = (item[0] - t0) / span
        return math.dist(item[1], [p + share * (q - p) for p, q in zip(a, b, strict=True)])

    k = max(range(1, len(track) - 1), key=lambda index: off(track[index]))
    if off(track[k]) <= MOVED_MM:
        return [track[0], track[-1]]
    return [*thin(track[: k + 1])[:-1], *thin(track[k:])]


def rings(film: Film, item: Frame, page: Callable[[Sequence[float]], Point]) -> str:
    """Path of a hypothesis's outline on the table."""
    c, s = math.cos(item["theta"]), math.sin(item["theta"])
    parts = []
    for ring in film.setting["outlines"][f"{item['object']}/{item['state']}"]:
        places = [page((c * x - s * y + item["x"], s * x + c * y + item["y"])) for x, y in ring]
        parts.append("M" + "L".join(f"{number(x)} {number(y)}" for x, y in places) + "Z")
    return "".join(parts)


def sector(page: Callable[[Sequence[float]], Point], centre: Point, lo: float, hi: float) -> str:
    """Path of a range of normals at a contact, of one less than half a turn wide."""
    arm = [page((centre[0] + 15 * math.cos(angle), centre[1] + 15 * math.sin(angle))) for angle in (lo, hi)]
    points = " L".join(f"{number(x)} {number(y)}" for x, y in (page(centre), *arm))
    return f"M{points}Z"


def draw_table(film: Film) -> Iterator[str]:
    """The table from above: workspace, hypotheses, contacts, fingers."""
    reach = 1.12 * film.setting["workspace"]
    scale = TABLE_PX / (2 * reach)

    def page(place: Sequence[float]) -> Point:
        return (reach + place[0]) * scale, (reach - place[1]) * scale

    middle = page((0, 0))
    yield element(
        "circle",
        cx=middle[0],
        cy=middle[1],
        r=film.setting["workspace"] * scale,
        fill="#f5f7fa",
        stroke="#cbd2d9",
        stroke_dasharray="4 4",
    )
    for from_s, until_s, frame in changes(film.frames, "hypotheses"):
        for item in frame["hypotheses"]:
            outline = element(
                "path", d=rings(film, item, page), fill=BLUE, fill_opacity=0.14, stroke=BLUE, stroke_width=2.0
            )
            yield film.shown(outline, from_s, until_s)
    drawn = 0
    for from_s, _, frame in changes(film.frames, "contacts"):
        for item in frame["contacts"][drawn:]:
            centre = item["end"]
            x, y = page(centre)
            dot = element("circle", cx=x, cy=y, r=item["radius"] * scale, fill=ORANGE, fill_opacity=0.35)
            wedge = "" if item["normal"] is None else sector(page, centre, *item["normal"])
            normal = element("path", d=wedge, fill=ORANGE, fill_opacity=0.3) if wedge else ""
            yield film.shown(dot + normal, from_s)
        drawn = len(frame["contacts"])
    for finger in film.setting["fingers"]:
        track = [
            (f["t"], tuple(f["tips"][finger["name"]])) for f in film.frames if finger["name"] in f["tips"]
        ]
        way = [(t, page(place)) for t, place in thin(track)]
        base = page(finger["base"])
        yield film.moving(
            "line",
            way,
            ("x2", "y2"),
            x1=base[0],
            y1=base[1],
            stroke=GREY,
            stroke_width=5.0,
            stroke_linecap="round",
            stroke_opacity=0.55,
        )
        yield film.moving("circle", way, ("cx", "cy"), r=finger["radius"] * scale, fill=INK)
        name = page([0.62 * value for value in finger["base"]])
        yield text(finger["name"], name[0] + 12, name[1] + 4, size=13, fill=GREY)


def changes(frames: Sequence[Frame], key: str) -> Iterator[tuple[float, float | None, Frame]]:
    """Instants at which `frame[key]` changes: from when, until when, and a frame of that stretch."""
    found = [frames[k] for k in range(len(frames)) if k == 0 or frames[k][key] != frames[k - 1][key]]
    for now, after in zip(found, [*found[1:], None], strict=True):
        yield now["t"], None if after is None else after["t"], now


def draw_panel(film: Film) -> Iterator[str]:
    """What is known after each grip, a line each, and the answer."""
    yield text("one part, three fingers, nothing seen", 0, 28, size=14, fill=INK, weight="bold")
    y = 62.0
    yield text("grip", 0, y, size=12, fill=GREY)
    for column, (title, _, _) in enumerate(COLUMNS):
        yield text(title, 138 + 62 * column, y, size=12, fill=GREY)
    last = None
    for t, _, frame in changes(film.frames, "hypotheses"):
        if not frame["hypotheses"] or frame["verdict"] == "identified":
            continue
        y += 30
        found = frame["hypotheses"][0]
        names = {item["object"] for item in frame["hypotheses"]}
        row = text(f"{frame['grip']}", 0, y, size=14, fill=INK, weight="bold")
        row += text(", ".join(sorted(names)), 34, y, size=14, fill=INK)
        for column, (_, key, unit) in enumerate(COLUMNS):
            lo, hi = found["bounds"][key]
            row += text(half_width(lo, hi, unit), 138 + 62 * column, y, size=14, fill=INK)
        yield film.shown(row, t)
        last = frame
    assert last is not None
    end = film.frames[-1]
    answer, truth = end["hypotheses"][0], end["truth"]
    y += 48
    said = text(
        f"{end['verdict']}: {answer['object']}, {answer['state']}", 0, y, size=17, fill=BLUE, weight="bold"
    )
    for k, (name, item) in enumerate((("found", answer), ("truth", truth))):
        place = f"x {item['x']:.2f}, y {item['y']:.2f} mm, θ {math.degrees(item['theta']):.2f}°"
        said += text(name, 0, y + 28 + 24 * k, size=14, fill=GREY)
        said += text(place, 52, y + 28 + 24 * k, size=14, fill=INK)
    yield film.shown(said, end["t"])


COLUMNS = (("x, mm", "x_mm", ""), ("y, mm", "y_mm", ""), ("θ", "theta_rad", "°"))


def half_width(lo: float, hi: float, unit: str) -> str:
    """A bound either way, rounded up."""
    half = (hi - lo) / 2
    half = math.degrees(half) if unit else half
    return f"± {math.ceil(100 * half) / 100:.2f}{unit}"


def draw(film: Film) -> str:
    """The whole picture."""
    width, height = TABLE_PX + PANEL_PX, TABLE_PX
    title = element("title", "A recorded run of palpate: three fingers touch a part until it is identified")
    clip = element("clipPath", element("rect", width=TABLE_PX, height=height), id="table")
    table = element("g", *draw_table(film), clip_path="url(#table)")
    panel = element("g", *draw_panel(film), transform=f"translate({number(TABLE_PX + 8)} 24)")
    sheet = element("rect", width=width, height=height, rx=8.0, fill="#ffffff")
    return element(
        "svg",
        title,
        clip,
        sheet,
        table,
        panel,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {number(width)} {number(height)}",
        width=width,
        height=height,
        font_family="Helvetica, Arial, sans-serif",
    )


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("session", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--at", type=float, help="a still at this time of the film, s")
    asked = parser.parse_args()
    asked.out.write_text(draw(Film(asked.session, asked.at)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
