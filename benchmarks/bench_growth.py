"""How the cost of a recognition grows: run with `python benchmarks/bench_growth.py`.

One quantity is varied at a time: edges of an outline, outlines, contacts, position bound, width of the normal
range, tolerance, contacts that may be spurious. Touches are simulated by shapely with errors inside their
bounds; the rest is as in `BASE`. Every row is a process of its own: processor time of one `recognise` in the
median of several grips, hypotheses in the median, processor time of preparing the catalogue, most memory.
Exponents b of time ~ n^b are least squares of the logarithms, over the upper half of the rows.

All rows are printed as they are measured; `--write` puts three of each quantity into docs/performance.md.
"""

import argparse
import math
import multiprocessing
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import metadata

import numpy as np
from bench_tolerance import fine
from peer_questions import drawn_models
from performance_page import markdown_table, milliseconds, update, versions_line

from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, recognise
from support.oracles.shapely_touches import SHIPPED_OBJECTS, grip, outlines, place

__all__ = ["Row", "Setting", "exponent", "measured"]

SHIPPED, DRAWN, SMOOTH = "shipped", "drawn", "smooth"


@dataclass(frozen=True)
class Setting:
    """What a row's grips are of: `kind` of outlines, how many, of how many edges, and how touched."""

    kind: str = SHIPPED
    outlines: int = 6
    edges: int = 20
    contacts: int = 3
    bound_mm: float = 0.3
    half_range_deg: float | None = 10.0
    tolerance_mm: float = 0.0
    spurious: int = 0

    def models(self) -> list[ObjectModel]:
        if self.kind == SHIPPED:
            found = outlines(SHIPPED_OBJECTS)
        elif self.kind == SMOOTH:
            found = fine(self.outlines, self.edges)
        else:
            found = drawn_models(self.outlines, self.edges)
        return [replace(model, tolerance_mm=self.tolerance_mm) for model in found]


@dataclass(frozen=True)
class Row:
    """What was measured of a setting. `at`: the varied quantity."""

    at: float
    seconds: float
    longest_s: float
    hypotheses: float
    prepared_s: float
    memory_mb: float


BASE = Setting()


@dataclass(frozen=True)
class Growth:
    """A quantity that is varied, and which law is fitted to it (`power`: n^b; else a factor a step)."""

    title: str
    settings: tuple[tuple[float, str, Setting], ...]
    power: bool = True


def along(
    title: str, values: Sequence[float], setting: Callable[[float], Setting], power: bool = True
) -> Growth:
    """The growth along these values."""
    return Growth(title, tuple((value, f"{value:,g}", setting(value)) for value in values), power)


GROWTHS = (
    along(
        "edges of an outline, of ten smooth ones",
        (10, 20, 50, 100, 200, 500, 1000, 2000, 5000),
        lambda n: Setting(SMOOTH, 10, int(n)),
    ),
    along(
        "drawn outlines of 20 edges",
        (1, 10, 100, 300, 1000, 5000, 20_000),
        lambda n: Setting(DRAWN, int(n)),
    ),
    along("contacts", (1, 2, 3, 4, 6, 8, 10, 12), lambda n: replace(BASE, contacts=int(n))),
    along(
        "position bound, mm",
        (0.01, 0.03, 0.1, 0.3, 1.0, 3.0),
        lambda bound: replace(BASE, bound_mm=bound),
    ),
    along(
        "half range of normals, ° (90: none is measured)",
        (1.0, 3.0, 10.0, 20.0, 45.0, 90.0),
        lambda half: replace(BASE, half_range_deg=None if half == 90 else half),
    ),
    along(
        "tolerance, mm, of 30 drawn outlines",
        (0.01, 0.03, 0.1, 0.3),
        lambda tolerance: Setting(DRAWN, 30, tolerance_mm=tolerance),
    ),
    along(
        "contacts that may be spurious, of six",
        (0, 1, 2),
        lambda count: replace(BASE, contacts=6, spurious=int(count)),
        power=False,
    ),
)


def measured(at: float, setting: Setting, grips: int, patience_s: float) -> Row:
    """Processor time of `recognise` for some grips; no new one is begun once `patience_s` are over."""
    models = setting.models()
    rng = np.random.default_rng(setting.contacts)
    half = None if setting.half_range_deg is None else math.radians(setting.half_range_deg)
    scenes = []
    while len(scenes) < grips:
        placed = place(models[int(rng.integers(len(models)))], rng)
        contacts = grip(placed, rng, fingers=setting.contacts, bound=setting.bound_mm, half_range=half)
        if all(contact.touched for contact in contacts):
            scenes.append(contacts)
    begin = time.process_time()
    catalogue = Catalogue(models)
    _ = recognise(catalogue, scenes[0], setting.spurious).hypotheses
    first = time.process_time() - begin
    seconds, left = [], []
    for contacts in scenes:
        if seconds and time.process_time() - begin - first > patience_s:
            break
        before = time.process_time()
        found = recognise(catalogue, contacts, setting.spurious)
        left.append(len(found.hypotheses))
        seconds.append(time.process_time() - before)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    prepared = max(0.0, first - seconds[0])
    return Row(at, statistics.median(seconds), max(seconds), statistics.median(left), prepared, memory)


def exponent(rows: Sequence[Row]) -> float:
    """b of the least squares of log(seconds) = a + b log(at)."""
    at, seconds = np.log([(row.at, row.seconds) for row in rows]).T
    return float(np.polyfit(at, seconds, 1)[0])


def fitted(growth: Growth, rows: Sequence[Row]) -> str:
    """The law, of the upper half of the rows."""
    if not growth.power:
        steps = np.polyfit([row.at for row in rows], np.log([row.seconds for row in rows]), 1)
        return f"{math.exp(steps[0]):.1f} times for each"
    upper = rows[len(rows) // 2 - 1 :]
    return f"{exponent(upper):.2f} from {upper[0].at:,g} on"


HEAD = ("varied", "", "median", "longest", "preparation", "memory", "exponent")


def lines(growth: Growth, grips: int, patience_s: float) -> list[list[str]]:
    """Lines of a table: the least value, the middle one and the largest; the law is fitted to all."""
    rows, cells = [], []
    start = multiprocessing.get_context("spawn")
    for at, shown, setting in growth.settings:
        with start.Pool(1) as pool:
            found = pool.apply(measured, (at, setting, grips, patience_s))
        print(f"  {shown}: {found}", file=sys.stderr, flush=True)
        rows.append(found)
        times = [milliseconds(each) for each in (found.seconds, found.longest_s, found.prepared_s)]
        cells.append(["", shown, *times, f"{found.memory_mb:,.0f} MB", ""])
    cells[0][0], cells[0][-1] = growth.title, fitted(growth, rows)
    return [cells[0], cells[len(cells) // 2], cells[-1]]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=9, help="grips per row")
    parser.add_argument("--seconds", type=float, default=15.0, help="of recognition per row, about")
    parser.add_argument("--only", default="", help="quantities whose titles begin so")
    parser.add_argument("--write", action="store_true", help="put the table into docs/performance.md")
    given = parser.parse_args()
    rows = [
        line
        for growth in GROWTHS
        if growth.title.startswith(given.only)
        for line in lines(growth, given.grips, given.seconds)
    ]
    versions = {name: metadata.version(name) for name in ("palpate", "numpy", "scipy", "shapely")}
    whole = f"{versions_line(versions)}\n\n{markdown_table(HEAD, rows)}"
    print(whole)
    if given.write:
        update("growth", whole)


if __name__ == "__main__":
    main()
