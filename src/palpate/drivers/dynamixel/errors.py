"""Errors between host and servo; each names the servo and the port."""

from collections.abc import Collection, Sequence

from palpate.base.errors import DeviceError, SafetyStop
from palpate.drivers.dynamixel.control_table import HardwareError
from palpate.drivers.dynamixel.packet import StatusErrorCode

_ERROR_CAUSES = {
    HardwareError.INPUT_VOLTAGE: "its supply left its limits, as a weak one does when motors pull",
    HardwareError.OVERHEATING: "it has been too hot",
    HardwareError.MOTOR_ENCODER: "its encoder or motor does not work",
    HardwareError.ELECTRICAL_SHOCK: "its electronics were shocked, or its motor has too little power",
    HardwareError.OVERLOAD: "it pushed for long against something that did not give way",
}


def error_names(errors: HardwareError) -> tuple[str, ...]:
    """The bits in words."""
    return tuple(str(flag.name).replace("_", " ").lower() for flag in errors)


def error_causes(errors: HardwareError) -> str:
    """What sets these bits, in words."""
    return " and ".join(cause for flag, cause in _ERROR_CAUSES.items() if flag & errors)


class PortFailed(DeviceError):
    """The port itself broke during a transfer."""

    def __init__(self, port: str, cause: object) -> None:
        super().__init__(f"port {port} failed: {cause}; check that the adapter is still plugged in")


class ServoError(DeviceError):
    """Fault of the servos `dxl_ids` on `port`."""

    def __init__(self, dxl_ids: Sequence[int], port: str, message: str) -> None:
        super().__init__(message)
        self.dxl_ids = tuple(dxl_ids)
        self.port = port


class NotAnswering(ServoError):
    """One or more servos gave no answer at all."""

    def __init__(self, dxl_ids: Sequence[int], port: str, message: str | None = None) -> None:
        verb = "does" if len(dxl_ids) == 1 else "do"
        super().__init__(
            dxl_ids,
            port,
            message
            or f"{_servos(dxl_ids)} on {port} {verb} not answer; check power, cable, id and baud rate",
        )


class AnsweringLate(NotAnswering):
    """Servos whose answers come, but only once their time is over."""

    def __init__(self, dxl_ids: Sequence[int], port: str) -> None:
        verb = "answers" if len(dxl_ids) == 1 else "answer"
        super().__init__(
            dxl_ids,
            port,
            f"{_servos(dxl_ids)} on {port} {verb} too late, so power and cable are in order; close what "
            "keeps the computer busy, shorten the adapter's latency timer, or raise latency_ms",
        )


class DamagedAnswer(ServoError):
    """An answer came in pieces, with a wrong CRC, of the wrong length, or was lost."""

    def __init__(self, dxl_ids: Sequence[int], port: str, message: str | None = None) -> None:
        super().__init__(
            dxl_ids,
            port,
            message
            or f"the answer of {_servos(dxl_ids)} on {port} was lost or damaged; "
            "check cable, termination and that no two servos share an id",
        )


class WrongLength(DamagedAnswer):
    """A servo answers with a whole packet of another length than asked for."""

    def __init__(self, dxl_id: int, port: str, size: int, wanted: int) -> None:
        super().__init__(
            [dxl_id],
            port,
            f"servo {dxl_id} on {port} answered with {size} bytes instead of {wanted}: its control table is "
            "not that of the model in the rig file, or another program uses the bus; "
            "check `model` and the servo's firmware",
        )


class NotConfirmed(ServoError):
    """Servos do not hold what was written to them, however often it was sent."""

    def __init__(self, dxl_ids: Sequence[int], port: str, items: Sequence[str]) -> None:
        super().__init__(
            dxl_ids,
            port,
            f"{_servos(dxl_ids)} on {port} did not take {' and '.join(items)}; "
            "check cable and termination, and whether another program uses the bus",
        )


class Restarted(ServoError):
    """A servo has lost its settings: it was without power for a moment, or was rebooted."""

    def __init__(self, dxl_id: int, port: str, remedy: str = "then start again") -> None:
        super().__init__(
            [dxl_id],
            port,
            f"servo {dxl_id} on {port} has restarted, with torque off and its turns forgotten; "
            f"check its supply and plug, {remedy}",
        )


class WatchdogTripped(SafetyStop):
    """A servo has stopped by itself, because it heard nothing for as long as its Bus Watchdog allows."""

    def __init__(self, dxl_id: int, port: str, watchdog_s: float) -> None:
        self.dxl_ids = (dxl_id,)
        super().__init__(
            f"servo {dxl_id} on {port} heard nothing for {watchdog_s:g} s and stopped by itself; "
            "check what keeps the computer or the cable busy"
        )


class StatusError(ServoError):
    """A servo refused an instruction; `code` says why."""

    def __init__(self, dxl_id: int, port: str, number: int, doing: str) -> None:
        try:
            self.code: StatusErrorCode | None = StatusErrorCode(number)
            name = self.code.name.replace("_", " ").title()
        except ValueError:
            self.code = None
            name = f"error {number}, which the e-Manual does not list"
        super().__init__(
            [dxl_id],
            port,
            f"servo {dxl_id} on {port} refused {doing}: {name}; see 'Error' in the e-Manual's Protocol 2.0",
        )


class HardwareAlert(ServoError):
    """A servo reports a hardware error; `cause` is None if it could not be read.

    `carried_out` is True if the instruction itself was obeyed nevertheless.
    """

    def __init__(self, dxl_id: int, port: str, cause: HardwareError | None, *, carried_out: bool) -> None:
        if cause is None:
            words = "whose cause could not be read"
        else:
            words = " and ".join(error_names(cause)) or "since cleared"
        because = f": {error_causes(cause)}" if cause else ""
        super().__init__(
            [dxl_id],
            port,
            f"servo {dxl_id} on {port} reports a hardware error ({words}){because}; remove the cause, then "
            f"palpate reboot --rig FILE --id {dxl_id}",
        )
        self.cause = cause
        self.carried_out = carried_out


def raise_first(errors: Collection[DeviceError]) -> None:
    """Raise one error for all silent servos, or the first other one; nothing without errors."""
    silent = [error for error in errors if isinstance(error, NotAnswering)]
    if silent:
        late = any(isinstance(error, AnsweringLate) for error in silent)
        dxl_ids = [dxl_id for error in silent for dxl_id in error.dxl_ids]
        raise (AnsweringLate if late else NotAnswering)(dxl_ids, silent[0].port)
    for error in errors:
        raise error


def _servos(dxl_ids: Sequence[int]) -> str:
    if len(dxl_ids) == 1:
        return f"servo {dxl_ids[0]}"
    return "servos " + ", ".join(str(dxl_id) for dxl_id in dxl_ids)
