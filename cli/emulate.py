"""`palpate emulate`: the emulated devices on pseudo-terminals or TCP ports, in real time, for any program."""

import json
import threading
from importlib.resources.abc import Traversable
from pathlib import Path

import tomlkit
import typer

from palpate.config import load_objects, load_rig, load_scene, shipped_objects, shipped_rig
from palpate.drivers.emulators.serve import serve_pty, serve_tcp
from palpate.drivers.transport.clock import MonotonicClock
from palpate.errors import InputError
from palpate.files.writing import write_text
from palpate.rig.bench import place
from palpate.rig.emulated.devices import emulate

__all__ = ["run_emulate"]

_LATENCY_MS = 100  # two processes share the computer: the devices' may have to wait for its turn


def run_emulate(
    *,
    rig: Path | None,
    objects: Path | None,
    scene: Path | None,
    seed: int,
    seconds: float | None,
    rig_out: Path | None,
    pty: bool = True,
    tcp_port: int | None = None,
) -> int:
    """Serve until interrupted or for `seconds`; returns the exit code.

    On pseudo-terminals or, without `pty`, on TCP ports from `tcp_port` on; None: on any free ones.
    """
    if pty and tcp_port is not None:
        raise InputError("--tcp-port is for --tcp; pseudo-terminals have no port numbers")
    source: Path | Traversable = rig or shipped_rig()
    rig_file = load_rig(source)
    if rig_file.emulation is None:
        raise InputError(f'rig "{rig_file.name}" has no [emulation] table: there is nothing to emulate')
    given_scene = None if scene is None else load_scene(scene)
    placement = place(rig_file, load_objects(objects or shipped_objects()), given_scene, seed)
    emulated = emulate(rig_file, placement, seed)
    done = threading.Event()
    clock = MonotonicClock()
    service = (
        serve_pty(emulated.devices, clock, done)
        if pty
        else serve_tcp(emulated.devices, clock, done, tcp_port or 0)
    )
    with service:
        if rig_out is not None:
            write_text(rig_out, _with_ports(source.read_text(encoding="utf-8"), service.paths))
        typer.echo(json.dumps({"format": "palpate/ports@1", "ports": service.paths}))
        done.wait(seconds)
        if service.failure is not None:
            raise service.failure
    return 0


def _with_ports(text: str, paths: dict[str, str]) -> str:
    """The rig file with its mock ports replaced and without its emulation table; comments are kept."""
    document = tomlkit.parse(text)
    document.pop("emulation", None)
    bus = document["bus"]
    bus["latency_ms"] = _LATENCY_MS
    bus["port"] = paths[str(bus["port"])]
    for finger in document["fingers"]:
        finger["array"]["port"] = paths[str(finger["array"]["port"])]
    return tomlkit.dumps(document)
