"""Is the truth ever lost? Many seeded grips, simulated by shapely: run with `python benchmarks/campaign.py`.

Objects, errors and approaches are drawn by tests/support/campaign_trials.py. A grip depends on the seed and
its index only. One that is lost is printed with what repeats it, `--only INDEX`. The tables count grips,
those whose true configuration is in no cell, and those where it is outside of all bounds; and say what the
answers were like. Ends with status 1 if anything was lost.
"""

import argparse
import multiprocessing
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from campaign_checks import Outcome, asked, outcome
from campaign_objects import FAMILIES
from campaign_trials import NORMALS_DEG, Setting, drawn
from shared_files import SHARED_OUTLINES

_CHUNK = 50


@dataclass(frozen=True)
class Job:
    """Some trials of a campaign; handed to another process."""

    seed: int
    families: tuple[str, ...]
    first: int
    after: int


@dataclass(frozen=True)
class Row:
    """What came of one trial. `failure`: the exception, if the recogniser raised one."""

    index: int
    setting: Setting
    object_name: str
    outcome: Outcome | None
    milliseconds: float
    failure: str

    @property
    def kept(self) -> bool:
        """Whether the truth was in the bounds and in the cells."""
        return self.outcome is not None and self.outcome.in_bounds and self.outcome.in_cells


def tried(seed: int, index: int, families: tuple[str, ...]) -> Row:
    """Draw one trial, ask, and compare."""
    trial = drawn(seed, index, families)
    begin = time.perf_counter()
    found, failure = None, ""
    try:
        answers = asked(trial)
    except Exception as error:  # a campaign goes on, and counts it as lost
        failure = repr(error)
    spent = 1e3 * (time.perf_counter() - begin)
    if not failure:
        found = outcome(trial, answers)
    return Row(index, trial.setting, trial.placed.model.name, found, spent, failure)


def work(job: Job) -> list[Row]:
    """All trials of a job; a warning counts as a failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return [tried(job.seed, index, job.families) for index in range(job.first, job.after)]


def campaign(jobs: Sequence[Job], processes: int) -> Iterator[Row]:
    """Rows as they come, with progress on stderr; whatever is lost is reported at once."""
    whole = sum(job.after - job.first for job in jobs)
    begin, done, lost = time.perf_counter(), 0, 0
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for rows in pool.imap_unordered(work, jobs):
            for row in rows:
                if not row.kept:
                    lost += 1
                    print(f"\nLOST --only {row.index}: {row}", file=sys.stderr, flush=True)
                yield row
            done += len(rows)
            pace = done / (time.perf_counter() - begin)
            left = (whole - done) / pace / 60
            print(
                f"\r{done}/{whole} grips, {lost} lost, {pace:.0f}/s, {left:.0f} min left ",
                end="",
                file=sys.stderr,
                flush=True,
            )
    print(file=sys.stderr)


def print_table(title: str, rows: Sequence[Row], key: Callable[[Setting], tuple[str, ...]]) -> None:
    """One line for each value of `key`."""
    groups: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in rows:
        groups[key(row.setting)].append(row)
    print(f"\n{title:<34}  grips  lost  outside bounds  hypotheses  verified  median")
    for name in sorted(groups):
        group = groups[name]
        answered = [row.outcome for row in group if row.outcome is not None]
        hypotheses = sum(item.hypotheses for item in answered)
        verified = sum(item.verified for item in answered) / max(hypotheses, 1)
        print(
            f"{'  '.join(name):<34}  {len(group):>5}  "
            f"{sum(item.outcome is None or not item.outcome.in_cells for item in group):>4}  "
            f"{sum(item.outcome is None or not item.outcome.in_bounds for item in group):>14}  "
            f"{np.median([item.hypotheses for item in answered] or [0]):>10.0f}  {verified:>8.1%}  "
            f"{np.median([row.milliseconds for row in group]):>3.0f} ms"
        )


def normals_of(setting: Setting) -> str:
    """The normal range, in a form that sorts."""
    if setting.normals_deg is None:
        return "unknown"
    return f"±{setting.normals_deg:2.0f}°"


def main() -> None:
    """Run the campaign, or one grip of it, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=100_000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=705)
    parser.add_argument("--only", type=int, metavar="INDEX", help="repeat one grip, in full")
    parser.add_argument("--first", type=int, default=0, metavar="INDEX", help="index of the first grip")
    options = parser.parse_args()
    # Which families there are is part of what a grip depends on: without the shared outlines it is another.
    families = tuple(name for name in FAMILIES if name != "parts" or SHARED_OUTLINES.exists())
    if families != FAMILIES:
        print("parts: skipped, their file is not beside the repository")
    if options.only is not None:
        trial = drawn(options.seed, options.only, families)
        print(trial.placed, *(contact for step in trial.steps for contact in step), sep="\n")
        print(tried(options.seed, options.only, families))
        return
    after = options.first + options.grips
    jobs = [
        Job(options.seed, families, first, min(first + _CHUNK, after))
        for first in range(options.first, after, _CHUNK)
    ]
    rows = list(campaign(jobs, options.processes))
    print_table(
        "catalogue  normals  bound",
        rows,
        lambda s: (f"{s.family:<9}", f"{normals_of(s):<7}", f"{s.bound_mm:g} mm"),
    )
    print_table("tip radius", rows, lambda s: (f"{s.radius_mm:g} mm",))
    print_table("contacts", rows, lambda s: (f"{s.touches}",))
    print_table(
        "errors, grips",
        rows,
        lambda s: ("at bounds" if s.at_bound else "within   ", "extended" if s.extended else "at once"),
    )
    print_table("catalogue", rows, lambda s: (s.family,))
    lost = sorted(row.index for row in rows if not row.kept)
    verdict = "none lost" if not lost else f"{len(lost)} lost: {lost}"
    print(f"\n{len(rows)} grips, seed {options.seed}, {len(NORMALS_DEG)} kinds of normal range: {verdict}")
    sys.exit(bool(lost))


if __name__ == "__main__":
    main()
