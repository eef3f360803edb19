"""Live arrays of a rig, streaming. Nothing here knows the servos' bus: nothing can move."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, InputError
from palpate.config import FingerConfig, RigFile
from palpate.drivers.tactile.frames import ArrayDriver
from palpate.drivers.transport.clock import Clock, MonotonicClock
from palpate.drivers.transport.port import PortTaken, open_port
from palpate.drivers.transport.record import Recorder, Sink
from palpate.rig.arrays import array_of, extractor_of
from palpate.rig.bench import set_up
from palpate.rig.monitor.finger_monitor import MonitoredFinger

__all__ = ["ArrayPorts", "find_array_ports", "monitor_finger", "select_fingers", "stream_arrays"]


@dataclass(frozen=True, eq=False)
class ArrayPorts:
    """Where a rig's arrays are: the clock, and how to open a port. It keeps `devices` alive."""

    clock: Clock
    open_port: Callable[[str, int], SerialBase]
    devices: object = None

    def recorded(self, sink: Sink) -> "ArrayPorts":
        """The same ports and clock, recorded to `sink`."""
        recorder = Recorder(self.clock, sink)

        def opened(port: str, baudrate: int) -> SerialBase:
            return recorder.open(port, lambda: self.open_port(port, baudrate))

        return ArrayPorts(recorder.clock, opened, self.devices)


def find_array_ports(rig: RigFile) -> ArrayPorts:
    """The ports of a rig; those of an emulated one are emulated from now on, with an empty table."""
    if not rig.emulated:
        return ArrayPorts(MonotonicClock(), open_port)
    bench = set_up(rig, None, 0)
    return ArrayPorts(bench.clock, lambda port, baudrate: open_port(bench.urls(port), baudrate), bench)


def select_fingers(rig: RigFile, names: Sequence[str]) -> tuple[FingerConfig, ...]:
    """The fingers of these names, all without any; InputError for a name that the rig does not have."""
    there = [finger.name for finger in rig.fingers]
    unknown = next((name for name in names if name not in there), None)
    if unknown is not None:
        names_there = ", ".join(there)
        raise InputError(f'rig "{rig.name}" has no finger {unknown}; it has {names_there}')
    return tuple(finger for finger in rig.fingers if not names or finger.name in names)


@contextmanager
def stream_arrays(
    rig: RigFile, specs: Sequence[FingerConfig], place: ArrayPorts, clock: Clock, rate_hz: float
) -> Iterator[tuple[MonitoredFinger, ...]]:
    """The arrays of some fingers, streaming until the block is left, by whatever way.

    `clock` is the place's, perhaps paced. Raises PortTaken if another program uses a port, DeviceError
    if one does not exist, or an array does not answer or refuses the rate.
    """
    with ExitStack() as ways_out:
        fingers = []
        for spec in specs:
            port = _open(place, spec)
            ways_out.callback(port.close)
            array = array_of(spec, port, clock)
            array.connect()
            ways_out.callback(_stop, array)
            fingers.append(monitor_finger(rig, spec, array, clock))
        for finger in fingers:
            finger.array.start(rate_hz)
        yield tuple(fingers)


def monitor_finger(rig: RigFile, spec: FingerConfig, array: ArrayDriver, clock: Clock) -> MonitoredFinger:
    """A finger's array, connected, with its extractor."""
    extractor = extractor_of(rig, spec, array.description)
    return MonitoredFinger(spec.name, spec.array.port, array, extractor, clock)


def _open(place: ArrayPorts, spec: FingerConfig) -> SerialBase:
    try:
        return place.open_port(spec.array.port, spec.array.baudrate_bps)
    except PortTaken as error:
        raise PortTaken(
            f"port {spec.array.port} of array {spec.name} is in use: another program has it, perhaps a "
            "run, and a port serves one at a time; end that program, or watch the session that the run "
            "records, afterwards"
        ) from error


def _stop(array: ArrayDriver) -> None:
    with suppress(DeviceError):  # it is gone, or says so itself when it is opened next
        array.stop()
