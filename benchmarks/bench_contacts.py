"""Do the bounds of contacts hold, and how narrow are they? Run with `python benchmarks/bench_contacts.py`.

20,000 emulated contacts on cylinders and 20,000 on flat pads, 100 to a session, whose tip, noise, gains,
crosstalk, dead taxels and drift are drawn by the session's seed
(tests/support/oracles/array_contacts.py); with
`--tip pressed` on cylinders with gains within ± 40 %, known to ± 3 % in the middle 150°. Prints
markdown tables: how many truths lay outside their bounds, and how wide the bounds were in units of the
array's own limit, half a pitch; for whole recordings by `process`, and for every tenth contact by `extract`.
Then frames per second, beside a plain loop that does no more than zero, gain and centroid. Exit code 1 if
more than one contact in a thousand lay outside, or the median half range of normals is above 2.
"""

import argparse
import math
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core is what is measured
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from bench_tactile import extraction_speeds

from palpate.drivers.tactile.patches import PatchFlag
from support.oracles.array_contacts import (
    QUANTITIES,
    Outcome,
    Session,
    cylinder_session,
    extracted,
    pad_session,
    pressed_session,
    processed,
)

PER_SESSION = 100
EXTRACT_EVERY = 10
SESSIONS: dict[str, Callable[[int, int], Session]] = {
    "cylinder": cylinder_session,
    "pad": pad_session,
    "pressed": pressed_session,
}
BY_DEFAULT = ("cylinder", "pad")
SHARE_OUTSIDE = 1e-3
MEDIAN_HALF = 2.0
SPREADS = (0.0, 0.1, 0.2, 0.3)


@dataclass(frozen=True)
class Job:
    """One session: its kind of tip and its seed."""

    tip: str
    seed: int


@dataclass(frozen=True)
class Result:
    """What came of one session."""

    tip: str
    whole: list[Outcome]
    single: list[Outcome]
    false: int
    quiet: int
    frames: int
    seconds: float


def run(job: Job) -> Result:
    """One session through `process`, and some of its contacts through `extract`."""
    session = SESSIONS[job.tip](job.seed, PER_SESSION)
    whole = processed(session, job.seed)
    single = extracted(session, job.seed, range(0, PER_SESSION, EXTRACT_EVERY))
    return Result(job.tip, whole.outcomes, single, whole.false, whole.quiet, whole.frames, whole.seconds)


def flagged(outcome: Outcome, flag: PatchFlag) -> bool:
    """Whether the contact was found and has the flag."""
    return outcome.patch is not None and flag in outcome.patch.flags


def groups(outcomes: Sequence[Outcome]) -> Iterable[tuple[str, list[Outcome]]]:
    """The rows of a table: kinds of contact, flags, gain spreads, all."""
    for kind in sorted({o.truth.kind for o in outcomes}):
        yield kind, [o for o in outcomes if o.truth.kind == kind]
    cut, dead = PatchFlag.TRUNCATED, PatchFlag.DEAD_NEIGHBOUR
    found = [o for o in outcomes if o.patch is not None]
    yield "clear", [o for o in found if not flagged(o, cut) and not flagged(o, dead)]
    yield "cut only", [o for o in found if flagged(o, cut) and not flagged(o, dead)]
    yield "dead only", [o for o in found if flagged(o, dead) and not flagged(o, cut)]
    yield "cut and dead", [o for o in found if flagged(o, cut) and flagged(o, dead)]
    for flag in (PatchFlag.SEVERAL_PATCHES, PatchFlag.WIDE, PatchFlag.SINGLE_TAXEL):
        yield flag.name.lower().replace("_", " "), [o for o in found if flagged(o, flag)]
    for low, high in pairwise(SPREADS):
        yield f"gains ± {low:.1f} … {high:.1f}", [o for o in outcomes if low <= o.gain_spread < high]
    yield "**all**", list(outcomes)


def halves(values: Sequence[float]) -> str:
    """Median and 90 %; some may be infinite."""
    if not values or math.isnan(values[0]):
        return "– | –"
    middle, wide = np.percentile(values, [50, 90], method="higher")
    return f"{middle:.2f} | {wide:.2f}"


