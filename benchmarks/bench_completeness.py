"""Is the truth ever lost? Many seeded grips, simulated by shapely: `python benchmarks/bench_completeness.py`.

Objects, errors and approaches are drawn by tests/support/campaign/trials.py. A grip depends on its seed only.
One that is lost is printed with the seed that repeats it, `--seed N`. With `--out FILE` every grip is kept as
a line of JSON, and a campaign that was stopped goes on where it was. The tables count grips; those whose
truth is lost: no hypothesis of the object has the true configuration, or one that looks the same, within its
bounds; those where it is outside of all cells; and those refused because the contacts say too little for an
answer, or for one within 30 s. They say what the answers were like, too. Ends with status 1 if anything was
lost.
"""

import argparse
import json
import multiprocessing
import signal
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.errors import InputError
from palpate.base.vocabulary import DEFAULT_BUDGET
from support.campaign.objects import FAMILIES
from support.campaign.trials import Outcome, Setting, Trial, asked, drawn, outcome
from support.commands.repository import SHARED_OUTLINE_SETS

_CHUNK = 25
_LIMIT_S = 30.0
_SLOW_MS = 3000.0
_REFUSAL = "say too little"


@dataclass(frozen=True)
class Row:
    """What came of one trial. `failure`: the exception, if the recogniser raised one."""

    seed: int
    setting: Setting
    outcome: Outcome | None
    milliseconds: float
    failure: str

    @property
    def refused(self) -> bool:
        """Whether the contacts say too little for an answer, or for one in time."""
        return self.outcome is None and _REFUSAL in self.failure

    @property
    def lost(self) -> bool:
        """Whether the truth was in no bounds."""
        return not self.refused and not (self.outcome is not None and self.outcome.in_bounds)

    @property
    def outside(self) -> bool:
        """Whether the truth was in no cell."""
        return not self.refused and not (self.outcome is not None and self.outcome.in_cells)

    def to_line(self) -> str:
        """As one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_line(cls, line: str) -> "Row":
        """From what `to_line` made."""
        given = json.loads(line)
        setting = Setting(**given.pop("setting"))
        found = given.pop("outcome")
        return cls(setting=setting, outcome=None if found is None else Outcome(**found), **given)


def tried(seed: int, families: tuple[str, ...]) -> Row:
    """Draw one trial, ask, and compare."""
    trial = drawn(seed, families)
    begin = time.process_time()
    found, failure = None, ""
    signal.signal(signal.SIGALRM, _give_up)
    signal.setitimer(signal.ITIMER_REAL, _LIMIT_S)
    try:
        answers = asked(trial)
    except InputError as error:
        failure = str(error)
    except Exception as error:  # a campaign goes on, and counts it as lost
        failure = repr(error)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    spent = 1e3 * (time.process_time() - begin)
    if not failure:
        found = outcome(trial, answers)
    return Row(seed, trial.setting, found, spent, failure)


def _give_up(*_: object) -> None:
    raise InputError(f"the contacts {_REFUSAL} for an answer in {_LIMIT_S:g} s")


def work(job: tuple[Sequence[int], tuple[str, ...]]) -> list[Row]:
    """All trials of a job, seeds and families; a warning counts as a failure."""
    seeds, families = job
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return [tried(seed, families) for seed in seeds]


def campaign(seeds: Sequence[int], families: tuple[str, ...], processes: int) -> Iterator[Row]:
    """Rows as they come, with progress on stderr; whatever is lost is reported at once."""
    jobs = [(seeds[begin : begin + _CHUNK], families) for begin in range(0, len(seeds), _CHUNK)]
    begin, done, lost = time.perf_counter(), 0, 0
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for rows in pool.imap_unordered(work, jobs):
            for row in rows:
                if row.lost or row.outside:
                    lost += 1
                    print(f"\nLOST --seed {row.seed}: {row}", file=sys.stderr, flush=True)
                yield row
            done += len(rows)
            pace = done / (time.perf_counter() - begin)
            left = (len(seeds) - done) / pace / 60
            print(
                f"\r{done}/{len(seeds)} grips, {lost} lost, {pace:.0f}/s, {left:.0f} min left ",
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
    print(f"\n{title:<34}  grips  lost  outside  refused  hypotheses  verified  median  slowest")
    for name in sorted(groups):
        group = groups[name]
        answered = [row.outcome for row in group if row.outcome is not None]
        hypotheses = sum(item.hypotheses for item in answered)
        verified = sum(item.verified for item in answered) / max(hypotheses, 1)
        print(
            f"{'  '.join(name):<34}  {len(group):>5}  {sum(row.lost for row in group):>4}  "
            f"{sum(row.outside for row in group):>7}  {sum(row.refused for row in group):>7}  "
            f"{np.median([item.hypotheses for item in answered] or [0]):>10.0f}  {verified:>8.1%}  "
            f"{np.median([row.milliseconds for row in group]):>3.0f} ms  "
            f"{max(row.milliseconds for row in group) / 1e3:>5.1f} s"
        )


def normals_of(setting: Setting) -> str:
    """The normal range, in a form that sorts."""
    if setting.normals_deg is None:
        return "unknown"
    return f"±{setting.normals_deg:g}°".rjust(8)


def tip_of(setting: Setting) -> str:
    """The tip's radius, by class."""
    return "point" if setting.radius_mm == 0 else f"up to {2 * np.ceil(setting.radius_mm / 2):.0f} mm"


