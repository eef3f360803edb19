"""Full disks: commands on emulated devices behind pseudo-terminals, in real time, with a disk that fills up.

    mkdir small && sudo mount -t tmpfs -o size=2M tmpfs small
    python benchmarks/bench_full_disk.py --disk small --runs 20                # identify, its log on the disk
    python benchmarks/bench_full_disk.py --disk small --runs 5 --kind picture  # the picture on a full disk
    … --kind check, --kind calibrate

Leaves as much room as the seed draws, runs the command, and asks every servo for its Torque Enable with
another client, the vendor's SDK 3.8 as `make test` installs it. Exit code 1 if any servo has its torque on,
or a run ends otherwise than with one line and exit code 5.
"""

import argparse
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from truth_calibration import bench_calibration

from palpate.config import load_rig
from palpate.config.calibration_text import calibration_toml

ROOT = Path(__file__).resolve().parents[1]
PALPATE = Path(sys.executable).with_name("palpate")
OTHER_CLIENT = """
import json, sys
from dynamixel_sdk import PacketHandler, PortHandler
port = PortHandler(sys.argv[1]); port.openPort(); port.setBaudRate(1000000)
packets = PacketHandler(2.0)
print(json.dumps([packets.read1ByteTxRx(port, int(i), 64)[:2] for i in sys.argv[2:]]))
"""


@contextmanager
def served(rig: Path, seed: int, folder: Path) -> Iterator[tuple[Path, dict[str, str]]]:
    """The rig's devices on pseudo-terminals: the rig file for them, and their ports."""
    out = folder / "served.toml"
    process = subprocess.Popen(
        [PALPATE, "emulate", "--pty", "--rig", rig, "--rig-out", out, "--seed", str(seed)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield out, json.loads(process.stdout.readline())["ports"]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


def torques(port: str, ids: list[int]) -> list[list[int]]:
    """Torque Enable and how the read ended, of each servo, by the other client."""
    sdk = next((Path(sys.executable).parents[1] / "other").glob("dynamixel-sdk-3.8*"))
    done = subprocess.run(
        [sys.executable, "-c", OTHER_CLIENT, port, *map(str, ids)],
        env={"PYTHONPATH": str(sdk)},
        capture_output=True,
        text=True,
        check=True,
    )
    found: list[list[int]] = json.loads(done.stdout)
    return found


def fill(disk: Path, room: int) -> Path:
    """Fill a disk up to so many bytes."""
    filler = disk / "filler"
    with filler.open("wb") as file:
        file.write(bytes(max(shutil.disk_usage(disk).free - room, 0)))
    return filler


def command(kind: str, rig: Path, disk: Path, folder: Path) -> list[str | Path]:
    """What to run, with what it writes on the disk."""
    sessions = folder / "sessions"
    match kind:
        case "identify":
            return ["identify", "--rig", rig, "--sessions", disk / "sessions"]
        case "picture":
            return ["identify", "--rig", rig, "--sessions", sessions, "--picture", disk / "picture.svg"]
        case "check":
            return ["check", "--touch", "--yes", "--json", "--rig", rig]
        case _:
            return ["calibrate", "actuators", "--yes", "--rig", rig]


def one(kind: str, seed: int, disk: Path) -> bool:
    """One run; whether all was as it should be."""
    for item in disk.iterdir():
        shutil.rmtree(item) if item.is_dir() else item.unlink()
    fresh = kind == "calibrate"
    rig = ROOT / ("examples/fresh-rig.toml" if fresh else "config/rigs/bench.toml")
    with tempfile.TemporaryDirectory() as name, served(rig, seed, Path(name)) as (given, ports):
        folder = Path(name)
        used = disk / given.name if kind in ("calibrate", "check") else given
        if used != given:
            shutil.copy(given, used)
        if kind == "check":
            text = calibration_toml(bench_calibration(load_rig(rig), seed))
            used.with_suffix(".calibration.toml").write_text(text, encoding="utf-8")
        room = (
            0
            if kind != "identify"
            else random.Random(seed).choice((0, 4096, 65536, 400_000, 900_000, 1_500_000))
        )
        fill(disk, room)
        begin = time.monotonic()
        out = subprocess.DEVNULL if kind != "check" else (disk / "out.json").open("w")
        done = subprocess.run(
            [PALPATE, *command(kind, used, disk, folder)],
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
        ids = [int(servo.dxl_id) for finger in load_rig(rig).fingers for servo in finger.servos.values()]
        on = torques(ports["mock://bus"], ids)
    last = (done.stderr.strip().splitlines() or [""])[-1]
    good = on == [[0, 0]] * len(ids) and "Traceback" not in done.stderr and done.returncode == 5
    print(
        f"{kind} {seed}: room {room}, {time.monotonic() - begin:.1f} s, exit code {done.returncode}, torque "
        f"{[value for value, _ in on]}, {last[-150:]}",
        flush=True,
    )
    return good


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--disk", type=Path, required=True)
    parser.add_argument("--kind", choices=("identify", "picture", "check", "calibrate"), default="identify")
    parser.add_argument("--runs", type=int, default=20)
    asked = parser.parse_args()
    good = sum(one(asked.kind, seed, asked.disk.resolve()) for seed in range(asked.runs))
    print(f"{good} of {asked.runs} as they should be")
    return 0 if good == asked.runs else 1


if __name__ == "__main__":
    sys.exit(main())
