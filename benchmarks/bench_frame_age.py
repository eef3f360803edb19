"""Single grips of parts that slide, behind adapters as bought: do late frames break what a grip claims?

    python benchmarks/bench_frame_age.py                       # every row, 40 grips each, both speeds
    python benchmarks/bench_frame_age.py --grips 200 --only stalls

Emulated bench made small, quasi-static part. Drawn per grip: part and place, mass 50 g to 1 kg, friction 0.15
to 0.5, at the tips 0 to 0.6, approaches of all fingers. Declared is exactly what the part bears. "light" is
the shipped bench's closing, "fast" that of `examples/firm-rig.toml`. Printed are the largest shares of what
was claimed, and in how many grips it was not true: of contacts' bounds, ways that were free, the part's
motion before and after the measurement, forces at their instants, and work. Exit code 1 if anything is.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.benches.late_grips import RIGS, ROWS, run_grip


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--grips", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--kind", choices=RIGS, default=None)
    asked = parser.parse_args()
    bad = 0
    for kind in RIGS if asked.kind is None else (asked.kind,):
        for row in ROWS:
            if asked.only not in row.name:
                continue
            worst: dict[str, float] = {}
            broken, ended = Counter[str](), Counter[str]()
            for seed in range(asked.first, asked.first + asked.grips):
                found = run_grip(kind, row, seed)
                if isinstance(found, str):
                    ended[found.split(":")[0][:70]] += 1
                    continue
                for name, share in found.items():
                    worst[name] = max(worst.get(name, 0.0), share)
                    broken[name] += share > 1
            bad += sum(broken.values())
            print(f"{kind}, {row.name}: {asked.grips} grips, {sum(ended.values())} ended by a message")
            print("   " + "  ".join(f"{n} {worst[n]:.2f} ({broken[n]})" for n in sorted(worst)), flush=True)
            for text, count in ended.items():
                print(f"   {count} x {text}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
