"""Rigs that are not as their file says: what check, the press of tips, calibrate and a run make of them.

    python benchmarks/bench_wrong_setups.py --count 60 --out setups.jsonl      # drawn wrong set-ups
    python benchmarks/bench_wrong_setups.py --right 300 --out right.jsonl      # right ones: no alarm
    python benchmarks/bench_wrong_setups.py --count 200 --mistakes "all as declared"   # up to the bounds
    python benchmarks/bench_wrong_setups.py --tell setups.jsonl right.jsonl    # the tables

Each is a mistake of `wrong_setups.py` on a rig, in virtual time. A line of JSON a set-up holds what each
command found, how hard fingers pressed, what a run answered, and whether the answer was true. False without
a notice, a push harder by more than 1 N than a right rig's hardest, and a wrong cause are what must not be.
"""

import argparse
import json
import multiprocessing
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from wrong_sensors import SpoiltTaxels
from wrong_setups import MISTAKES, UNMEASURED, WITHIN, SetUp, draw, is_possible, rigs

import palpate
from palpate.base.errors import PalpateError
from palpate.config import RigFile
from palpate.rig import bench
from palpate.rig.emulated import devices
from palpate.rig.emulated.devices import EmulatedRig

_HARDER_N = 1.0


@contextmanager
def mounted(setup: SetUp) -> Iterator[list[EmulatedRig]]:
    """While this lasts, emulated benches are built from the truth; returns those that were."""
    made: list[EmulatedRig] = []
    emulate, taxels = bench.emulate, devices.Taxels
    true = RigFile.model_validate(setup.true)

    def emulate_truth(_: RigFile, placements: Any, seed: int) -> EmulatedRig:
        SpoiltTaxels.names = tuple(finger.name for finger in true.fingers)
        SpoiltTaxels.sensors, SpoiltTaxels.made = setup.sensors, 0
        found = emulate(true, placements, seed)
        chain, baudrate = found.devices[true.bus.port]
        for packet in setup.written:
            chain.feed_at(packet, 0.0, baudrate)  # type: ignore[attr-defined]
        made.append(found)
        return found

    bench.emulate, devices.Taxels = emulate_truth, SpoiltTaxels  # type: ignore[assignment,misc]
    try:
        yield made
    finally:
        bench.emulate, devices.Taxels = emulate, taxels  # type: ignore[misc]


def _attempt(call: Callable[[], dict[str, Any]], made: list[EmulatedRig]) -> dict[str, Any]:
    """What a command came to; a traceback is a row of its own."""
    try:
        found = call()
    except PalpateError as error:
        text = "; ".join([str(error), *getattr(error, "__notes__", [])])
        found = {"ended": type(error).__name__, "text": text}
    except Exception:
        found = {"ended": "TRACEBACK", "text": traceback.format_exc()[-800:]}
    if made:
        fingers = made[-1].bench.fingers
        found["hardest_n"] = max(float(finger.hardest_n) for finger in fingers)
        found["torque_on"] = [
            servo.dxl_id
            for finger in fingers
            for servo in finger.servos
            if (answer := servo.answer_block(64, 1)) is not None and answer.params[0]
        ]
    return found


def _identify(rig: palpate.Rig) -> dict[str, Any]:
    said: list[str] = []
    answer = rig.identify(notice=said.append, warn=said.append)
    out = json.loads(answer.to_json())
    truth = out.get("truth") or {}
    text = answer.text()
    return {
        "verdict": str(answer.verdict),
        "named": truth.get("named"),
        "inside": truth.get("inside_bounds"),
        "error_mm": truth.get("position_error"),
        "seconds": out["rig_seconds"],
        "touches": out["touches"],
        "said": [*said, *out.get("notices", ())],
        "hints": out["setup_doubts"],
        "text": text,
    }


def _doctor(rig: palpate.Rig) -> dict[str, Any]:
    found = json.loads(rig.doctor(notice=lambda _: None).to_json())
    findings = [item for step in found["steps"] for item in step.get("findings", [])]
    return {
        "wrong": [f"{item['cause']}: {item['saw']}" for item in findings if item["severity"] == "wrong"],
        "warnings": [f"{item['cause']}: {item['saw']}" for item in findings if item["severity"] != "wrong"],
    }


def _calibrate(rig: palpate.Rig) -> dict[str, Any]:
    rig.calibrate()
    return {"ended": "calibrated"}


def _wiring(rig: palpate.Rig) -> dict[str, Any]:
    """Press and move; then the change is written, and the file that is left is proven again."""
    answer = rig.check(press=True, move=True, notice=lambda _: None)
    found = json.loads(answer.to_json())
    findings = [item for step in found["steps"] for item in step.get("findings", [])]
    wiring = found["wiring"] or {}
    row = {
        "wrong": [f"{item['cause']}: {item['saw']}" for item in findings if item["severity"] == "wrong"],
        "next": [item["next"] for item in findings if item["severity"] == "wrong"],
        "confirmed": wiring.get("confirmed"),
        "changes": wiring.get("changes", []),
        "mended": None,
    }
    if wiring.get("changes"):
        answer.apply()
        with palpate.open_rig(rig.path, seed=1, calibration=False) as mended:
            again = json.loads(mended.check(press=True, move=True, notice=lambda _: None).to_json())
        row["mended"] = (again["wiring"] or {}).get("confirmed")
    return row


