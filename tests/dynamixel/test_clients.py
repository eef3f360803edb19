"""Clients of others on emulated servos, and ours on a device of others."""

import importlib.util
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from palpate.drivers.dynamixel import Bus, PortFailed, Servo, disable_torque
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE, Item
from palpate.drivers.dynamixel.errors import NotAnswering
from palpate.drivers.dynamixel.models import model_by_name
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port
from palpate.testing import served
from support.commands.command import PATIENCE_S
from support.commands.repository import EXAMPLES, ROOT
from support.devices.servo_wire import BAUD, Served, served_servos
from support.devices.vendor_device import compiled_device, vendor_device

# ----------------------------------------------------------------------------------------------------
# Programs on other people's drivers, unmodified and in processes of their own, move emulated servos.
#
# The programs are in `tests/clients`. What they do: ping, read, write, sync read, sync write, move servos,
# and what else the driver offers. Then our own bus on such a port, when it goes away.

CLIENTS = ROOT / "tests" / "clients"
OTHER = Path(sys.prefix) / "other"  # where `make` puts versions that cannot live beside the one we use
IDS = ("5", "6", "7")
GOALS = {5: 2600, 6: 1500, 7: 2300}


@dataclass(frozen=True)
class Foreign:
    """A driver that others wrote: its distribution and version, our program for it, where it is installed."""

    name: str
    version: str
    module: str
    program: str
    folder: Path | None = None

    def __str__(self) -> str:
        return f"{self.name} {self.version}"

    def run(self, path: str, task: str) -> dict[str, Any]:
        """Run the program on a port; returns what it told."""
        self.check_installed()
        environment = dict(os.environ)
        if self.folder is not None:
            environment["PYTHONPATH"] = str(self.folder)
        client = subprocess.run(
            [sys.executable, str(CLIENTS / self.program), path, task],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            env=environment,
        )
        assert client.returncode == 0, client.stderr
        told: dict[str, Any] = json.loads(client.stdout)
        assert f"{told.pop('version')}.".startswith(f"{self.version}.")
        return told

    def check_installed(self) -> None:
        if self.folder is None:
            there = importlib.util.find_spec(self.module) is not None
        else:
            there = (self.folder / self.module).is_dir()
        if not there:
            pytest.fail(f"{self} is not installed; `make .venv/.installed-dev` installs it", pytrace=False)


SDK_NOW = Foreign("dynamixel-sdk", "4", "dynamixel_sdk", "sdk_client.py")
SDK_THEN = Foreign("dynamixel-sdk", "3.8.4", "dynamixel_sdk", "sdk_client.py", OTHER / "dynamixel-sdk-3.8.4")
RUSTYPOT = Foreign("rustypot", "1", "rustypot", "rustypot_client.py")
LEROBOT = Foreign("lerobot", "0.4.4", "lerobot", "lerobot_client.py", OTHER / "lerobot")
ORCA = Foreign("orca-core", "0.12.0", "orca_core", "orca_core_client.py", OTHER / "orca_core")
each_sdk = pytest.mark.parametrize("sdk", [SDK_NOW, SDK_THEN], ids=str)


def check_at_goals(served: Served) -> None:
    """The shafts themselves are where they were told to go."""
    ticks = served.ticks()
    assert {dxl_id: abs(ticks[dxl_id] - goal) <= 4 for dxl_id, goal in GOALS.items()} == dict.fromkeys(
        GOALS, True
    ), ticks


def torque_is_off(served: Served) -> bool:
    """Of all servos, as they say themselves."""
    bus = Bus(open_port(served.path, BAUD), MonotonicClock(), BAUD, latency_s=0.1)
    try:
        return not any(bus.read(dxl_id, TORQUE_ENABLE) for dxl_id in GOALS)
    finally:
        bus.close()