def table(outcomes: Sequence[Outcome]) -> list[str]:
    """Markdown, a row a group."""
    lines = [
        "| | contacts | missed | any outside | normal | centroid | height | force (judged) | normal: median "
        "| 90 % | centroid: median | 90 % |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, rows in groups(outcomes):
        found = [o for o in rows if o.patch is not None]
        out = {q: sum(q in o.outside for o in found) for q in QUANTITIES}
        lines.append(
            f"| {name} | {len(rows)} | {len(rows) - len(found)} | {sum(bool(o.outside) for o in found)} "
            f"| {out['normal']} | {out['centroid']} | {out['height']} "
            f"| {out['force']} ({sum('force' in o.judged for o in found)}) "
            f"| {halves([o.normal_half for o in found])} | {halves([o.centroid_half for o in found])} |"
        )
    return lines


def described(outcome: Outcome) -> str:
    """A contact that lay outside, on one line."""
    t, p = outcome.truth, outcome.patch
    assert p is not None
    said = {
        "normal": (t.normals, p.angle_rad, p.angle_half_range_rad),
        "centroid": (t.centroids, p.position_mm[0], p.position_bound_mm[0]),
        "height": (t.height_mm, p.height_mm, p.height_bound_mm),
        "force": (t.force_n, p.force_n, p.force_bound_n),
    }
    if not math.isnan(p.centroid_rad):
        said["centroid"] = (t.centroids, p.centroid_rad, p.centroid_bound_rad)
    what = "; ".join(
        f"{q} {np.round(said[q][0], 3)} said {said[q][1]:.3f} ± {said[q][2]:.3f}" for q in outcome.outside
    )
    flags = " ".join(sorted(f.name for f in p.flags))
    which = f"seed {outcome.seed} contact {outcome.index} {t.kind}"
    return f"- {which} gains ± {outcome.gain_spread:.2f}: {what} {flags}"


def section(tip: str, results: Sequence[Result], *, listed: int) -> tuple[list[str], bool]:
    """The tables of one kind of tip, and whether its targets hold."""
    lines, good = [], True
    for name, outcomes in (
        ("`process`, whole sessions", [o for r in results for o in r.whole]),
        (f"`extract`, one contact in {EXTRACT_EVERY}", [o for r in results for o in r.single]),
    ):
        lines += ["", f"## {tip}: {name}", "", *table(outcomes)]
        wrong = [o for o in outcomes if {"normal", "centroid"} & o.outside.keys()]
        good &= len(wrong) <= SHARE_OUTSIDE * len(outcomes)
        if tip != "pad":
            good &= bool(np.median([o.normal_half for o in outcomes]) <= MEDIAN_HALF)
        bad = [o for o in outcomes if o.outside]
        missed = [o for o in outcomes if o.patch is None]
        lines += ["", *(described(o) for o in bad[:listed])]
        lines += [
            f"- seed {o.seed} contact {o.index}: {o.truth.force_n:.3f} N missed" for o in missed[:listed]
        ]
    frames, seconds = sum(r.frames for r in results), sum(r.seconds for r in results)
    false, quiet = sum(r.false for r in results), sum(r.quiet for r in results)
    lines += [
        "",
        f"False contacts: {false} in {quiet} untouched frames.",
        f"{frames} frames, {frames / seconds:.0f} a second, each session's templates included.",
    ]
    return lines, good


def main() -> int:
    """Print the tables; exit code 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=200, help="of each kind of tip, 100 contacts each")
    parser.add_argument("--first", type=int, default=0, help="seed of the first session")
    parser.add_argument("--tip", choices=sorted(SESSIONS), help="only this kind")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--list", type=int, default=20, help="so many contacts that lay outside or were missed"
    )
    options = parser.parse_args()
    tips = [options.tip] if options.tip else BY_DEFAULT
    seeds = range(options.first, options.first + options.sessions)
    good = True
    with ProcessPoolExecutor(options.jobs) as pool:
        results = list(pool.map(run, [Job(tip, seed) for tip in tips for seed in seeds], chunksize=4))
    for tip in tips:
        lines, holds = section(tip, [r for r in results if r.tip == tip], listed=options.list)
        print("\n".join(lines))
        good &= holds
    print("\n## Speed\n")
    print("| 8 rows | frames/s | times the plain loop's time |\n|---|---|---|")
    for row in extraction_speeds(repeats=3):
        print(f"| {row.name} | {row.frames_per_s:.0f} | {row.times_plain:.1f} |")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