COMMANDS: dict[str, Callable[[palpate.Rig], dict[str, Any]]] = {
    "doctor": _doctor,
    "identify": _identify,
    "calibrate": _calibrate,
    "wiring": _wiring,
}


def run(asked: tuple[str, str, int, tuple[str, ...]]) -> dict[str, Any]:
    """Try commands on a set-up, each on a bench of its own."""
    name, mistake, seed, commands = asked
    setup = draw(name, mistake, seed)
    row: dict[str, Any] = {"rig": name, "mistake": mistake, "detail": setup.detail, "seed": seed}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(tomlkit.dumps(setup.told))
        for command in commands:
            begin = time.process_time()
            with mounted(setup) as made:

                def call(command: str = command) -> dict[str, Any]:
                    own = path.with_name(f"{command}.toml")  # what one writes is not for the next
                    shutil.copy(path, own)
                    with palpate.open_rig(own, seed=seed, calibration=False) as rig:
                        return COMMANDS[command](rig)

                row[command] = _attempt(call, made)
            row[command]["cpu_s"] = round(time.process_time() - begin, 1)
    return row


def drawn(count: int, seed: int, names: list[str], mistakes: list[str]) -> list[tuple[str, str, int]]:
    """Wrong set-ups: every mistake as often as the others, on rigs drawn at random."""
    rng = np.random.default_rng(seed)
    found: list[tuple[str, str, int]] = []
    while len(found) < count:
        for mistake in rng.permutation(mistakes):
            rig = str(rng.choice(names))
            if is_possible(rig, str(mistake)):
                found.append((rig, str(mistake), int(rng.integers(1000))))
    return found[:count]


def outcome(row: dict[str, Any]) -> str:
    """How a run ended, beside the truth."""
    if (found := row.get("identify")) is None:
        return "not run"
    if "ended" in found:
        return str(found["ended"])
    if found["verdict"] != "identified":
        return str(found["verdict"])
    if found["named"] and found["inside"]:
        return "right"
    return "FALSE, said" if found["said"] or found["hints"] else "FALSE, SILENT"


def tell(rows: list[dict[str, Any]]) -> None:
    """Print a line a set-up, and what there is in all."""
    most: dict[str, float] = defaultdict(float)
    for row in rows:
        if row["mistake"] == "right":
            most[row["rig"]] = max(most[row["rig"]], row.get("identify", {}).get("hardest_n", 0.0))
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        found = row.get("identify", {})
        how = outcome(row)
        counts[row["mistake"]][how] += 1
        harder = found.get("hardest_n", 0.0) - most.get(row["rig"], np.inf)
        marks = " HARDER" if harder > _HARDER_N else ""
        marks += " TORQUE ON" if found.get("torque_on") else ""
        if row["mistake"] != "right" or how != "right" or found.get("said") or found.get("hints"):
            print(
                f"{row['rig']:8s} {row['seed']:4d} {row['mistake']:20s} {row['detail']:30s} {how:14s}"
                f" {found.get('hardest_n', 0):5.1f} N{marks}"
            )
            for command in COMMANDS:
                for line in _lines(row.get(command, {})):
                    print(f"          {command}: {line}")
    print()
    for mistake, found in counts.items():
        print(f"{mistake:22s}", ", ".join(f"{count} {how}" for how, count in found.most_common()))


def _lines(found: dict[str, Any]) -> list[str]:
    lines = [f"{found['ended']}: {found.get('text', '')[:400]}"] if "ended" in found else []
    lines += [f"WRONG {item[:240]}" for item in found.get("wrong", [])]
    if "confirmed" in found:
        mended = "" if found["mended"] is None else f", mended {found['mended']}"
        lines.append(f"confirmed {found['confirmed']}{mended}; {'; '.join(found['next'])[:300]}")
    lines += [f"warns {item[:240]}" for item in found.get("warnings", [])]
    lines += [f"says {item[:240]}" for item in found.get("said", [])]
    lines += [f"hint {json.dumps(item)[:240]}" for item in found.get("hints", [])]
    return lines


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=0)
    parser.add_argument("--right", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--rigs",
        default=",".join(name for name in rigs() if name != UNMEASURED),
        help="or paths of rig files",
    )
    parser.add_argument("--mistakes", default=",".join(MISTAKES), help=f"also {', '.join(WITHIN)}")
    parser.add_argument("--commands", default="doctor,identify")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--tell", type=Path, nargs="+")
    asked = parser.parse_args()
    if asked.tell:
        tell([json.loads(line) for path in asked.tell for line in path.read_text().splitlines()])
        return 0
    names = asked.rigs.split(",")
    wanted = drawn(asked.count, asked.seed, names, asked.mistakes.split(","))
    wanted += [(names[k % len(names)], "right", asked.seed + k // len(names)) for k in range(asked.right)]
    work = [(*item, tuple(asked.commands.split(","))) for item in wanted]
    rows = []
    with multiprocessing.get_context("spawn").Pool(asked.jobs) as pool:
        for row in pool.imap_unordered(run, work):
            rows.append(row)
            if asked.out is not None:
                with asked.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    tell(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