@pytest.mark.realtime
@each_sdk
def test_unmodified_sdk(sdk: Foreign) -> None:
    with served_servos([5, 6, 7]) as served:
        told = sdk.run(served.path, "basics")
        assert told["ping"] == [[1020, 0, 0]] * 3
        assert told["nobody"] is True
        assert told["everybody"] == {dxl_id: [1020, 46] for dxl_id in IDS}
        assert told["read"] == [2048, 0, 0]
        assert told["write"] == [0, 0]
        assert told["read back"] == [150, 0, 0]
        assert told["read only"] == [0, 7], "Access Error"
        assert told["sync write"] == dict.fromkeys(IDS, 200)
        assert told["torque"] == dict.fromkeys(IDS, 1)
        last = told["moved"][-1]
        assert all(abs(last[str(dxl_id)] - goal) <= 3 for dxl_id, goal in GOALS.items())
        assert told["bulk read"] == {"5": 120, "6": 30, "7": 200}
        assert told["bulk write"] == {"5": 0, "6": 99}
        assert told["registered"] == [0, 0]
        assert told["before action"]["7"] > 2200
        assert abs(told["moved by action"][-1]["7"] - 2048) <= 3
        assert told["reboot"] == [0, 0]
        ticks = served.ticks()
        assert abs(ticks[6] - 1500) <= 4, ticks
        assert abs(ticks[7] - 2048) <= 4, ticks


@pytest.mark.realtime
def test_unmodified_rustypot() -> None:
    with served_servos([5, 6, 7]) as served:
        told = RUSTYPOT.run(served.path, "basics")
        assert told["ping"] == [True] * 3
        assert told["nobody"] is True
        assert told["everybody"] == dict.fromkeys(IDS, 1020)
        assert told["read"] == [2048, 0]
        assert told["write"] == 0
        assert told["read back"] == [150, 0]
        assert told["read only"] == 7, "Access Error"
        assert told["sync write"] == [200] * 3
        assert told["torque"] == [[1, 0]] * 3
        assert all(
            abs(position - goal) <= 3
            for position, goal in zip(told["moved"][-1], GOALS.values(), strict=True)
        )
        assert told["torque after"] == [[0]] * 3
        assert told["reboot"] is True
        check_at_goals(served)


@pytest.mark.realtime
def test_unmodified_lerobot() -> None:
    with served_servos([5, 6, 7]) as served:
        told = LEROBOT.run(served.path, "basics")
        assert told["everybody"] == dict.fromkeys(IDS, 1020)
        assert told["mode"] == [4] * 3
        assert told["return delay"] == [0] * 3
        assert told["calibration"] == {"pan": 5, "lift": 6, "grip": 7}
        assert told["before"] == {"pan": 2048, "lift": 2048, "grip": 2048}
        assert abs(told["moved"][-1]["pan"] - GOALS[5]) <= 3
        assert told["current"].keys() == told["before"].keys()
        check_at_goals(served)
        assert torque_is_off(served), "disconnecting switches torque off"


@pytest.mark.realtime
def test_unmodified_orca_core() -> None:
    with served_servos([5, 6, 7]) as served:
        told = ORCA.run(served.path, "basics")
        assert told["responding"] == told["after reboot"] == [5, 6, 7]
        assert told["mode"] == [5] * 3
        assert told["ok"] is True
        assert told["temperature"] == [30.0] * 3
        assert told["errors"] == [0] * 3
        check_at_goals(served)
        assert torque_is_off(served)


@pytest.mark.realtime
def test_clients_come_and_go() -> None:
    """Different ones, one after the other on the same port, which each sets up in its own way."""
    with served_servos([5]) as served:
        for client in (RUSTYPOT, SDK_NOW, SDK_THEN, RUSTYPOT):
            assert client.run(served.path, "model") == {"model": 1020}


@pytest.mark.realtime
@each_sdk
def test_fast_reads_of_the_unmodified_sdk(sdk: Foreign) -> None:
    with served_servos([5, 6, 7]) as served:
        told = sdk.run(served.path, "fast")
        assert told["sync"] == dict.fromkeys(IDS, 2048)
        assert told["bulk"] == {"7": 120, "5": 30, "6": 2048}


@pytest.mark.realtime
def test_fast_read_of_unmodified_rustypot() -> None:
    with served_servos([5, 6, 7]) as served:
        assert RUSTYPOT.run(served.path, "fast")["sync"] == dict.fromkeys(IDS, 2048)


@pytest.mark.realtime
def test_a_port_that_goes_away_is_reported_by_name() -> None:
    with served_servos([5]) as served:
        path = served.path
        bus = Bus(open_port(path, BAUD), MonotonicClock(), BAUD, latency_s=0.1)
        assert bus.ping(5).model_number == 1020
        served.service.stop()
        for _ in range(2):
            with pytest.raises(PortFailed, match=f"{path} failed"):
                bus.ping(5)
        assert [type(error) for error in disable_torque(bus, [Servo(bus, 5)])] == [PortFailed]
        bus.close()


