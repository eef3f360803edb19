"""`palpate stop`: torque off on every servo, now, also beside a palpate that is using the port."""

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import typer
from rich.console import Console

from palpate.cli.terminal import Terminal
from palpate.config.results import to_json
from palpate.config.stop_result import StopOut, StoppedServoOut
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.torque import broadcast_torque_off, confirm_torque_off
from palpate.drivers.transport.port import PortTaken
from palpate.errors import DeviceError, InputError, counted
from palpate.rig.diagnostics.bus_selection import BusEndpoint, find_endpoint, list_servos

__all__ = ["run_stop", "stop"]

_USUAL_BAUDRATE = 1_000_000
_TIMES = 10  # in a row, before anybody is asked
_PATIENCE_S = 3.0  # for another program to give up the port


def run_stop(*, rig: Path | None, port: str | None, baudrate: int | None, json: bool) -> int:
    """Stop and tell; returns the exit code: 0 only if every servo has confirmed."""
    if rig is None and port is None:
        raise InputError("say which servos to stop: --rig FILE, or --port PORT")
    if baudrate is not None and baudrate <= 0:
        raise InputError(f"--baud {baudrate}: a baud rate is positive, such as {_USUAL_BAUDRATE}")
    place = find_endpoint(rig, port)
    out = stop(place, baudrate or place.baudrate or _USUAL_BAUDRATE)
    if json:
        typer.echo(to_json(out))
    _show(out, Terminal(stderr=json, soft_wrap=True))
    return 0 if out.confirmed else 3


def stop(place: BusEndpoint, baudrate: int) -> StopOut:
    """Tell everybody at once, then ask each; raises DeviceError if the port cannot be opened at all."""
    begin = place.clock.now()
    told = 0
    while True:
        with closing(_bus(place, baudrate, shared=True)) as bus:
            broadcast_torque_off(bus, place.clock, _TIMES)
            told += _TIMES
        try:
            bus = _bus(place, baudrate, shared=False)
        except PortTaken:
            if place.clock.now() - begin < _PATIENCE_S:
                continue
            return _out(place, baudrate, told, None)
        with closing(bus):
            owned = [servo.dxl_id for servo in list_servos(place.rig)]
            return _out(
                place, baudrate, told, confirm_torque_off(bus, sorted({*owned, *bus.broadcast_ping()}))
            )


def _bus(place: BusEndpoint, baudrate: int, *, shared: bool) -> Bus:
    return Bus(place.open(baudrate, shared=shared), place.clock, baudrate, latency_s=place.latency_s)


def _out(
    place: BusEndpoint, baudrate: int, told: int, problems: Mapping[int, DeviceError | None] | None
) -> StopOut:
    owners = {servo.dxl_id: servo.owner for servo in list_servos(place.rig)}
    servos = tuple(
        StoppedServoOut(
            id=dxl_id,
            owner=owners.get(dxl_id),
            off=problem is None,
            problem=None if problem is None else str(problem),
        )
        for dxl_id, problem in (problems or {}).items()
    )
    return StopOut(
        port=place.port,
        emulated=place.emulated,
        baudrate_bps=baudrate,
        told=told,
        taken=problems is None,
        confirmed=bool(servos) and all(servo.off for servo in servos),
        servos=servos,
    )


def _show(out: StopOut, console: Console) -> None:
    def say(text: str, style: str) -> None:
        console.print(text, style=style, highlight=False, markup=False)

    where = f"on {out.port} at {out.baudrate_bps} baud{' (emulated)' if out.emulated else ''}"
    off = [servo for servo in out.servos if servo.off]
    ids = ", ".join(str(servo.id) for servo in off)
    if off:
        say(f"torque is off, confirmed: {counted(len(off), 'servo', 'servos')} {where} ({ids})", "green")
    for servo in out.servos:
        if not servo.off:
            name = f"servo {servo.id}" + (f" ({servo.owner})" if servo.owner else "")
            say(f"NOT confirmed: {name}: {servo.problem}", "bold red")
    if out.taken:
        say(
            f"NOT confirmed: another program is using {out.port}; every servo {where} was told "
            f"{out.told} times to switch torque off",
            "bold red",
        )
    elif not out.servos:
        say(f"NOT confirmed: no servo answers {where}; is it the right port and baud rate?", "bold red")
    if not out.confirmed:
        say("if anything may still move, cut the servos' power", "bold red")
