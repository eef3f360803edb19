"""The emulated rig on a pseudo-terminal and on TCP."""

import json
import math
import re
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from palpate.config import load_objects, load_rig
from palpate.rig.bench import choose_placements
from palpate.rig.emulated.scene import Placement
from palpate.testing import served
from support.benches.rigs import firm_rig, quick_bench, small
from support.commands.command import PATIENCE_S, Here, log_events, run
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# `palpate emulate --pty` in its own process: for the unmodified SDK, and for `identify` in real time.

CLIENT = """
import json, sys, time
import dynamixel_sdk
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

port, packets = PortHandler(sys.argv[1]), PacketHandler(2.0)
assert port.openPort() and port.setBaudRate(1_000_000)

def patiently(call, *args):  # the SDK waits 34 ms for an answer; a busy computer may take longer
    for _ in range(10):
        answer = call(*args)
        if answer[-2] == COMM_SUCCESS:
            break
        time.sleep(0.2)
        port.readPort(4096)  # the answer that came late
    assert answer[-2:] == (COMM_SUCCESS, 0), answer
    return answer[0]

models = [patiently(packets.ping, port, dxl_id) for dxl_id in (11, 12, 21, 22, 31, 32)]
assert packets.ping(port, 13)[1] != COMM_SUCCESS
start = patiently(packets.read4ByteTxRx, port, 11, 132)
patiently(packets.write4ByteTxRx, port, 11, 112, 150)
patiently(packets.write1ByteTxRx, port, 11, 64, 1)
patiently(packets.write4ByteTxRx, port, 11, 116, 2600)
seen = [start]
end = time.monotonic() + 600
while time.monotonic() < end and abs(seen[-1] - 2600) > 3:
    seen.append(patiently(packets.read4ByteTxRx, port, 11, 132))
patiently(packets.write1ByteTxRx, port, 11, 64, 0)
port.closePort()
json.dump({"models": models, "start": start, "seen": seen, "sdk": dynamixel_sdk.__file__}, sys.stdout)
"""


def drawn(rig: Path, objects: Path, seed: int) -> Placement:
    """What the emulator puts on its table for a seed."""
    (placement,) = choose_placements(load_rig(rig), load_objects(objects), None, seed)
    return placement