# ----------------------------------------------------------------------------------------------------
# Our bus against a device that was not written here: the vendor's library for devices, compiled.

DEVICE_BAUD = 1_000_000
MODEL = model_by_name("XM430-W350", 46)
OWN = range(10)  # addresses that the library keeps for itself
ITEMS = [
    item
    for name, item in MODEL.items.items()
    if item.address not in OWN and not name.startswith(("Indirect", "External"))
]
STUFFED = (0xFFFFFF, 0xFDFFFFFF, 0xFFFDFFFF, 0xFFFFFDFF)  # what looks like a header has to be stuffed


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled_device(tmp_path_factory.mktemp("vendor"))


@pytest.fixture
def bus(program: Path) -> Iterator[Bus]:
    with vendor_device(program, MODEL.number, 46, 7, ITEMS) as path:
        opened = Bus(open_port(path, DEVICE_BAUD), MonotonicClock(), DEVICE_BAUD, latency_s=0.1)
        yield opened
        opened.close()


def value_of(rng: random.Random, item: Item) -> int:
    """Any value of the item's size, often one that has to be stuffed."""
    bits = 8 * item.size
    raw = rng.choice([rng.getrandbits(bits), rng.choice(STUFFED) & (2**bits - 1)])
    return raw - 2**bits if item.signed and raw >> (bits - 1) else raw


@pytest.mark.realtime
def test_it_is_found_and_known(bus: Bus) -> None:
    assert (bus.ping(7).model_number, bus.ping(7).firmware) == (MODEL.number, 46)
    Servo(bus, 7).check()
    with pytest.raises(NotAnswering):
        bus.ping(8)


@pytest.mark.realtime
def test_whatever_is_written_is_read_back(bus: Bus) -> None:
    rng = random.Random(1)
    held: dict[Item, int] = dict.fromkeys(ITEMS, 0)
    for _ in range(400):
        item = rng.choice(ITEMS)
        if rng.random() < 0.5:
            held[item] = value_of(rng, item)
            bus.write(7, item, held[item])
        assert bus.read(7, item) == held[item], item.name
    assert {item: bus.read(7, item) for item in ITEMS} == held
    assert (bus.counts.damaged, bus.counts.retries) == (0, 0)


# ----------------------------------------------------------------------------------------------------
# examples/drive_servos.py as a user runs it, on emulated servos in another process.

EXAMPLE = EXAMPLES / "drive_servos.py"
RIG_IDS = (11, 12, 21, 22, 31, 32)


def drive(port: str, *args: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(EXAMPLE), port, *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def torque(port: str) -> list[int]:
    with open_port(port, 1_000_000) as opened:
        bus = Bus(opened, MonotonicClock(), 1_000_000, latency_s=0.1)
        return [bus.read(dxl_id, TORQUE_ENABLE) for dxl_id in RIG_IDS]


@pytest.mark.realtime
def test_it_moves_one_servo_within_its_range_and_switches_torque_off(tmp_path: Path) -> None:
    with served(tmp_path, "--pty", "--seed", 7) as (_, printed):
        port = printed["ports"]["mock://bus"]
        process = drive(port, "--id", "11", "--by", "0.2")
        out, err = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, err) == (0, "")
        assert [int(dxl_id) for dxl_id in re.findall(r"servo (\d+), XM430-W350", out)] == list(RIG_IDS)
        moved = re.search(r"servo 11: reached at (\S+) rad, from (\S+) rad", out)
        assert moved is not None, out
        assert float(moved[1]) - float(moved[2]) == pytest.approx(0.2, abs=0.04)
        assert torque(port) == [0] * 6

        process = drive(port, "--id", "11", "--by", "0.6")
        out, err = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 1
        assert "outside its range" in err
        assert torque(port) == [0] * 6


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_on_the_way_it_switches_torque_off(tmp_path: Path, number: signal.Signals) -> None:
    with served(tmp_path, "--pty", "--seed", 7) as (_, printed):
        port = printed["ports"]["mock://bus"]
        process = drive(port, "--id", "11", "--by", "0.5")
        assert process.stdout is not None
        for _ in RIG_IDS:
            assert process.stdout.readline()
        time.sleep(0.4)  # half a second of a move that takes one
        process.send_signal(number)
        out, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode != 0
        assert "reached" not in out
        assert torque(port) == [0] * 6
