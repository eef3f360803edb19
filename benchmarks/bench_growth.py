"""How the cost of a recognition grows: run with `python benchmarks/bench_growth.py`.

One quantity is varied at a time: edges of an outline, outlines, contacts, position bound, width of the normal
range, tolerance, contacts that may be spurious. Touches are simulated by shapely with errors inside their
bounds; the rest is as in `BASE`. Every row is a process of its own: processor time of one `recognise` in the
median of several grips, hypotheses in the median, processor time of preparing the catalogue, most memory.
Exponents b of time ~ n^b are least squares of the logarithms, over all rows and over the upper half of them.

`--write` puts the tables into docs/performance.md.
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
    """A table: the varied quantity, and which law is fitted to it (`power`: n^b; else a factor a step)."""

    title: str
    column: str
    settings: tuple[tuple[float, str, Setting], ...]
    power: bool = True


def along(
    title: str, column: str, values: Sequence[float], setting: Callable[[float], Setting], power: bool = True
) -> Growth:
    """A table with one row for each value."""
    return Growth(title, column, tuple((value, f"{value:,g}", setting(value)) for value in values), power)


GROWTHS = (
    along(
        "Edges of an outline: ten smooth outlines",
        "edges",
        (10, 20, 50, 100, 200, 500, 1000, 2000, 5000),
        lambda n: Setting(SMOOTH, 10, int(n)),
    ),
    along(
        "Outlines in the catalogue: drawn ones of 20 edges",
        "outlines",
        (1, 10, 100, 300, 1000, 5000, 20_000),
        lambda n: Setting(DRAWN, int(n)),
    ),
    along("Contacts", "contacts", (1, 2, 3, 4, 6, 8, 10, 12), lambda n: replace(BASE, contacts=int(n))),
    along(
        "Position bound ε",
        "ε (mm)",
        (0.01, 0.03, 0.1, 0.3, 1.0, 3.0),
        lambda bound: replace(BASE, bound_mm=bound),
    ),
    along(
        "Range of normals (± 90° is that of contacts without measured normals)",
        "± (°)",
        (1.0, 3.0, 10.0, 20.0, 45.0, 90.0),
        lambda half: replace(BASE, half_range_deg=None if half == 90 else half),
    ),
    along(
        "Tolerance of the outlines: 30 drawn ones of 20 edges",
        "tolerance (mm)",
        (0.01, 0.03, 0.1, 0.3),
        lambda tolerance: Setting(DRAWN, 30, tolerance_mm=tolerance),
    ),
    along(
        "Contacts that may be spurious, of six",
        "spurious",
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
    """The sentence below a table."""
    if len(rows) < 3:
        return ""
    if not growth.power:
        steps = np.polyfit([row.at for row in rows], np.log([row.seconds for row in rows]), 1)
        return f"Each further one takes {math.exp(steps[0]):.1f} times as long."
    upper = rows[len(rows) // 2 - 1 :]
    return (
        f"Fitted exponent of the time: {exponent(rows):.2f} over all rows, "
        f"{exponent(upper):.2f} from {upper[0].at:,g} on."
    )


def table(growth: Growth, grips: int, patience_s: float) -> str:
    """One table, with the law that was fitted to it."""
    rows, cells = [], []
    start = multiprocessing.get_context("spawn")
    for at, shown, setting in growth.settings:
        with start.Pool(1) as pool:
            found = pool.apply(measured, (at, setting, grips, patience_s))
        print(f"  {shown}: {found}", file=sys.stderr, flush=True)
        rows.append(found)
        cells.append(
            [
                shown,
                milliseconds(found.seconds),
                milliseconds(found.longest_s),
                f"{found.hypotheses:g}",
                milliseconds(found.prepared_s),
                f"{found.memory_mb:,.0f} MB",
            ]
        )
    head = (growth.column, "median", "longest", "hypotheses", "preparation", "memory")
    return f"**{growth.title}**\n\n{markdown_table(head, cells)}\n\n{fitted(growth, rows)}"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=9, help="grips per row")
    parser.add_argument("--seconds", type=float, default=15.0, help="of recognition per row, about")
    parser.add_argument("--only", default="", help="tables whose titles begin so")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/performance.md")
    given = parser.parse_args()
    texts = [
        table(growth, given.grips, given.seconds)
        for growth in GROWTHS
        if growth.title.lower().startswith(given.only.lower())
    ]
    versions = {name: metadata.version(name) for name in ("palpate", "numpy", "scipy", "shapely")}
    whole = "\n\n".join([versions_line(versions), *texts])
    print(whole)
    if given.write:
        update("growth", whole)


if __name__ == "__main__":
    main()