@pytest.mark.realtime
@pytest.mark.slow
def test_the_vendors_sdk_moves_a_servo_from_its_own_process(tmp_path: Path) -> None:
    with served(tmp_path, "--pty", "--seed", 7) as (process, told):
        assert told["format"] == "palpate/ports@1"
        assert set(told["ports"]) == {"mock://bus", "mock://f1", "mock://f2", "mock://f3"}
        client = subprocess.run(
            [sys.executable, "-c", CLIENT, told["ports"]["mock://bus"]],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        assert client.returncode == 0, client.stderr
        assert process.poll() is None
    assert process.returncode == 130
    answer = json.loads(client.stdout)
    assert answer["models"] == [1020] * 6
    assert abs(answer["start"] - 2048) < 5
    assert abs(answer["seen"][-1] - 2600) <= 3
    assert len({position for position in answer["seen"] if answer["start"] + 10 < position < 2590}) > 5


@pytest.mark.realtime
@pytest.mark.slow
def test_identify_in_real_time_over_the_ptys_and_its_replay(tmp_path: Path) -> None:
    """The rig file that the emulator writes has no emulation in it: to the host, the rig is a real one."""
    rig, parts = quick_bench(tmp_path)
    rig.write_text(small(firm_rig()))  # as fast, and as often looked at, as the shipped bench
    words = ("--rig", rig, "--objects", parts, "--seed", 5, "--rig-out", "real.toml")
    with served(tmp_path, "--pty", *words) as (process, told):
        text = (tmp_path / "real.toml").read_text(encoding="utf-8")
        assert "[emulation]" not in text
        assert "mock://" not in text
        assert all(port in text for port in told["ports"].values())
        assert text.startswith("#"), "comments are kept"
        done = run("identify", "--rig", "real.toml", "--objects", parts, "--json", cwd=tmp_path)
        assert process.poll() is None
    assert done.code == 0, done.err
    answer = done.json
    truth = drawn(rig, parts, 5)
    assert (answer["verdict"], answer["object"]) == ("identified", truth.model.name)
    assert answer["emulated"] is True, "the arrays say so"
    assert answer["truth"] is None, "nobody told the host"
    assert answer["rig_seconds"] > 5.0
    assert answer["rig_seconds"] < answer["wall_seconds"] + 10.0, "real time"
    assert answer["symmetry_order"] == 1
    turns = round((answer["configuration"]["theta"] - truth.theta_rad) / (2 * math.pi))
    pose = {"x": truth.x_mm, "y": truth.y_mm, "theta": truth.theta_rad + 2 * math.pi * turns}
    for key, value in pose.items():
        lo, hi = answer["bounds"][key]
        assert lo <= value <= hi
    assert re.fullmatch(r"palpate-sessions/identify-\d{8}-\d{6}", answer["session"])
    assert log_events(tmp_path / answer["session"] / "session.jsonl.zst")[-1]["how"] == "done"
    again = run("replay", answer["session"], "--json", cwd=tmp_path)
    assert again.code == 0, again.out + again.err
    assert (again.json["same"], again.json["end"]) == (True, {"how": "done", "message": None})
    assert [again.json[key] == answer[key] for key in ("verdict", "object", "state")] == [True] * 3
    assert again.json["sent_bytes"] > 2000


@pytest.mark.realtime
def test_it_ends_by_itself_after_the_time_it_was_given(here: Here) -> None:
    begin = time.monotonic()
    done = here("emulate", "--for", 0.5, "--rig-out", "real.toml")
    assert done.code == 0
    assert done.err == ""
    assert time.monotonic() - begin > 0.5
    # The terminals' names may be somebody else's by now: nothing here may open them.
    assert set(done.json["ports"]) == {"mock://bus", "mock://f1", "mock://f2", "mock://f3"}


@pytest.mark.realtime
def test_a_scene_on_the_served_rig(tmp_path: Path, here: Here) -> None:
    scene = {"format": "palpate/scene@1", "object": "no-such", "configuration": {"x": 0, "y": 0, "theta": 0}}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    done = here("emulate", "--scene", "scene.json", "--for", 0)
    assert (done.code, done.out) == (2, "")
    assert "no-such" in done.err


# ----------------------------------------------------------------------------------------------------
# `palpate emulate --tcp`: the same devices on TCP ports, for commands that take the rig for a real one.

IDS = [11, 12, 21, 22, 31, 32]


def free_port() -> int:
    """The first of four neighbouring ports that are free now."""
    for first in range(20_100, 60_000, 100):
        held = [socket.socket() for _ in range(4)]
        try:
            for offset, one in enumerate(held):
                one.bind(("127.0.0.1", first + offset))
        except OSError:
            continue
        finally:
            for one in held:
                one.close()
        return first
    raise AssertionError("no free ports")


@pytest.mark.realtime
@pytest.mark.slow
def test_scan_and_check_over_tcp(tmp_path: Path) -> None:
    with served(tmp_path, "--tcp", "--seed", 7, "--rig-out", "served.toml") as (process, told):
        assert told["format"] == "palpate/ports@1"
        assert set(told["ports"]) == {"mock://bus", "mock://f1", "mock://f2", "mock://f3"}
        assert all(url.startswith("socket://127.0.0.1:") for url in told["ports"].values())
        rig = load_rig(tmp_path / "served.toml")
        assert rig.bus.port == told["ports"]["mock://bus"]
        assert rig.emulation is None
        scanned = run("scan", "--rig", "served.toml", "--ids", "11-32", "--json", cwd=tmp_path)
        checked = run("check", "--rig", "served.toml", "--json", cwd=tmp_path)
        assert process.poll() is None
    assert scanned.code == 0, scanned.err
    assert scanned.json["baudrates_bps"] == [1_000_000], "a socket has no rate to look for"
    assert [servo["id"] for servo in scanned.json["servos"]] == IDS
    assert checked.code == 0, checked.err
    assert checked.json["well"]
    assert checked.json["emulated"], "the arrays say so"
    assert [array["rate_hz"] > 200 for array in checked.json["arrays"]] == [True] * 3


@pytest.mark.realtime
def test_given_ports_and_a_client_that_knows_nothing_of_palpate(tmp_path: Path) -> None:
    first = free_port()
    with served(tmp_path, "--tcp", "--tcp-port", first) as (_, told):
        urls = [f"socket://127.0.0.1:{first + k}" for k in range(4)]
        assert list(told["ports"].values()) == urls
        with socket.create_connection(("127.0.0.1", first), timeout=PATIENCE_S) as client:
            # the manual's ping to all: id 11 answers first, model number 1020 is 0x03FC
            client.sendall(bytes.fromhex("FF FF FD 00 FE 03 00 01 31 42"))
            answer = b""
            while len(answer) < 14:
                answer += client.recv(14 - len(answer))
            assert answer[:11] == bytes.fromhex("FF FF FD 00 0B 07 00 55 00 FC 03")
        taken = run("emulate", "--tcp", "--tcp-port", first, "--for", 0, cwd=tmp_path)
    assert (taken.code, taken.out) == (3, "")
    assert f"no TCP port 127.0.0.1:{first} for an emulated device: address already in use" in taken.err


def test_port_numbers_are_for_tcp(here: Here) -> None:
    done = here("emulate", "--tcp-port", 5000, "--for", 0)
    assert (done.code, done.out) == (2, "")
    assert "--tcp-port is for --tcp" in done.err


def test_a_rig_that_is_not_served_any_more(here: Here) -> None:
    done = here("emulate", "--tcp", "--for", 0, "--rig-out", "served.toml")
    assert done.code == 0
    bus = done.json["ports"]["mock://bus"]
    checked = here("check", "--rig", "served.toml")
    assert checked.code == 3
    assert f"port {bus} does not exist" in checked.err
    assert "connection refused" in checked.err


@pytest.mark.parametrize(("rig", "ports"), [("contact", ["#f1", "#f2", "#f3"]), ("current", [])])
def test_the_rig_file_of_fingers_that_share_a_connection_or_have_none(
    here: Here, tmp_path: Path, rig: str, ports: list[str]
) -> None:
    done = here("emulate", "--rig", EXAMPLES / f"{rig}-rig.toml", "--for", 0, "--rig-out", "served.toml")
    assert done.code == 0, done.err
    written = load_rig(tmp_path / "served.toml")
    shared = done.json["ports"].get("mock://sources")
    assert written.bus.port == done.json["ports"]["mock://bus"]
    arrays = [finger.array.port for finger in written.fingers if finger.array.has_device]
    assert arrays == [f"{shared}{mark}" for mark in ports]


@pytest.mark.realtime
def test_another_address_of_this_computer(tmp_path: Path) -> None:
    with served(tmp_path, "--tcp", "--host", "127.0.0.2") as (_, told):
        url = told["ports"]["mock://bus"]
        assert url.startswith("socket://127.0.0.2:")
        port = int(url.rpartition(":")[2])
        socket.create_connection(("127.0.0.2", port), timeout=PATIENCE_S).close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)


def test_an_address_that_this_computer_does_not_have_is_one_line(here: Here) -> None:
    ended = here("emulate", "--tcp", "--host", "203.0.113.7")
    assert (ended.code, ended.out) == (3, "")
    warning, error = ended.err.splitlines()
    assert warning == "warning: whoever reaches 203.0.113.7 over the network can drive these devices, unasked"
    assert error.startswith("device error: no TCP port 203.0.113.7:0 for an emulated device: ")
    assert here("emulate", "--host", "127.0.0.1").code == 2
