"""What `palpate check --hold` says of parts that slide, against the force at which they really do.

    python benchmarks/bench_hold.py                   # 20 parts that slide, quasi-statically
    … --engine mujoco --feet 6 --runs 100 --first 20  # others

Drawn per seed: mass 50 g to 1 kg (log-uniform), friction on the table 0.15 to 0.5, at the tips 0 to 0.6, one
of the shipped parts within 20 mm of the middle. Prints a row for each, with `part_holds_n` and each finger's
forces as shares of the true one, and the shares' median. Ends with status 1 if one of them is above 1.
"""

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from palpate.base.errors import PalpateError
from palpate.config import RigFile, load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.diagnosis_results import HoldCheckOut
from palpate.config.emulation import EmulatedPartConfig
from palpate.rig.bench import BenchRig, choose_placements, connect, set_up
from palpate.rig.diagnostics.motion_checks import check_hold, least_threshold_n, with_light_touch


def drawn(seed: int, engine: str, feet: int) -> tuple[RigFile, EmulatedPartConfig]:
    """The shipped rig with a part as the seed draws it, and the part."""
    rng = np.random.default_rng([seed, 88])
    part = EmulatedPartConfig(
        engine=engine,
        mass_kg=0.05 * 20 ** rng.uniform(),
        friction=rng.uniform(0.15, 0.5),
        tip_friction=rng.uniform(0.0, 0.6),
        feet=feet,
    )
    rig = load_rig(shipped_rig())
    assert rig.emulation is not None
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"part": part})}), part


def measured(bench: BenchRig) -> HoldCheckOut:
    """Push the part that lies there."""
    with connect(bench) as hand:
        hand.prepare()
        quietest_n = least_threshold_n(hand)
    with connect(replace(bench, rig=with_light_touch(bench.rig, quietest_n))) as hand:
        hand.prepare()
        return check_hold(hand)


def run(seed: int, engine: str, feet: int) -> tuple[float, float] | None:
    """One part: part_holds_n and least_n as shares of the true force; None if there is no answer."""
    rig, part = drawn(seed, engine, feet)
    (lies,) = choose_placements(rig, load_objects(shipped_objects()), None, seed)
    bench = set_up(rig, [lies], seed)
    assert bench.emulated is not None
    slip_n = bench.emulated.parts[0].slip_n
    row = f"{seed:4}  {lies.model.name:8} {slip_n:6.3f}  {part.tip_friction:4.2f}"
    begin = time.perf_counter()
    try:
        out = measured(bench)
    except PalpateError as error:
        print(f"{row}  {error}", flush=True)
        return None
    moved = bench.emulated.bench.parts.displacements[0]
    fingers = "  ".join(
        f"{item.finger} {item.pressed_n / slip_n:.2f}/{(item.holds_n or 0) / slip_n:.2f}"
        + ("" if item.slid else " stood")
        for item in out.fingers
    )
    print(
        f"{row}  {out.part_holds_n:5.2g} N = {out.part_holds_n / slip_n:4.2f}   {out.moved_mm:4.2f}"
        f"  {np.hypot(*moved.shift_mm):4.2f} {np.degrees(moved.turn_rad):5.2f}   {bench.clock.now():4.0f}"
        f"  {time.perf_counter() - begin:4.0f}   {fingers}",
        flush=True,
    )
    return out.part_holds_n / slip_n, out.least_n / slip_n


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--engine", choices=["mujoco", "quasi-static"], default="quasi-static")
    parser.add_argument("--feet", type=int, default=0)
    asked = parser.parse_args()
    print("seed  part      F, N    tips  holds            moved  shift   turn  rig s   s   measured/certain")
    found = [run(asked.first + k, asked.engine, asked.feet) for k in range(asked.runs)]
    if not any(found):
        return 1
    shares = np.array([item for item in found if item is not None]).reshape(-1, 2)
    print(
        f"{len(shares)} of {asked.runs} answered; shares of the true force: part_holds_n "
        f"{np.median(shares[:, 0]):.2f} in the median, {shares[:, 0].min():.2f} to {shares[:, 0].max():.2f}; "
        f"least_n {np.median(shares[:, 1]):.2f}"
    )
    return int((shares > 1).any())


if __name__ == "__main__":
    sys.exit(main())
