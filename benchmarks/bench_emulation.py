"""Emulated runs beside those of another checkout: the same bytes at the same instants, and what they cost.

    python benchmarks/bench_emulation.py --reference CHECKOUT                # 60 drawn runs, both ways
    python benchmarks/bench_emulation.py --reference CHECKOUT --runs N --first SEED
    python benchmarks/bench_emulation.py --time                              # only what whole runs cost here
    python benchmarks/bench_emulation.py --time --write                      # and to docs/performance.md

A run is one identification on emulated devices: rig, engine of the part, wire faults and catalogue's draw by
the run's number. Compared are all bytes at both ends of every port with the instants at which the host or the
device let go of them, where tips and part really were in the end, and the verdict. The reference runs this
file with its own palpate. Ends with exit code 1 if anything differs.
"""

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from performance_page import markdown_table, update, versions_line

import palpate
from palpate.base.errors import PalpateError
from palpate.config import load_objects, load_rig, shipped_objects
from palpate.config.emulation import EmulatedPartConfig
from palpate.drivers.transport import protocol_mock
from palpate.recognizer import Catalogue
from palpate.rig import bench as composition
from palpate.rig.identification.identify import identify

HERE = Path(__file__).resolve().parents[1]
RIGS = (
    "src/palpate/config/rigs/bench.toml",
    "src/palpate/config/rigs/xm430-bench.toml",
    "src/palpate/config/rigs/xl330-bench.toml",
    "examples/firm-rig.toml",
    "examples/two-link-rig.toml",
    "examples/fresh-rig.toml",
)
SHIPPED = 3
TIMED_SEEDS = range(20)
WATCHED_SEEDS = (0, 3, 7)
TIMED_ENGINES = ("still", "quasi-static")
EMULATION = ("/drivers/emulators/", "/rig/emulated/")
TICK_S = 1e-3


def drawn(number: int) -> dict[str, Any]:
    """What run `number` is: mostly shipped rigs, in turn still and sliding parts, some with bad wires."""
    rng = np.random.default_rng([number, 99])
    rig = int(rng.integers(SHIPPED)) if rng.uniform() < 0.8 else int(rng.integers(SHIPPED, len(RIGS)))
    bad = rng.uniform() < 0.3
    return {
        "seed": number,
        "rig": RIGS[rig],
        "engine": ("still", "quasi-static")[number % 2],
        "flipped_bytes": float(rng.uniform(0, 2e-5)) if bad else 0.0,
        "lost_packets": float(rng.uniform(0, 2e-3)) if bad else 0.0,
        "array_boot_s": float(rng.uniform(0, 0.5)) if rng.uniform() < 0.2 else 0.0,
        "fault": ("", "", "", "", "voltage", "power", "push")[int(rng.integers(7))],
        "at_s": float(rng.uniform(1.0, 40.0)),
        "traced": True,
    }


