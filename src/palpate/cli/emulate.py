"""`palpate emulate`: the emulated devices on pseudo-terminals or TCP ports, in real time, for any program."""

import json
from pathlib import Path
from typing import Annotated

import typer

from palpate.base.errors import InputError
from palpate.cli.options import ObjectsOption, RigOption, SceneOption, SeedOption

__all__ = ["emulate"]

_LOOPBACK = "127.0.0.1"
_LATENCY_MS = 100  # two processes share the computer: the devices' may have to wait for its turn


def emulate(
    rig: RigOption = None,
    objects: ObjectsOption = None,
    scene: SceneOption = None,
    seed: SeedOption = 0,
    pty: Annotated[
        bool,
        typer.Option("--pty/--tcp", help="Serve on pseudo-terminals, or on TCP ports of this computer."),
    ] = True,
    tcp_port: Annotated[
        int | None,
        typer.Option(
            "--tcp-port", min=1, max=65535, help="With --tcp: the first port; any free ones without it."
        ),
    ] = None,
    host: Annotated[
        str | None,
        typer.Option("--host", help="With --tcp: this computer's address to serve on; 127.0.0.1 without it."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--for", min=0.0, help="End after this many seconds.")
    ] = None,
    rig_out: Annotated[
        Path | None, typer.Option("--rig-out", help="Write a rig file that uses the served ports.")
    ] = None,
) -> None:
    """Serve the emulated devices to other programs; print the ports as JSON, then serve until interrupted."""
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.output_places import rig_files, scene_files
    from palpate.config import shipped_rig
    from palpate.jobs.rig import open_rig

    if pty and tcp_port is not None:
        raise InputError("--tcp-port is for --tcp; pseudo-terminals have no port numbers")
    if pty and host is not None:
        raise InputError("--host is for --tcp; pseudo-terminals have no address")
    if host is not None and not host.startswith("127."):
        typer.echo(
            f"warning: whoever reaches {host} over the network can drive these devices, unasked",
            err=True,
        )
    opened = open_rig(rig, seed=seed, calibration=False)
    check_places({"--rig-out": rig_out}, {**rig_files(rig), "--objects": objects, **scene_files(scene)})
    served = opened.serve(objects, scene=scene, pty=pty, tcp_port=tcp_port or 0, host=host or _LOOPBACK)
    with served as service:
        if rig_out is not None:
            text = (rig or shipped_rig()).read_text(encoding="utf-8")
            write_text(rig_out, _with_ports(text, service.paths))
        typer.echo(json.dumps({"format": "palpate/ports@1", "ports": service.paths}))
        service.wait(seconds)


def _with_ports(text: str, paths: dict[str, str]) -> str:
    """The rig file with its mock ports replaced and without its emulation table; comments are kept."""
    import tomlkit

    document = tomlkit.parse(text)
    document.pop("emulation", None)
    bus = document["bus"]
    bus["latency_ms"] = _LATENCY_MS
    bus["port"] = paths[str(bus["port"])]
    for finger in document["fingers"]:
        finger["array"]["port"] = paths[str(finger["array"]["port"])]
    return tomlkit.dumps(document)
