"""What the servo bus is told over bad wires, ten million times: `python benchmarks/bench_bad_wires.py`.

A host reads and writes at random (items one by one, sync and bulk and fast reads, sync writes, pings) over
eleven kinds of wire in virtual time, and every value, confirmation and refusal is compared with what the
servos held. Control loops, which always ask the same, go over those wires that can answer with what was true
before. The servos are memory behind bytes of Protocol 2.0 (`tests/support/devices/spoiling_wire.py`), so that
nothing but host and wire takes time. One transaction is one instruction packet with its answers; a sync read
has several values.

One core. With `--log` every chunk is written down as it ends, and a chunk that is in the log is not run
again: the same command goes on where it was stopped. `--report` only shows what is in the log. To compare
with another version of palpate, run this file with that version's Python and a log of its own.
"""

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.devices.spoiling_wire import KINDS, LOOPS, Tally, loop, talk

CHUNK = 20_000
ALL = {**dict.fromkeys(KINDS, talk), **dict.fromkeys(LOOPS, loop)}
COLUMNS = (
    "instructions",
    "values",
    "wrong",
    "unconfirmed",
    "misled",
    "let_through",
    "undone",
    "clock_values",
    "old",
    "calls",
    "failed",
)

Done = dict[tuple[str, int], Tally]


def read_log(path: Path | None) -> Done:
    """The chunks that a log holds; a last line that was cut off is none."""
    done: Done = {}
    if path is None or not path.exists():
        return done
    for line in path.read_text().splitlines():
        try:
            row = json.loads(line)
        except ValueError:
            continue
        done[row["kind"], row["seed"]] = Tally(**row["tally"])
    return done


def table(done: Done) -> str:
    """A row for each kind of wire, and their sum."""
    rows = [f"{'wire':31}" + "".join(f"{name:>13}" for name in COLUMNS)]
    total = Tally()
    for kind in ALL:
        sums = Tally()
        for (name, _), tally in done.items():
            if name == kind.name:
                sums.add(tally)
        total.add(sums)
        rows.append(line(kind.name, sums))
    return "\n".join([*rows, line("together", total)])


def line(name: str, tally: Tally) -> str:
    """A row of the table."""
    return f"{name:31}" + "".join(f"{getattr(tally, column):>13,}" for column in COLUMNS)


def main() -> int:
    """Run what is missing and print the table; exit code 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transactions", type=int, default=10_000_000, help="of all kinds together")
    parser.add_argument("--log", type=Path, help="where chunks are written down, and looked up")
    parser.add_argument("--report", action="store_true", help="show the log, run nothing")
    parser.add_argument("--only", choices=[kind.name for kind in ALL], help="one kind of wire")
    options = parser.parse_args()
    kinds = {kind: run for kind, run in ALL.items() if options.only in (None, kind.name)}
    done = read_log(options.log)
    chunks = -(-options.transactions // (CHUNK * len(kinds)))
    begin = time.monotonic()
    for seed in range(0 if options.report else chunks):
        for kind, run in kinds.items():
            if (kind.name, seed) in done:
                continue
            tally = done[kind.name, seed] = run(kind, seed, CHUNK)
            if options.log is not None:
                with options.log.open("a") as log:
                    log.write(json.dumps({"kind": kind.name, "seed": seed, "tally": tally.as_dict()}) + "\n")
    print(table(done))
    if not options.report:
        print(f"{time.monotonic() - begin:.0f} s")
    return int(any(tally.wrong + tally.unconfirmed + tally.misled for tally in done.values()))


if __name__ == "__main__":
    sys.exit(main())
