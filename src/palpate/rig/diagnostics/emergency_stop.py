"""Emergency stop: torque off on every servo of a bus, also beside a program that is using the port."""

from collections.abc import Mapping
from contextlib import closing

from palpate.base.errors import DeviceError
from palpate.config.stop_result import StopOut, StoppedServoOut
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.torque import broadcast_torque_off, confirm_torque_off
from palpate.drivers.transport.port import PortTaken
from palpate.rig.diagnostics.bus_selection import BusEndpoint, list_servos

__all__ = ["stop_all"]

_TIMES = 10  # in a row, before any servo is asked
_PATIENCE_S = 3.0  # for another program to give up the port


def stop_all(place: BusEndpoint, baudrate: int) -> StopOut:
    """Broadcast torque off, then confirm it with every servo; DeviceError if the port cannot be opened."""
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
    return StopOut.of(
        place,
        baudrate_bps=baudrate,
        told=told,
        taken=problems is None,
        confirmed=bool(servos) and all(servo.off for servo in servos),
        servos=servos,
    )
