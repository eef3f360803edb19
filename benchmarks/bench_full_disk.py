"""Full disks: commands on emulated devices behind pseudo-terminals, in real time, with a disk that fills up.

    mkdir small && sudo mount -t tmpfs -o size=2M tmpfs small
    python benchmarks/bench_full_disk.py --disk small --runs 20                # identify, its log on the disk
    python benchmarks/bench_full_disk.py --disk small --runs 5 --kind picture  # the picture on a full disk
    … --kind check                       # a disc is on the table, standard output on the full disk
    … --kind calibrate                   # one finger, in this process: the run record on the full disk

Leaves as much room as the seed draws, runs the command, and asks every servo for its Torque Enable with
another client, the vendor's SDK 3.8 as `make test` installs it. Exit code 1 if any servo has its torque on,
or a run ends otherwise than with one line and exit code 5.
"""

import argparse
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.errors import OutputError
from palpate.config import load_rig
from palpate.config.calibration_file import load_references
from palpate.config.loading import shipped_references
from palpate.config.writers import calibration_toml
from palpate.rig.bench import environment
from palpate.rig.commissioning.calibration_run import CalibrationJob, RunRecordFile, calibrate, rig_connector
from palpate.rig.emulated.scene import ReferencePlacer
from support.benches.calibration_files import bench_calibration
from support.benches.session import emulated_session
from support.benches.touched_references import FRESH

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (0, 4096, 65536, 400_000, 900_000, 1_500_000)
PALPATE = Path(sys.executable).with_name("palpate")
OTHER_CLIENT = """
import json, sys
from dynamixel_sdk import PacketHandler, PortHandler
port = PortHandler(sys.argv[1]); port.openPort(); port.setBaudRate(1000000)
packets = PacketHandler(2.0)
print(json.dumps([packets.read1ByteTxRx(port, int(i), 64)[:2] for i in sys.argv[2:]]))
"""


@contextmanager
def served(
    rig: Path, seed: int, folder: Path, scene: Sequence[str | Path]
) -> Iterator[tuple[Path, dict[str, str]]]:
    """The rig's devices on pseudo-terminals: the rig file for them, and their ports."""
    out = folder / "served.toml"
    process = subprocess.Popen(
        [PALPATE, "emulate", "--pty", "--rig", rig, "--rig-out", out, "--seed", str(seed), *scene],
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
        case _:
            return ["check", "--touch", "--yes", "--json", "--rig", rig]


def disc_scene(folder: Path) -> list[str | Path]:
    """Options that put the disc of the references in the table's middle."""
    turns = [2 * math.pi * k / 180 for k in range(180)]
    outline = [[25.0 * math.cos(turn), 25.0 * math.sin(turn)] for turn in turns]
    objects = {"format": "palpate/objects@1", "units": "mm"}
    objects["objects"] = [{"name": "disc", "outline": outline, "height": 40.0}]  # type: ignore[assignment]
    (folder / "disc.json").write_text(json.dumps(objects), encoding="utf-8")
    scene = {"format": "palpate/scene@1", "object": "disc", "state": "flat", "objects": "disc.json"}
    scene["configuration"] = {"x": 0.0, "y": 0.0, "theta": 0.0}  # type: ignore[assignment]
    (folder / "scene.json").write_text(json.dumps(scene), encoding="utf-8")
    return ["--scene", folder / "scene.json"]


def calibrated_here(seed: int, disk: Path) -> bool:
    """Calibrate the actuators of one finger with the run record on the full disk; whether torque ends off."""
    rig = FRESH.model_copy(update={"fingers": FRESH.fingers[:1]})
    session = emulated_session(seed=seed, rig=rig, empty=True)
    fill(disk, 0)
    job = CalibrationJob(
        rig, "0" * 64, load_references(shipped_references()), ("actuators",), 0.999, datetime.now(UTC), None
    )
    table = ReferencePlacer(session.bench, seed)
    connect = rig_connector(environment(session.bench_rig), table, lambda _: None)
    said = "nothing"
    try:
        calibrate(job, connect, RunRecordFile(disk / "record.json"), lambda _: None)
    except OutputError as error:
        said = str(error)
    on = session.torque()
    print(f"calibrate {seed}: {said}, torque {on}, {session.clock.now():.0f} s of rig time", flush=True)
    return "No space left" in said and not any(on.values())


def one(kind: str, seed: int, disk: Path) -> bool:
    """One run; whether all was as it should be."""
    for item in disk.iterdir():
        shutil.rmtree(item) if item.is_dir() else item.unlink()
    if kind == "calibrate":
        return calibrated_here(seed, disk)
    rig = ROOT / "src" / "palpate" / "config" / "rigs" / "bench.toml"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = disc_scene(folder) if kind == "check" else []
        with served(rig, seed, folder, scene) as (used, ports):
            return commanded(kind, seed, disk, folder, rig, used, ports)


def commanded(
    kind: str, seed: int, disk: Path, folder: Path, rig: Path, used: Path, ports: dict[str, str]
) -> bool:
    """Run the command against served devices, and ask these."""
    if kind == "check":
        text = calibration_toml(bench_calibration(load_rig(rig), seed))
        used.with_suffix(".calibration.toml").write_text(text, encoding="utf-8")
    fill(disk, random.Random(seed).choice(ROOMS) if kind == "identify" else 0)
    begin = time.monotonic()
    with (disk / "out.json" if kind == "check" else Path(os.devnull)).open("w") as out:
        done = subprocess.run(
            [PALPATE, *command(kind, used, disk, folder)],
            stdout=out,
            input="\n\n\n",
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    ids = [int(servo.dxl_id) for finger in load_rig(rig).fingers for servo in finger.servos.values()]
    on = torques(ports["mock://bus"], ids)
    last = (done.stderr.strip().splitlines() or [""])[-1]
    print(
        f"{kind} {seed}: {time.monotonic() - begin:.1f} s, exit code {done.returncode}, torque "
        f"{[value for value, _ in on]}, {last[-150:]}",
        flush=True,
    )
    return on == [[0, 0]] * len(ids) and "Traceback" not in done.stderr and done.returncode == 5


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
