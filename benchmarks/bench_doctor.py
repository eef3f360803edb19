"""Faults planted one at a time in an emulated set-up: does `palpate doctor` name the cause, and no other?

    python benchmarks/bench_doctor.py                 # all faults
    python benchmarks/bench_doctor.py --only array    # those with a word in their name

Emulated devices in virtual time, and a stand-in for the system that opens ports. Prints a row for each fault;
exit code 1 if a cause is not named, a wrong one is, or a set-up without a fault has a finding.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.config.diagnosis_results import FindingOut
from support.benches.doctor import FAULTS, WELL, Fault, examined

WANTED = 28 / 30


def findings_of(fault: Fault, seed: int) -> Sequence[FindingOut]:
    """What doctor finds in a set-up with this fault."""
    with TemporaryDirectory() as folder:
        return examined(fault, Path(folder), seed).findings


def is_named(fault: Fault, found: Sequence[FindingOut]) -> bool:
    """Whether a finding has the fault's cause and its device."""
    return any(item.cause is fault.cause and fault.device in item.device for item in found)


def wrong_ones(fault: Fault, found: Sequence[FindingOut]) -> list[FindingOut]:
    """Findings that are not the fault."""
    return [item for item in found if item.cause is not fault.cause]


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="words of a fault's name")
    parser.add_argument("--seed", type=int, default=3)
    asked = parser.parse_args()
    begin = time.perf_counter()
    named = wrong = false = 0
    chosen = [fault for fault in (*WELL, *FAULTS) if asked.only in fault.name]
    for fault in chosen:
        found = findings_of(fault, asked.seed)
        others = wrong_ones(fault, found)
        if fault.cause is not None:
            named += is_named(fault, found)
            wrong += bool(others)
        else:
            false += bool(found)
        right = (is_named(fault, found) or fault.cause is None) and not others
        print(
            f"{'ok   ' if right else 'WRONG'} {fault.name:50} {', '.join(item.cause for item in found)}",
            flush=True,
        )
        for item in () if right else found:
            print(f"        {item.cause}: {item.device}: {item.saw} | {item.means} | {item.next}")
    planted = sum(fault.cause is not None for fault in chosen)
    well = len(chosen) - planted
    verdict = (
        f"{named} of {planted} causes named, {wrong} with a wrong one beside it; "
        f"{false} of {well} set-ups without a fault had a finding."
    )
    print(f"\n{verdict} {time.perf_counter() - begin:.0f} s")
    return 1 if wrong or false or named < WANTED * planted else 0


if __name__ == "__main__":
    sys.exit(main())