def print_tables(rows: Sequence[Row]) -> None:
    """Everything by kind of object, by kind of error, and by kind of grip."""
    print_table("kind of object", rows, lambda s: (s.kind,))
    print_table("normals", rows, lambda s: (normals_of(s),))
    print_table("bound, path beyond it", rows, lambda s: (f"{s.bound_mm:g} mm", f"{s.further_mm:g} mm"))
    print_table("tolerance", rows, lambda s: (f"{s.tolerance_mm:g} mm",))
    print_table("tip radius", rows, lambda s: (tip_of(s),))
    print_table("budget", rows, lambda s: (f"{'full' if s.budget == DEFAULT_BUDGET else 'small'}",))
    print_table("touches", rows, lambda s: (f"{s.touches}",))
    print_table(
        "errors, grips",
        rows,
        lambda s: ("at bounds" if s.at_bound else "within   ", "extended" if s.extended else "at once"),
    )


def show(trial: Trial) -> None:
    """One grip in full: the object and its contacts."""
    print(trial.setting)
    for model in (trial.model, trial.placed.model):
        for section in model.states[0].sections:
            print(section.z_mm, [ring.tolist() for ring in section.rings])
    print(trial.placed.x, trial.placed.y, trial.placed.theta)
    print(*(contact for step in trial.steps for contact in step), sep="\n")


def kept_rows(out: Path | None) -> list[Row]:
    """What an earlier campaign has left; a last line that is cut short is left out."""
    if out is None or not out.exists():
        return []
    return [Row.from_line(line) for line in out.read_text().split("\n") if line.endswith("}")]


def main() -> None:
    """Run the campaign, or one grip of it, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=5_000)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="seed of the first grip")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, metavar="N", help="repeat one grip, in full")
    parser.add_argument("--out", type=Path, metavar="FILE", help="keep every grip here, and go on from there")
    options = parser.parse_args()
    # Which families there are is part of what a grip depends on: without the shared outlines it is another.
    families = tuple(name for name in FAMILIES if name != "parts" or SHARED_OUTLINE_SETS)
    if families != FAMILIES:
        print("parts: skipped, their files are not beside the repository")
    if options.seed is not None:
        show(drawn(options.seed, families))
        print(tried(options.seed, families))
        return
    wanted = range(options.first, options.first + options.grips)
    rows = [row for row in kept_rows(options.out) if row.seed in wanted]
    done = {row.seed for row in rows}
    for row in campaign([seed for seed in wanted if seed not in done], families, options.processes):
        rows.append(row)
        if options.out is not None:
            with options.out.open("a") as file:
                print("\n" + row.to_line(), file=file)
    print_tables(rows)
    lost = sorted(row.seed for row in rows if row.lost or row.outside)
    slow = [row.seed for row in rows if row.milliseconds > _SLOW_MS]
    print(f"\n{len(slow)} of {len(rows)} took over {_SLOW_MS / 1e3:g} s of processor time: {slow[:20]}")
    print(f"\n{len(rows)} grips: {'none lost' if not lost else f'{len(lost)} lost: {lost}'}")
    sys.exit(bool(lost))


if __name__ == "__main__":
    main()
