"""`palpate emulate --tcp`: the same devices on TCP ports, for commands that take the rig for a real one."""

import socket
from pathlib import Path

import pytest
from command import run

from palpate.config import load_rig
from palpate.testing import served

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
        scanned = run("scan", "--rig", "served.toml", "--ids", "11-32", "--json", cwd=tmp_path, timeout_s=60)
        checked = run("check", "--rig", "served.toml", "--json", cwd=tmp_path, timeout_s=60)
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
        with socket.create_connection(("127.0.0.1", first), timeout=5) as client:
            # the manual's ping to all: id 11 answers first, model number 1020 is 0x03FC
            client.sendall(bytes.fromhex("FF FF FD 00 FE 03 00 01 31 42"))
            answer = b""
            while len(answer) < 14:
                answer += client.recv(14 - len(answer))
            assert answer[:11] == bytes.fromhex("FF FF FD 00 0B 07 00 55 00 FC 03")
        taken = run("emulate", "--tcp", "--tcp-port", first, "--for", 0, cwd=tmp_path)
    assert (taken.code, taken.out) == (3, "")
    assert f"no TCP port 127.0.0.1:{first} for an emulated device: address already in use" in taken.err


def test_port_numbers_are_for_tcp(tmp_path: Path) -> None:
    done = run("emulate", "--tcp-port", 5000, "--for", 0, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "--tcp-port is for --tcp" in done.err


def test_a_rig_that_is_not_served_any_more(tmp_path: Path) -> None:
    done = run("emulate", "--tcp", "--for", 0, "--rig-out", "served.toml", cwd=tmp_path)
    assert done.code == 0
    bus = done.json["ports"]["mock://bus"]
    checked = run("check", "--rig", "served.toml", cwd=tmp_path)
    assert checked.code == 3
    assert f"port {bus} does not exist" in checked.err
    assert "connection refused" in checked.err


@pytest.mark.realtime
def test_another_address_of_this_computer(tmp_path: Path) -> None:
    with served(tmp_path, "--tcp", "--host", "127.0.0.2") as (_, told):
        url = told["ports"]["mock://bus"]
        assert url.startswith("socket://127.0.0.2:")
        port = int(url.rpartition(":")[2])
        socket.create_connection(("127.0.0.2", port), timeout=5).close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=5)


def test_an_address_that_this_computer_does_not_have_is_one_line(tmp_path: Path) -> None:
    ended = run("emulate", "--tcp", "--host", "203.0.113.7", cwd=tmp_path)
    assert (ended.code, ended.out) == (3, "")
    warning, error = ended.err.splitlines()
    assert warning == "warning: whoever reaches 203.0.113.7 over the network can drive these devices, unasked"
    assert error.startswith("device error: no TCP port 203.0.113.7:0 for an emulated device: ")
    assert run("emulate", "--host", "127.0.0.1", cwd=tmp_path).code == 2
