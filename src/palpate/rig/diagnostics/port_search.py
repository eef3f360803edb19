"""Serial port search: what ports there are, and which of them goes when its adapter is unplugged."""

from collections.abc import Callable, Sequence

from palpate.config.ports_result import SerialPortOut, SerialPortsOut
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.serial_ports import SerialPort

__all__ = ["find_unplugged", "ports_out", "usb_id"]

_APPEARS_S = 5.0  # udev needs a moment for the name under by-id
_POLL_S = 0.2


def find_unplugged(
    look: Callable[[], Sequence[SerialPort]], ask: Callable[[str], bool], clock: Clock
) -> Sequence[SerialPort]:
    """The ports of the adapter that is unplugged and plugged in again, as they are then; none if none is.

    `ask` returns once that is done, False if the person gives up.
    """
    before = look()
    what = "unplug the adapter you look for"
    while True:
        if not ask(what):
            return ()
        left = {port.device for port in look()}
        gone = [port for port in before if port.device not in left]
        if gone:
            break
        what = "no port has gone; unplug the adapter's USB cable"
    if not ask(f"it was {', '.join(port.device for port in gone)}; plug it in again"):
        return gone
    deadline = clock.now() + _APPEARS_S
    while True:
        back = [port for port in look() if port.device not in left]
        named = all(port.by_id is not None for port in back) or all(port.by_id is None for port in gone)
        if (len(back) >= len(gone) and named) or clock.now() > deadline:
            return back or gone
        clock.sleep(_POLL_S)


def ports_out(ports: Sequence[SerialPort], found: SerialPort | None) -> SerialPortsOut:
    """The ports as a result; `found`: the one that was looked for."""
    return SerialPortsOut(
        ports=tuple(
            SerialPortOut.of(
                port,
                usb_id=usb_id(port),
                latency_timer_ms=None if port.latency_timer_s is None else port.latency_timer_s * 1e3,
            )
            for port in ports
        ),
        found=None if found is None else found.name,
    )


def usb_id(port: SerialPort) -> str | None:
    """Vendor and product as people know them: "0403:6014"."""
    return None if port.usb_ids is None else f"{port.usb_ids[0]:04x}:{port.usb_ids[1]:04x}"
