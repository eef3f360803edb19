"""Rig files drawn over the whole schema: each is refused in one line, or checked and run to an end.

    python benchmarks/bench_rig_files.py --files 2000 --jobs 2       # an hour and a half; virtual time

Half are drawn by `tests/support/campaign/rig_files.py`, half are shipped files with one number changed. A
run of more than 20 s of the rig's time is left there. Prints what became of them; a file that ends in
a traceback, or takes more than `--patience` of the processor, is written to a file, and the exit code is 1.

Of the first 400 files none ended in a traceback or took longer; the whole number has not been run yet.
"""

import argparse
import re
import sys
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.campaign.rig_files import Table, changed_files, fate, rig_files, shipped_files, toml

_CHUNK = 20


def carried_out(number: int, patience_s: float) -> tuple[Counter[str], list[str]]:
    """So many files of a seed: what became of them, and what went wrong with which."""
    fates: Counter[str] = Counter()
    wrong: list[str] = []
    drawn = rig_files() if number % 2 else changed_files(shipped_files())

    @seed(number)
    @settings(
        max_examples=_CHUNK,
        deadline=None,
        database=None,
        derandomize=False,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(drawn)
    def carry_out(table: Table) -> None:
        begin = time.process_time()
        try:
            found = fate(table)
        except Exception:
            wrong.append(_kept(table, number, len(wrong), traceback.format_exc()))
            return
        fates[f"{found.kind}: {re.sub(r'-?[0-9][0-9.e-]*', '#', found.text)[:110]}"] += 1
        if time.process_time() - begin > patience_s:
            wrong.append(_kept(table, number, len(wrong), f"took {time.process_time() - begin:.0f} s"))

    carry_out()
    return fates, wrong


def _kept(table: Table, number: int, index: int, why: str) -> str:
    path = Path(f"drawn-{number}-{index}.toml")
    path.write_text(toml(table), encoding="utf-8")
    return f"{path}: {why}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--files", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--patience", type=float, default=60.0)
    args = parser.parse_args()
    numbers = range(args.seed, args.seed + -(-args.files // _CHUNK))
    fates: Counter[str] = Counter()
    wrong: list[str] = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for some, bad in pool.map(carried_out, numbers, [args.patience] * len(numbers)):
            fates += some
            wrong += bad
            print("\n".join([f"{fates.total()} files, {len(wrong)} wrong", *bad]), flush=True)
    kinds: Counter[str] = Counter()
    for text, count in fates.items():
        kinds[text.partition(":")[0]] += count
    print("\n| what became of it | files |\n|---|---|")
    print("\n".join(f"| {kind} | {count} |" for kind, count in kinds.most_common()))
    print("\n".join(f"{count:5} {text}" for text, count in fates.most_common(80)))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
