"""Port steps of a diagnosis: are ports there, may they be opened, who uses them, what delays answers."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from palpate.base.errors import DeviceError, quantity
from palpate.config.diagnosis_results import Cause, DoctorStepOut, FindingOut
from palpate.drivers.transport import PortForbidden, PortMissing, PortTaken
from palpate.rig.diagnostics.steps import (
    DiagnosisCase,
    error_finding,
    finish_step,
    join_words,
    skip_step,
    warning_finding,
)

_MAX_LATENCY_TIMER_S = 1e-3
_NONE_TO_OPEN = "no port of the rig file could be opened"
_PSEUDO_TERMINALS = "/dev/pts/"  # what serves a pseudo-terminal has it open, too


@dataclass(frozen=True, eq=False)
class ExaminedPorts:
    """Steps on ports. `usable`: ports that could be opened."""

    steps: tuple[DoctorStepOut, ...]
    usable: frozenset[str]


def examine_ports(case: DiagnosisCase) -> ExaminedPorts:
    """Open every port of the rig once, and ask the system about those that are devices of this computer."""
    users = _users_of_ports(case)
    errors = {}
    for port, baudrate in _rates(case).items():
        case.tell(f"port {port}")
        errors[port] = _refusal(case, port, baudrate)
    usable = frozenset(port for port, error in errors.items() if error is None)
    steps = (
        _existence(case, users, errors),
        _permission(case, users, errors),
        _use(case, users, errors),
        _latency(case, users, usable),
    )
    return ExaminedPorts(steps, usable)


def _rates(case: DiagnosisCase) -> Mapping[str, int]:
    bus = case.rig.bus
    return {bus.port: bus.baudrate_bps} | {
        finger.array.port: finger.array.baudrate_bps for finger in case.rig.fingers
    }


def _users_of_ports(case: DiagnosisCase) -> Mapping[str, str]:
    """What hangs on each port, in words."""
    users = {case.rig.bus.port: "the servos' bus"}
    return users | {finger.array.port: f"array {finger.name}" for finger in case.rig.fingers}


def _refusal(case: DiagnosisCase, port: str, baudrate: int) -> DeviceError | None:
    """Why a port cannot be opened; None if it can."""
    try:
        opened = (
            case.place.open(baudrate) if port == case.rig.bus.port else case.place.open_other(port, baudrate)
        )
    except DeviceError as error:
        return error
    with suppress(Exception):
        opened.close()
    return None


def _existence(
    case: DiagnosisCase, users: Mapping[str, str], errors: Mapping[str, DeviceError | None]
) -> DoctorStepOut:
    name, looked = "port is there", "opened each port of the rig file"
    missing = [port for port, error in errors.items() if isinstance(error, PortMissing)]
    known = (PortMissing, PortForbidden, PortTaken)
    unusable = [port for port, error in errors.items() if error is not None and not isinstance(error, known)]
    findings = _missing(case, users, missing, nothing=1 < len(missing) == len(errors))
    findings += [
        error_finding(
            Cause.PORT_UNUSABLE,
            f"port {port} ({users[port]})",
            str(errors[port]),
            "what is there does not open as a serial port at the rig file's baud rate",
            f"check port and baud rate of {users[port]} in the rig file",
        )
        for port in unusable
    ]
    there = len(errors) - len(missing) - len(unusable)
    return finish_step(name, looked, f"{there} of {quantity(len(errors), 'port', 'ports')} there", findings)


def _missing(
    case: DiagnosisCase, users: Mapping[str, str], missing: Sequence[str], *, nothing: bool
) -> list[FindingOut]:
    """About ports that are not there; one finding if `nothing` is, unless brltty took an adapter."""
    taken = case.computer.taken_by_brltty() if missing else None
    named = {port: f"port {port} ({users[port]})" for port in missing}
    if nothing and taken is None:
        return [
            error_finding(
                Cause.PORT_MISSING,
                "all ports",
                f"none of them is there: {join_words([f'{port} ({users[port]})' for port in missing])}",
                "nothing is plugged in, or every adapter has another name now",
                "plug the adapters in, then find their names with: palpate find-port",
            )
        ]
    findings = []
    for port, device in named.items():
        if taken is not None and "://" not in port:
            found = error_finding(
                Cause.BRLTTY,
                device,
                f"there is no such port, and a USB adapter {taken} has none while brltty runs",
                "brltty took the adapter for a braille display and removed its port",
                "sudo systemctl mask brltty.path brltty-udev.service, then restart the computer",
            )
        else:
            found = error_finding(
                Cause.PORT_MISSING,
                device,
                "there is no such port",
                "its adapter is not plugged in, or has another name now",
                "plug the adapter in, then find its name with: palpate find-port",
            )
        findings.append(found)
    return findings


def _permission(
    case: DiagnosisCase, users: Mapping[str, str], errors: Mapping[str, DeviceError | None]
) -> DoctorStepOut:
    name, looked = "permission", "whether this user may open the ports"
    there = [
        port
        for port, error in errors.items()
        if error is None or isinstance(error, (PortForbidden, PortTaken))
    ]
    if not there:
        return skip_step(name, looked, _NONE_TO_OPEN)
    forbidden = [port for port in there if isinstance(errors[port], PortForbidden)]
    if not forbidden:
        return finish_step(name, looked, f"this user may open {quantity(len(there), 'port', 'ports')}")
    group = case.computer.group_of(forbidden[0])
    named = "dialout" if group is None else group.name
    join = f"sudo usermod -aG {named} $USER, then log out and in again"
    do = "log out and in again: groups count from the next login" if group and group.joined else join
    finding = error_finding(
        Cause.PORT_FORBIDDEN,
        "port " + join_words([f"{port} ({users[port]})" for port in forbidden]),
        f"the system refuses to open {'it' if len(forbidden) == 1 else 'them'}",
        f"this user is not in the group that owns serial ports ({named})",
        do,
    )
    return finish_step(
        name, looked, f"{len(forbidden)} of {quantity(len(there), 'port', 'ports')} refused", [finding]
    )


def _use(
    case: DiagnosisCase, users: Mapping[str, str], errors: Mapping[str, DeviceError | None]
) -> DoctorStepOut:
    name, looked = "other programs", "which programs use the ports, ModemManager among them"
    there = [port for port, error in errors.items() if error is None or isinstance(error, PortTaken)]
    if not there:
        return skip_step(name, looked, _NONE_TO_OPEN)
    findings = list(filter(None, (_user(case, port, users[port], errors[port]) for port in there)))
    used = len({item.device for item in findings})
    saw = (
        f"{used} of {quantity(len(there), 'port', 'ports')} in use or looked at"
        if used
        else "nothing else uses them"
    )
    return finish_step(name, looked, saw, findings)


def _user(case: DiagnosisCase, port: str, what: str, error: DeviceError | None) -> FindingOut | None:
    """What is said of another program on a port."""
    local = "://" not in port
    user = case.computer.user_of(port) if local and not port.startswith(_PSEUDO_TERMINALS) else None
    stop = "sudo systemctl disable ModemManager && sudo systemctl stop ModemManager"
    if user is not None and user.startswith("ModemManager"):
        return error_finding(
            Cause.MODEM_MANAGER,
            f"port {port} ({what})",
            f"{user} has it open",
            "ModemManager takes the device for a modem and sends AT commands to it",
            stop,
        )
    if error is not None or user is not None:
        hint = (
            " (ModemManager is running, and may be it)"
            if local and case.computer.runs("ModemManager")
            else ""
        )
        return error_finding(
            Cause.PORT_BUSY,
            f"port {port} ({what})",
            f"it is in use by {user or 'another program'}",
            f"two programs on one port take each other's bytes{'' if user else hint}",
            f"end {user or 'the other program'}, then run this again"
            + ("" if user or not local else f" (sudo fuser -v {port} names it)"),
        )
    if local and case.computer.may_be_probed(port):
        return warning_finding(
            Cause.MODEM_MANAGER,
            f"port {port} ({what})",
            "ModemManager is running, and nothing tells it to leave this port alone",
            "for some seconds after plugging in it may open the port and send AT commands",
            stop,
        )
    return None


def _latency(case: DiagnosisCase, users: Mapping[str, str], usable: frozenset[str]) -> DoctorStepOut:
    name, looked = "latency timer", "how long adapters hold answers back"
    timers = {port: case.computer.latency_timer_s(port) for port in users if port in usable}
    known = {port: timer for port, timer in timers.items() if timer is not None}
    if not usable:
        return skip_step(name, looked, _NONE_TO_OPEN)
    findings = [
        warning_finding(
            Cause.LATENCY_TIMER,
            f"port {port} ({users[port]})",
            f"its adapter holds every answer back for up to {timer * 1e3:g} ms",
            "all servos are read some 30 times a second instead of several hundred times"
            if port == case.rig.bus.port
            else "frames come in heaps, and a contact is noticed later than it could be",
            f"echo 1 | sudo tee {case.computer.latency_timer_path(port)}",
        )
        for port, timer in known.items()
        if timer > _MAX_LATENCY_TIMER_S
    ]
    return finish_step(name, looked, _timers_in_words(list(known.values())), findings)


def _timers_in_words(known: Sequence[float]) -> str:
    if not known:
        return "no adapter here has one, or the system does not tell"
    low, high = min(known) * 1e3, max(known) * 1e3
    return f"{high:g} ms" if low == high else f"{low:g} to {high:g} ms"