class Traced:
    """A device whose emissions are noted."""

    def __init__(self, port: str, device: Any, note: Callable[..., None]):
        self._port, self._device, self._note = port, device, note
        if hasattr(device, "feed_at"):
            self.feed_at = lambda data, now, rate: self._noted("feed_at", data, now, rate)
        if hasattr(device, "opened"):
            self.opened = device.opened

    def feed(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """As the device."""
        return self._noted("feed", data, now)

    def poll(self, now: float) -> list[tuple[float, bytes]]:
        """As the device."""
        return self._noted("poll", now)

    def next_due(self) -> float | None:
        """As the device."""
        due: float | None = self._device.next_due()
        return due

    def _noted(self, verb: str, *args: Any) -> list[tuple[float, bytes]]:
        emissions: list[tuple[float, bytes]] = getattr(self._device, verb)(*args)
        for instant, data in emissions:
            self._note(self._port, "device", instant, data)
        return emissions


class Trace:
    """A hash for each port and direction."""

    def __init__(self) -> None:
        self._hashes: dict[tuple[str, str], Any] = {}
        self.bytes = 0

    def note(self, port: str, side: str, instant: float, data: bytes) -> None:
        """Bytes that passed at an instant (s)."""
        if data:
            digest = self._hashes.setdefault((port, side), hashlib.sha256())
            digest.update(float(instant).hex().encode() + b" " + data + b"\n")
            self.bytes += len(data)

    def digests(self) -> dict[str, str]:
        """By port and side."""
        return {f"{port} {side}": digest.hexdigest() for (port, side), digest in self._hashes.items()}


class Share:
    """What share of the processor's time is spent in emulated devices, by looks at the stack."""

    def __init__(self) -> None:
        self._looks = self._emulated = 0

    @property
    def share(self) -> float:
        """0 to 1."""
        return self._emulated / max(self._looks, 1)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Look now and then while what is in it is carried out."""
        signal.signal(signal.SIGPROF, self._look)
        signal.setitimer(signal.ITIMER_PROF, TICK_S, TICK_S)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)

    def _look(self, _number: int, frame: Any) -> None:
        self._looks += 1
        while frame is not None:
            if any(folder in frame.f_code.co_filename for folder in EMULATION):
                self._emulated += 1
                return
            frame = frame.f_back


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Carry out a run with whatever palpate is importable."""
    rig = load_rig(HERE / case["rig"])
    assert rig.emulation is not None, "the rig is emulated"
    part = rig.emulation.part or EmulatedPartConfig(engine="still", mass_kg=0.3, friction=0.4)
    keys = ("flipped_bytes", "lost_packets", "array_boot_s")
    emulation = rig.emulation.model_copy(
        update={
            "part": part.model_copy(update={"engine": case["engine"]}),
            **{key: case[key] for key in keys},
        }
    )
    rig = rig.model_copy(update={"emulation": emulation})
    objects = load_objects(shipped_objects())
    trace, share = Trace(), Share()
    with composition.connect(composition.set_up(rig, (), 0)):
        pass  # what is imported when it is first used is no cost of a run
    began = time.process_time()
    catalogue = Catalogue(objects.objects)
    (placement,) = composition.choose_placements(rig, objects, None, case["seed"])
    if case["traced"]:
        _trace(trace, case)
    bench = composition.set_up(rig, [placement], case["seed"])
    assert bench.mock is not None, "the rig is emulated"
    emulated = bench.mock.rig.bench
    for finger in emulated.fingers:
        finger.weighs_taxels = case["traced"]  # a command does not
    try:
        watch = share.watched() if case.get("watched") else nullcontext()
        with watch, composition.connect(bench) as hand:
            hand.prepare()
            outcome = identify(hand, catalogue, seed=case["seed"]).outcome.value
    except PalpateError as problem:
        outcome = f"{type(problem).__name__}: {problem}"
    spent = time.process_time() - began
    shift = emulated.parts.displacements[0]
    truth = [*shift.shift_mm, shift.turn_rad, bench.clock.now()]
    for finger in emulated.fingers:
        truth += [*finger.centre_mm, finger.hardest_n, finger.hardest_on_taxels_n]
        truth += [value for servo in finger.servos for value in (servo.shaft_rad, servo.shaft_rad_s)]
    return {
        "outcome": outcome,
        "truth": [float(value).hex() for value in truth],
        "digests": trace.digests(),
        "bytes": trace.bytes,
        "rig_s": bench.clock.now(),
        "processor_s": spent,
        "emulation_s": spent * share.share,
    }


def _trace(trace: Trace, case: dict[str, Any]) -> None:
    """Note what passes at both ends of every port, and let the case's fault happen."""
    composing: Any = composition
    plain = composing.on_mock_wires

    def wired(emulated: Any) -> Any:
        if case["fault"]:
            happenings = emulated.bench.happenings
            happenings.append((case["at_s"], partial(_befall, emulated.bench, case)))
            happenings.sort(key=itemgetter(0))
        devices = {
            port: (Traced(port, device, trace.note), rate)
            for port, (device, rate) in emulated.devices.items()
        }
        return plain(replace(emulated, devices=devices))

    composing.on_mock_wires = wired
    serial: Any = protocol_mock.Serial
    read, write = serial.read, serial.write

    def noted_read(self: Any, size: int = 1, /) -> bytes:
        data: bytes = read(self, size)
        trace.note(self.port, "read", self._wire.clock.now(), data)
        return data

    def noted_write(self: Any, data: Any, /) -> int:
        trace.note(self.port, "written", self._wire.clock.now(), bytes(data))
        count: int = write(self, data)
        return count

    serial.read, serial.write = noted_read, noted_write


def _befall(bench: Any, case: dict[str, Any]) -> None:
    finger = bench.fingers[case["seed"] % len(bench.fingers)]
    servo = finger.servos[case["seed"] // 3 % 2]
    match case["fault"]:
        case "voltage":
            servo.set_supply(17.0)
        case "power":
            servo.set_supply(3.0)
            servo.set_supply(12.0)
        case "push":
            for other in bench.fingers:
                other.put(other.outlines)


def run(checkout: Path, case: dict[str, Any]) -> dict[str, Any]:
    """A run in a process of its own, with the palpate of a checkout."""
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src"), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(Path(__file__).resolve()), "--one", json.dumps(case)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"run {case} with {checkout} ended with:\n{done.stderr}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def differing(mine: dict[str, Any], reference: dict[str, Any]) -> list[str]:
    """What is not the same."""
    found = [key for key in ("outcome", "truth", "rig_s") if mine[key] != reference[key]]
    ports = {**mine["digests"], **reference["digests"]}
    return found + [port for port in ports if mine["digests"].get(port) != reference["digests"].get(port)]


def compared(reference: Path, cases: Iterator[dict[str, Any]]) -> int:
    """Carry out runs both ways; how many differ."""
    print("  seed rig                     engine       bad fault    rig s  s there  s here  times  MB   same")
    wrong = count = 0
    for case in cases:
        there, here = run(reference, case), run(HERE, case)
        off = differing(here, there)
        wrong, count = wrong + bool(off), count + 1
        print(
            f"{case['seed']:6} {Path(case['rig']).name:23} {case['engine']:12} "
            f"{'yes' if case['lost_packets'] else 'no':3} {case['fault'] or '-':8} {here['rig_s']:6.1f} "
            f"{there['processor_s']:8.2f} {here['processor_s']:7.2f} "
            f"{here['rig_s'] / here['processor_s']:6.1f} {here['bytes'] / 1e6:4.1f}  "
            + ("same" if not off else "DIFFERS: " + ", ".join(off))
            + f"  {here['outcome'][:60]}",
            flush=True,
        )
    print(f"{count} runs, {wrong} differ")
    return wrong


def timed(checkouts: list[Path], *, write: bool) -> None:
    """What whole identifications on the shipped bench cost, untraced, in each checkout; this one's last."""
    head = ("engine", "runs", "rig time", "processor time", "times faster", "of each run", "emulated devices")
    rows: list[tuple[str, ...]] = []
    for engine in TIMED_ENGINES:
        for checkout in checkouts:
            runs = [run(checkout, timed_case(seed, engine)) for seed in TIMED_SEEDS]
            rig_s, whole_s = np.array([(each["rig_s"], each["processor_s"]) for each in runs]).T
            watched = [run(checkout, timed_case(seed, engine, watched=True)) for seed in WATCHED_SEEDS]
            share = np.mean([each["emulation_s"] / each["processor_s"] for each in watched])
            times = rig_s / whole_s
            row = (
                f"`{engine}`",
                str(len(runs)),
                f"{rig_s.sum():.0f} s",
                f"{whole_s.sum():.1f} s",
                f"{rig_s.sum() / whole_s.sum():.1f}",
                f"{times.min():.1f} to {times.max():.1f}",
                f"{100 * share:.0f} %",
            )
            print(checkout, *row, flush=True)
        rows.append(row)
    if write:
        versions = {"palpate": palpate.__version__, "numpy": np.__version__, "Python": sys.version.split()[0]}
        update("emulated runs", f"{versions_line(versions)}\n\n{markdown_table(head, rows)}")


def timed_case(seed: int, engine: str, *, watched: bool = False) -> dict[str, Any]:
    """A run on the shipped bench with good wires. `watched`: to see where time goes; watching takes some."""
    case = {**drawn(seed), "rig": RIGS[0], "engine": engine, "fault": "", "traced": False, "watched": watched}
    return case | {"flipped_bytes": 0.0, "lost_packets": 0.0, "array_boot_s": 0.0}


def main() -> int:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--reference", type=Path, help="another checkout of palpate")
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--time", action="store_true")
    parser.add_argument("--write", action="store_true", help="write what --time found to docs/performance.md")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(json.dumps(one(json.loads(asked.one))))
        return 0
    references = [asked.reference] if asked.reference else []
    if asked.time:
        timed([*references, HERE], write=asked.write)
        return 0
    if not references:
        parser.error("--reference or --time")
    return 1 if compared(references[0], map(drawn, range(asked.first, asked.first + asked.runs))) else 0


if __name__ == "__main__":
    sys.exit(main())
