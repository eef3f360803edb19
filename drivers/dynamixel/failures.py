"""What can go wrong between host and servo, as errors that name the servo and the port."""

from collections.abc import Sequence

from palpate.drivers.dynamixel.control_table import HardwareError
from palpate.drivers.dynamixel.packet import StatusErrorCode
from palpate.errors import DeviceError, SafetyStop

__all__ = [
    "DamagedAnswer",
    "HardwareAlert",
    "NotAnswering",
    "NotConfirmed",
    "PortFailed",
    "Restarted",
    "StatusError",
    "WatchdogTripped",
]


class PortFailed(DeviceError):
    """The port itself broke during a transfer."""

    def __init__(self, port: str, cause: object) -> None:
        super().__init__(f"port {port} failed: {cause}; check that the adapter is still plugged in")
        self.port = port


class NotAnswering(DeviceError):
    """One or more servos gave no answer at all."""

    def __init__(self, dxl_ids: Sequence[int], port: str) -> None:
        servos = _servos(dxl_ids)
        verb = "does" if len(dxl_ids) == 1 else "do"
        super().__init__(f"{servos} on {port} {verb} not answer; check power, cable, id and baud rate")
        self.dxl_ids = tuple(dxl_ids)
        self.port = port


class DamagedAnswer(DeviceError):
    """An answer came in pieces, with a wrong CRC, of the wrong length, or was lost."""

    def __init__(self, dxl_ids: Sequence[int], port: str) -> None:
        super().__init__(
            f"the answer of {_servos(dxl_ids)} on {port} was lost or damaged; "
            "check cable, termination and that no two servos share an id"
        )
        self.dxl_ids = tuple(dxl_ids)
        self.port = port


class NotConfirmed(DeviceError):
    """Servos do not hold what was written to them, however often it was sent."""

    def __init__(self, dxl_ids: Sequence[int], port: str, items: Sequence[str]) -> None:
        super().__init__(
            f"{_servos(dxl_ids)} on {port} did not take {' and '.join(items)}; "
            "check cable and termination, and whether another program uses the bus"
        )
        self.dxl_ids = tuple(dxl_ids)
        self.port = port


class Restarted(DeviceError):
    """A servo has forgotten what it was told: it was without power for a moment, or was rebooted."""

    def __init__(self, dxl_id: int, port: str) -> None:
        super().__init__(
            f"servo {dxl_id} on {port} has restarted, with torque off and its turns forgotten; "
            "check its supply and plug, then start again"
        )
        self.dxl_id = dxl_id
        self.port = port


class WatchdogTripped(SafetyStop):
    """A servo has stopped by itself, because it heard nothing for as long as its Bus Watchdog allows."""

    def __init__(self, dxl_id: int, port: str, watchdog_s: float) -> None:
        super().__init__(
            f"servo {dxl_id} on {port} heard nothing for {watchdog_s:g} s and stopped by itself; "
            "check what keeps the computer or the cable busy"
        )
        self.dxl_id = dxl_id
        self.port = port


class StatusError(DeviceError):
    """A servo refused an instruction; `code` says why."""

    def __init__(self, dxl_id: int, port: str, number: int, doing: str) -> None:
        try:
            self.code: StatusErrorCode | None = StatusErrorCode(number)
            name = self.code.name.replace("_", " ").title()
        except ValueError:
            self.code = None
            name = f"error {number}, which the e-Manual does not list"
        super().__init__(
            f"servo {dxl_id} on {port} refused {doing}: {name}; see 'Error' in the e-Manual's Protocol 2.0"
        )
        self.dxl_id = dxl_id
        self.port = port


class HardwareAlert(DeviceError):
    """A servo reports a hardware error; `cause` is None if it could not be read.

    `carried_out` is True if the instruction itself was obeyed nevertheless.
    """

    def __init__(self, dxl_id: int, port: str, cause: HardwareError | None, *, carried_out: bool) -> None:
        if cause is None:
            words = "whose cause could not be read"
        else:
            words = (
                " and ".join(str(flag.name).replace("_", " ").lower() for flag in cause) or "since cleared"
            )
        super().__init__(
            f"servo {dxl_id} on {port} reports a hardware error ({words}); "
            "remove the cause, then reboot the servo"
        )
        self.dxl_id = dxl_id
        self.port = port
        self.cause = cause
        self.carried_out = carried_out


def _servos(dxl_ids: Sequence[int]) -> str:
    if len(dxl_ids) == 1:
        return f"servo {dxl_ids[0]}"
    return "servos " + ", ".join(str(dxl_id) for dxl_id in dxl_ids)
