"""The first day on hardware, emulated: adapters and mechanics as bought, and what `identify` makes of them.

    python benchmarks/bench_first_day.py              # every row, 10 seeds
    python benchmarks/bench_first_day.py --seeds 3 --only latency
    python benchmarks/bench_first_day.py --page       # and writes docs/as-bought.md's table

Emulated bench, virtual time. Exit code 1 if an answer is wrong or torque is left on.
"""

import argparse
import statistics
import sys
import textwrap
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.benches.as_bought import ROWS, Outcome, Row, run_row
from support.commands.repository import ROOT

PAGE = ROOT / "docs" / "as-bought.md"
_BEGIN, _END = "<!-- table: python benchmarks/bench_first_day.py --page -->\n", "<!-- end of table -->"
_WIDTH = 118
_HEAD = (
    "| what is different | right | wrong | begun again | rig time, s | peak, N |\n|---|---|---|---|---|---|\n"
)


def line(row: Row, found: list[Outcome]) -> str:
    """One row of the table."""
    right = sum(item.kind == "right" for item in found)
    wrong = sum(item.kind in ("wrong", "unsure") or bool(item.torque_on) for item in found)
    again = sum("begun again" in notice for item in found for notice in item.notices)
    spent = [item.rig_s for item in found if item.rig_s]
    rig_s = f"{statistics.median(spent):.1f}" if spent else "–"
    hardest = max(item.hardest_n for item in found)
    cells = [right, wrong, again, rig_s, f"{hardest:.1f}"]
    return f"| {row.name} | " + " | ".join(str(cell) for cell in cells) + " |\n"


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="", help="words of a row's name")
    parser.add_argument("--page", action="store_true")
    asked = parser.parse_args()
    table, well, bad, begin = _HEAD, [], 0, time.perf_counter()
    for row in ROWS:
        if asked.only not in row.name:
            continue
        found = [run_row(row, seed) for seed in range(asked.seeds)]
        print(line(row, found), end="", flush=True)
        if all(item.kind == "right" and not item.torque_on for item in found) and row is not ROWS[0]:
            well.append(row.name)
        else:
            table += line(row, found)
        for seed, item in enumerate(found):
            if item.kind in ("wrong", "unsure"):
                print(f"    {item.kind}, seed {seed}: {item.text} torque {item.torque_on}", flush=True)
            elif item.kind == "message" and seed < 2:
                print(f"    says, seed {seed}: {item.text}", flush=True)
        bad += sum(item.kind == "wrong" for item in found)
    print(f"{asked.seeds} seeds each, {bad} wrong, {time.perf_counter() - begin:.0f} s")
    if asked.page:
        text = PAGE.read_text(encoding="utf-8")
        start, end = text.index(_BEGIN) + len(_BEGIN), text.index(_END)
        names = textwrap.fill(f"All right, and not in the table: {'; '.join(well)}.", _WIDTH)
        table += f"\n{names}\n"
        PAGE.write_text(text[:start] + table + text[end:], encoding="utf-8")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
