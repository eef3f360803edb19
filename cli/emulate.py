"""`palpate emulate`: the emulated devices on pseudo-terminals or TCP ports, in real time, for any program."""

import json
from pathlib import Path

import tomlkit
import typer

from palpate.api.rig import open_rig
from palpate.config import shipped_rig
from palpate.errors import InputError
from palpate.files.writing import write_text

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
    opened = open_rig(rig, seed=seed, calibration=False)
    with opened.serve(objects, scene=scene, pty=pty, tcp_port=tcp_port or 0) as service:
        if rig_out is not None:
            text = (rig or shipped_rig()).read_text(encoding="utf-8")
            write_text(rig_out, _with_ports(text, service.paths))
        typer.echo(json.dumps({"format": "palpate/ports@1", "ports": service.paths}))
        service.wait(seconds)
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
