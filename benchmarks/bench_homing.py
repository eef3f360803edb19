"""Runs from random postures, and runs after a blink of power: what comes of them.

    python benchmarks/bench_homing.py [--postures 100] [--blinks 50] [--kind slides|arms|stage]

Postures: each seed is a small bench of another hidden truth, with a part, and with its joints and its stage
anywhere in their ranges and its slides anywhere in their travel. Blinks: in a run on such a bench of slides
one servo is without power for a moment, at an instant drawn from the whole run; then the same bench runs once
more from where everything came to rest. Right: the part is identified and lies within the bounds. Message: an
error's line. Wrong: anything else. Torque is read from the emulated servos; so is what tips pressed
with until the first grip, and how far the part was moved by it. A line a run goes to stderr.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.benches.as_bought import RIGS, HomingOutcome, run_after_blink, run_from_anywhere


def _table(name: str, outcomes: list[HomingOutcome]) -> None:
    kinds = Counter(outcome.kind for outcome in outcomes)
    torque = sum(bool(outcome.torque_on) for outcome in outcomes)
    homed = sum(outcome.homed > 0 for outcome in outcomes)
    print(
        f"| {name} | {len(outcomes)} | {kinds['right']} | {kinds['message']} | {kinds['unresolved']} | "
        f"{kinds['wrong']} | {torque} | {homed} | {max(outcome.hardest_n for outcome in outcomes):.1f} | "
        f"{max(outcome.at_start_n for outcome in outcomes):.1f} | "
        f"{max(outcome.moved_mm for outcome in outcomes):.2f} |"
    )
    for text, count in Counter(o.text for o in outcomes if o.kind != "right").most_common():
        print(f"    {count} × {text}")


def _told(seed: int, kind: str) -> HomingOutcome:
    outcome = run_from_anywhere(seed, kind)
    print(seed, outcome, file=sys.stderr, flush=True)
    return outcome


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--postures", type=int, default=100)
    parser.add_argument("--blinks", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", choices=RIGS, default="slides")
    asked = parser.parse_args()
    print(
        "| runs | n | right | message | not resolved | wrong | torque on | began | hardest, N | "
        "before the first grip, N | part moved by then, mm |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    if asked.postures:
        seeds = range(asked.first, asked.first + asked.postures)
        _table(f"{asked.kind}, from a random posture", [_told(seed, asked.kind) for seed in seeds])
    if asked.blinks and asked.kind == "slides":
        pairs = [run_after_blink(seed) for seed in range(asked.blinks)]
        _table("in which power blinks", [first for first, _ in pairs])
        _table("after it", [second for _, second in pairs])


if __name__ == "__main__":
    main()
