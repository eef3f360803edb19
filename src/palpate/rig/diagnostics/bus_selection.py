"""Selection of a servo bus: a port by name, a rig file's bus, or the emulated bench."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from serial.serialutil import SerialBase

from palpate.base.errors import InputError
from palpate.config import RigFile, load_rig, shipped_rig
from palpate.drivers.transport.clock import Clock, MonotonicClock
from palpate.drivers.transport.port import open_port
from palpate.rig.bus_latency import bus_latency_s, port_latency_s

__all__ = ["BusEndpoint", "RigServo", "check_dxl_ids", "endpoint_of_rig", "find_endpoint", "list_servos"]


@dataclass(frozen=True, slots=True)
class RigServo:
    """A servo of the rig file: what people call it, and what it should be."""

    owner: str
    dxl_id: int
    model: str


@dataclass(frozen=True, eq=False)
class BusEndpoint:
    """A bus: its port as people call it, how to open it, and what is known of it.

    `rig` is None if only a port was named. `urls`: where ports of an emulated rig really are. `devices`: what
    hangs on them, which lives as long as it is referenced.
    """

    port: str
    clock: Clock
    latency_s: float
    baudrate: int | None = None
    rig: RigFile | None = None
    urls: Callable[[str], str] = str
    devices: object = None

    @property
    def emulated(self) -> bool:
        """Whether nothing real hangs on it, as far as the host can tell."""
        return self.port.startswith("mock://")

    def open(self, baudrate: int, *, shared: bool = False) -> SerialBase:
        """Open the bus's port; raises DeviceError naming it."""
        return open_port(self.urls(self.port), baudrate, shared=shared)

    def open_other(self, port: str, baudrate: int) -> SerialBase:
        """Open another port of the rig; raises DeviceError naming it."""
        return open_port(self.urls(port), baudrate)


def find_endpoint(rig: Path | None, port: str | None) -> BusEndpoint:
    """The bus of a rig file or of a port; without both, that of the shipped emulated rig.

    Raises InputError if both are given.
    """
    if port is None:
        return endpoint_of_rig(load_rig(rig or shipped_rig()))
    if rig is not None:
        raise InputError("a port and a rig exclude each other: the rig file names its port")
    return BusEndpoint(port, MonotonicClock(), port_latency_s(port))


def endpoint_of_rig(rig: RigFile, seed: int = 0) -> BusEndpoint:
    """The bus of a rig; that of an emulated rig is emulated from now on, with devices drawn by `seed`."""
    latency, baudrate = bus_latency_s(rig), rig.bus.baudrate_bps
    if not rig.emulated:
        return BusEndpoint(rig.bus.port, MonotonicClock(), latency, baudrate, rig)
    # half a second of imports, for which an emergency stop of a real rig must not wait
    from palpate.rig.bench import set_up  # noqa: PLC0415

    bench = set_up(rig, None, seed)
    return BusEndpoint(rig.bus.port, bench.clock, latency, baudrate, rig, bench.urls, bench)


def list_servos(rig: RigFile | None) -> tuple[RigServo, ...]:
    """All servos of a rig, the stage's first, each finger's after one another."""
    if rig is None:
        return ()
    stage = [] if rig.stage is None else [RigServo("stage", rig.stage.dxl_id, rig.stage.model)]
    return (
        *stage,
        *(
            RigServo(f"{finger.name} {joint}", servo.dxl_id, servo.model)
            for finger in rig.fingers
            for joint, servo in finger.servos.items()
        ),
    )


def check_dxl_ids(rig: RigFile, dxl_ids: Sequence[int]) -> None:
    """Raise InputError for an id that is no servo's of the rig file."""
    known = sorted(servo.dxl_id for servo in list_servos(rig))
    for dxl_id in dxl_ids:
        if dxl_id not in known:
            raise InputError(
                f"the rig file has no servo with id {dxl_id}; it has {', '.join(map(str, known))}"
            )
