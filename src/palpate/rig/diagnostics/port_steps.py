"""Port steps of a diagnosis: existence, permissions and users of ports, and causes of delay."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

from palpate.base.errors import DeviceError, quantity
from palpate.config.diagnosis_results import Cause, FindingOut
from palpate.drivers.transport import PortForbidden, PortMissing, PortTaken
from palpate.rig.diagnostics.host_ports import is_timer_long
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.diagnostics.steps import (
    DiagnosisCase,
    Judgement,
    join_words,
    name_port,
    name_together,
    warning,
    wrong,
)

_PSEUDO_TERMINALS = "/dev/pts/"  # what serves a pseudo-terminal has it open, too


def open_ports(case: DiagnosisCase) -> dict[str, DeviceError | None]:
    """Open every port of the rig file once: why it does not open, None if it does."""
    errors = {}
    for port, baudrate in _rates(case).items():
        case.tell(f"port {port}")
        errors[port] = _refusal(case, port, baudrate)
    return errors


def _rates(case: DiagnosisCase) -> Mapping[str, int]:
    bus = case.rig.bus
    arrays = (finger.array for finger in case.rig.fingers if finger.array.has_device)
    return {bus.port: bus.baudrate_bps} | {array.port: array.baudrate_bps for array in arrays}


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


def judge_existence(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Ports that are missing, and those that do not open as serial ports."""
    errors = readings.ports
    missing = [port for port, error in errors.items() if isinstance(error, PortMissing)]
    known = (PortMissing, PortForbidden, PortTaken)
    unusable = [port for port, error in errors.items() if error is not None and not isinstance(error, known)]
    findings = _missing(case, missing, nothing=1 < len(missing) == len(errors))
    findings += [
        wrong(
            Cause.PORT_UNUSABLE,
            name_port(case.rig, port),
            str(errors[port]),
            "what is there does not open as a serial port at the rig file's baud rate",
            f"check port and baud rate of {_user_of(case, port)} in the rig file",
        )
        for port in unusable
    ]
    there = len(errors) - len(missing) - len(unusable)
    return f"{there} of {quantity(len(errors), 'port', 'ports')} there", findings


def _user_of(case: DiagnosisCase, port: str) -> str:
    return name_port(case.rig, port).name.partition("(")[2].rstrip(")")


def _with_user(case: DiagnosisCase, port: str) -> str:
    return name_port(case.rig, port).name.removeprefix("port ")


def _missing(case: DiagnosisCase, missing: Sequence[str], *, nothing: bool) -> list[FindingOut]:
    """Findings on ports that are not there; a single one if `nothing` is, unless brltty took an adapter."""
    taken = case.computer.find_brltty_claim() if missing else None
    devices = {port: name_port(case.rig, port) for port in missing}
    if nothing and taken is None:
        return [
            wrong(
                Cause.PORT_MISSING,
                name_together("all ports", devices.values()),
                f"none of them is there: {join_words([_with_user(case, port) for port in missing])}",
                "no device can be reached",
                "plug the adapters in, then find their names with: palpate find-port",
            )
        ]
    return [
        wrong(
            Cause.BRLTTY,
            device,
            f"there is no such port, and a USB adapter {taken} has none while brltty runs",
            "brltty took the adapter for a braille display and removed its port",
            "sudo systemctl mask brltty.path brltty-udev.service, then restart the computer",
        )
        if taken is not None and "://" not in port
        else wrong(
            Cause.PORT_MISSING,
            device,
            "there is no such port",
            "what hangs on it cannot be reached",
            "plug the adapter in, then find its name with: palpate find-port",
        )
        for port, device in devices.items()
    ]


def judge_permission(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Ports that this user may not open."""
    there, forbidden = readings.ports_there, readings.ports_with(PortForbidden)
    if not forbidden:
        return f"this user may open {quantity(len(there), 'port', 'ports')}", []
    group = case.computer.group_of(forbidden[0])
    named = "dialout" if group is None else group.name
    join = f"sudo usermod -aG {named} $USER, then log out and in again"
    do = "log out and in again: groups count from the next login" if group and group.joined else join
    names = "port " + join_words([_with_user(case, port) for port in forbidden])
    finding = wrong(
        Cause.PORT_FORBIDDEN,
        name_together(names, (name_port(case.rig, port) for port in forbidden)),
        f"the system refuses to open {'it' if len(forbidden) == 1 else 'them'}",
        f"this user is not in the group that owns serial ports ({named})",
        do,
    )
    return f"{len(forbidden)} of {quantity(len(there), 'port', 'ports')} refused", [finding]


def judge_use(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Ports that another program uses, or may look at."""
    there = (*readings.usable, *readings.ports_with(PortTaken))
    found = (_user(case, port, readings.ports[port]) for port in readings.ports if port in there)
    findings = [item for item in found if item is not None]
    used = len({item.device for item in findings})
    if not used:
        return "nothing else uses them", []
    return f"{used} of {quantity(len(there), 'port', 'ports')} in use or looked at", findings


def _user(case: DiagnosisCase, port: str, error: DeviceError | None) -> FindingOut | None:
    """Another program on a port."""
    device = name_port(case.rig, port)
    local = "://" not in port
    user = case.computer.user_of(port) if local and not port.startswith(_PSEUDO_TERMINALS) else None
    stop = "sudo systemctl disable ModemManager && sudo systemctl stop ModemManager"
    if user is not None and user.startswith("ModemManager"):
        return wrong(
            Cause.MODEM_MANAGER,
            device,
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
        return wrong(
            Cause.PORT_BUSY,
            device,
            f"it is in use by {user or 'another program'}",
            f"two programs on one port take each other's bytes{'' if user else hint}",
            f"end {user or 'the other program'}, then run this again"
            + ("" if user or not local else f" (sudo fuser -v {port} names it)"),
        )
    if local and case.computer.may_be_probed(port):
        return warning(
            Cause.MODEM_MANAGER,
            device,
            "ModemManager is running, and nothing tells it to leave this port alone",
            "for some seconds after plugging in it may open the port and send AT commands",
            stop,
        )
    return None


def judge_latency(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Adapters that hold answers back."""
    timers = {port: readings.timers_s[port] for port in readings.ports if port in readings.usable}
    known = {port: timer for port, timer in timers.items() if timer is not None}
    findings = [
        warning(
            Cause.LATENCY_TIMER,
            name_port(case.rig, port),
            f"its adapter holds every answer back for up to {timer * 1e3:g} ms",
            "all servos are read some 30 times a second instead of several hundred times"
            if port == case.rig.bus.port
            else "frames come in heaps, and a contact is noticed later than it could be",
            f"echo 1 | sudo tee {case.computer.latency_timer_path(port)}",
        )
        for port, timer in known.items()
        if is_timer_long(timer)
    ]
    return _timers_in_words(list(known.values())), findings


def _timers_in_words(known: Sequence[float]) -> str:
    if not known:
        return "no adapter here has one, or the system does not tell"
    low, high = min(known) * 1e3, max(known) * 1e3
    return f"{high:g} ms" if low == high else f"{low:g} to {high:g} ms"
