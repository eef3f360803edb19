"""The rows of the fault matrix: each fault, what the stack must do about it, and what the operator sees.

A row strikes by changing the emulated devices, the wires, the log or the host's process while a command runs.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event

import numpy as np

from palpate.base.errors import DeviceError, OutputError, SafetyStop
from palpate.config import ObjectsFile
from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from palpate.drivers.emulators.tip import PartSection
from palpate.drivers.emulators.wire_faults import FaultRates, WireRates
from palpate.rig.session.log import SessionLog
from support.benches.session import EmulatedSession
from support.commands.command import PATIENCE_S

NOTICED_MM, SILENT_MM, UNHEARD_MM = 5.0, 7.0, 12.0
"""Bounds of docs/safety.md on the travel after a fault that the host notices, a silent array, or one that
leaves the servos out of reach."""

JUST_BEFORE = "just before a touch"

MOVING = frozenset({"approach", JUST_BEFORE, "touch", "creep", "press", "stop at speed"})
"""Phases in which arrays stream and fingers move where they may touch."""

LOOKED = MOVING | {"free travel", "retract", "aim", "homing", "swing"}
"""Phases in which servos move."""


@dataclass
class Host:
    """What of a run's host side a fault can reach."""

    session: EmulatedSession
    objects: ObjectsFile = field(default_factory=lambda: ObjectsFile(()))
    log: SessionLog | None = None
    release: Event = field(default_factory=Event)
    observer: Callable[[], None] = lambda: None
    interrupts: int = 0


@dataclass(frozen=True)
class Fault:
    """One row: what happens, what is done about it, and what the operator sees.

    `ends`: errors of which one must end the run if it happens in a phase of `noticed`; elsewhere it may.
    `within_s`: how soon then. `says`: a pattern of the error's line. `on`: servos whose torque may stay on,
    as `excuse` states. `only`: commands that it is tried in; empty: all.
    """

    name: str
    strike: Callable[[Host], object]
    does: str
    sees: str
    ends: tuple[type[BaseException], ...] = ()
    says: str = ""
    noticed: frozenset[str] = frozenset()
    on: frozenset[int] = frozenset()
    excuse: str = ""
    travel_mm: float = NOTICED_MM
    within_s: float = np.inf
    only: frozenset[str] = frozenset()


ALL = frozenset({11, 12, 21, 22, 31, 32})
DEVICE, SAFETY, OUTPUT = (DeviceError,), (SafetyStop,), (OutputError,)
EITHER = (DeviceError, SafetyStop)


def _wire(host: Host, port: str = "mock://bus"):  # type: ignore[no-untyped-def]
    return host.session.cables[port].wire


def _unplug(host: Host, back_s: float) -> None:
    wire = _wire(host)
    wire.unplugged = True
    host.session.clock.after(back_s, lambda: setattr(wire, "unplugged", False))


def _clamp(host: Host, dxl_id: int) -> None:
    servo = host.session.servos[dxl_id]
    at = servo.shaft_rad
    servo.hold(lambda rad, rad_s: -50.0 * (rad - at) - 0.3 * rad_s)


def shove(host: Host) -> None:
    """Something hard is pushed 4.5 mm deep into the first tip."""
    finger = host.session.bench.fingers[0]
    x, y = finger.centre_mm
    finger.put([_box(x + 0.5, y)])


def _box(x_mm: float, y_mm: float) -> PartSection:
    corners = np.array([[0.0, -40.0], [80.0, -40.0], [80.0, 40.0], [0.0, 40.0]]) + np.array([x_mm, y_mm])
    return PartSection(corners, np.roll(corners, -1, axis=0), top_mm=200.0)


def _no_answers(host: Host, dxl_id: int) -> None:
    host.session.servos[dxl_id]._unit.deaf_s = 1e9


def _rates(host: Host, rates: FaultRates, *, arrays: bool = False) -> None:
    for port, cable in host.session.cables.items():
        if (port != "mock://bus") == arrays:
            cable.wire.rates = WireRates(to_host=rates) if arrays else WireRates(rates, rates)


def _raise(error: BaseException) -> None:
    raise error


def _interrupt(host: Host, times: int) -> None:
    host.interrupts += 1
    if host.interrupts < times:
        host.session.clock.after(0.0, lambda: _interrupt(host, times))
    raise KeyboardInterrupt("Ctrl-C")


def _redirect_log(host: Host, to: int) -> None:
    assert host.log is not None
    os.dup2(to, host.log._file.fileno())


def _hang_disk(host: Host) -> None:
    """The log's descriptor becomes a pipe that is full and that nobody reads, as a disk that is gone."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    try:
        while True:
            os.write(writer, b"\0" * 65536)
    except BlockingIOError:
        os.set_blocking(writer, True)
    _redirect_log(host, writer)
    host.release.reader = reader  # type: ignore[attr-defined]


def _die(host: Host) -> None:
    for cable in host.session.cables.values():
        cable.cut = True


def _observe(host: Host, action: Callable[[], None]) -> None:
    host.observer = action


IDENTIFY = frozenset({"identify"})

FAULTS: tuple[Fault, ...] = (
    Fault(
        "a servo hears and does not answer",
        lambda h: _no_answers(h, 12),
        "torque off on all that answer; Bus Watchdog stops the silent one, **with torque on**",
        "`device error: servo 12 on … does not answer …`, exit code 3, and a warning",
        DEVICE,
        r"servo 12 on .* does not answer",
        LOOKED,
        frozenset({12}),
        "the silent servo has received the command and cannot confirm it",
        UNHEARD_MM,
    ),
    Fault(
        "a servo loses its plug",
        lambda h: h.session.servos[22].power_off(),
        "torque off on all others",
        "`device error: servo 22 on … does not answer …`, exit code 3, and a warning",
        DEVICE,
        r"servo 22 on .* does not answer",
        LOOKED,
        frozenset({22}),
        "a servo without supply has no torque, whatever its table says",
    ),
    Fault(
        "a servo reports a hardware error (overload)",
        lambda h: h.session.servos[12].report_hardware_error(OVERLOAD_BIT),
        "torque off on all; the cause is read",
        "`device error: servo 12 on … reports a hardware error (overload) …`, exit code 3",
        DEVICE,
        r"servo 12 .*hardware error",
        LOOKED,
    ),
    Fault(
        "a servo is without power for a moment",
        lambda h: (h.session.servos[22].power_off(), h.session.servos[22].power_on()),
        "torque off on all",
        "`device error: servo 22 on … has restarted …`, exit code 3",
        DEVICE,
        r"servo 22 .*restarted",
        LOOKED,
    ),
    Fault(
        "another program switches a servo's torque off (`palpate stop`)",
        lambda h: h.session.servos[12].take_block(64, b"\0"),
        "torque off on all",
        "`safety stop: servo 12 on … has its torque off …`, exit code 4",
        SAFETY,
        r"servo 12 .* torque off",
        LOOKED,
    ),
    Fault(
        "the bus adapter is unplugged for 3 s",
        lambda h: _unplug(h, 3.0),
        "Bus Watchdog stops the servos within 0.5 s, **with torque on**; palpate waits for the adapter and "
        "switches torque off once it is back",
        "`… is gone and torque may be on: plug it in again …`, then `device error: port … failed …`, "
        "exit code 3",
        DEVICE,
        r"port .* failed",
        LOOKED,
        travel_mm=UNHEARD_MM,
    ),
    Fault(
        "the bus adapter is unplugged and stays so",
        lambda h: _unplug(h, 1e9),
        "Bus Watchdog stops the servos within 0.5 s, **with torque on**",
        "as above, with a warning to cut the power",
        DEVICE,
        r"port .* failed",
        LOOKED,
        ALL,
        "no servo can be reached",
        UNHEARD_MM,
    ),
    Fault(
        "the bus's cable breaks",
        lambda h: setattr(h.session.cables["mock://bus"], "cut", True),
        "Bus Watchdog stops the servos within 0.5 s, **with torque on**",
        "`device error: servo … on … does not answer …`, exit code 3, with a warning to cut the power",
        DEVICE,
        r"do(es)? not answer",
        LOOKED,
        ALL,
        "no servo can be reached",
        UNHEARD_MM,
    ),
    Fault(
        "1 % of the bus's bytes are flipped",
        lambda h: _rates(h, FaultRates(flipped=0.01)),
        "requests and writes are repeated; where three tries fail, torque off",
        "nothing, or `device error: … was lost or damaged …`, exit code 3",
        EITHER,
        r"servo|port",
    ),
    Fault(
        "one in a hundred of the bus's packets is lost",
        lambda h: _rates(h, FaultRates(lost=0.01)),
        "requests and writes are repeated",
        "nothing",
    ),
    Fault(
        "a third of the bus's packets are lost",
        lambda h: _rates(h, FaultRates(lost=0.33)),
        "requests and writes are repeated; where three tries fail, torque off",
        "nothing, or `device error: …`, exit code 3, or `safety stop: … felt … N`, where a stop came late",
        EITHER,
        r"servo|port|finger f. felt",
        travel_mm=UNHEARD_MM,
    ),
    Fault(
        "an array's cable breaks",
        lambda h: setattr(h.session.cables["mock://f1"], "cut", True),
        "all motion ends within 0.15 s and one sample period; if it does not answer within 4 s, torque off",
        "`device error: tactile array f1 on … has sent nothing for 0.15 s …`, exit code 3",
        DEVICE,
        r"tactile array f1 on .*(sent nothing|(does|did) not answer|no frame)",
        MOVING,
        travel_mm=SILENT_MM,
    ),
    Fault(
        "an array is unplugged",
        lambda h: setattr(_wire(h, "mock://f1"), "unplugged", True),
        "all motion ends; if it is not back within 4 s, torque off; if it is, the grip is repeated",
        "`device error: tactile array f1 on … is gone …`, exit code 3",
        DEVICE,
        r"tactile array f1 on |port .*/f1 ",
        MOVING,
    ),
    Fault(
        "a fifth of an array's frames are lost, and bytes flipped",
        lambda h: _rates(h, FaultRates(lost=0.2, flipped=0.0005), arrays=True),
        "dropped and counted; motion ends only if none come for 0.15 s",
        "nothing, or as above",
        DEVICE,
        r"tactile array",
    ),
    Fault(
        "something hard is pushed against a tip",
        shove,
        "all motion ends, torque off",
        "`safety stop: finger f1 felt … N, above max_force_n …`, exit code 4",
        EITHER,
        r"finger f1 felt .*|servo 1[12] .*did not reach",
        MOVING,
    ),
    Fault(
        "a slide is held elsewhere than at its array",
        lambda h: _clamp(h, 12),
        "all motion ends after 0.6 s (1 s in free space), torque off",
        "`safety stop: finger f1 is held …`, exit code 4, or `device error: servo 12 … did not reach …`, "
        "exit code 3",
        EITHER,
        r"finger f1|servo 12",
        frozenset({"approach", "stop at speed"}),
        travel_mm=np.inf,
        within_s=3.0,
    ),
    Fault(
        "the computer does not run palpate for 0.8 s",
        lambda h: h.session.clock.sleep(0.8),
        "Bus Watchdog stops every finger; a grip is repeated, once",
        "`servo … heard nothing for 0.5 s …; the grip is begun again`, or the error that ends the run",
        EITHER,
        r"heard nothing|torque off|above max_force_n|finger|servo",
        travel_mm=2 * UNHEARD_MM,
    ),
    Fault(
        "the computer stops",
        _die,
        "Bus Watchdog stops a move within 0.5 s, **with torque on**; `palpate stop` switches it off",
        "nothing; the log is whole up to its last 0.1 s",
        DEVICE,
        r"",
        LOOKED,
        ALL,
        "no process is left to command the servos",
        UNHEARD_MM,
    ),
    Fault(
        "Ctrl-C",
        lambda h: _interrupt(h, 1),
        "the run unwinds, torque off",
        "`interrupted`, `torque is off`, exit code 130",
        (KeyboardInterrupt,),
        r"Ctrl-C",
        LOOKED,
    ),
    Fault(
        "Ctrl-C, and again while torque is switched off",
        lambda h: _interrupt(h, 2),
        "switched off all the same; the command line holds further signals back",
        "as above",
        (KeyboardInterrupt,),
        r"Ctrl-C",
        LOOKED,
    ),
    Fault(
        "memory runs out in palpate",
        lambda _: _raise(MemoryError()),
        "the run unwinds, torque off",
        "`error: out of memory`, exit code 5",
        (MemoryError,),
        r"",
        LOOKED,
    ),
    Fault(
        "the log's disk is full",
        lambda h: _redirect_log(h, os.open("/dev/full", os.O_WRONLY)),
        "the run ends at the next check, torque off; what was written is kept",
        "`output error: session log … cannot be written: No space left on device …`, exit code 5",
        OUTPUT,
        r"session log .* No space left",
        LOOKED,
        travel_mm=np.inf,
        within_s=8.0,  # of virtual time; the log's thread lives in real time
        only=IDENTIFY,
    ),
    Fault(
        "the log's disk hangs",
        _hang_disk,
        "the run goes on for 5 s at most, then ends, torque off",
        "`output error: session log … the disk has not taken it for 5 s …`, exit code 5",
        OUTPUT,
        r"session log .* has not taken it",
        travel_mm=np.inf,
        only=IDENTIFY,
    ),
    Fault(
        "an observer raises, or standard output is closed or full",
        lambda h: _observe(h, lambda: _raise(OSError(28, "No space left on device"))),
        "it is not called any more; the run ends before its next grip, torque off; after the last one, "
        "the answer comes first",
        "`output error: observer … failed …`, exit code 5",
        OUTPUT,
        r"observer .* failed: OSError",
        travel_mm=np.inf,
        only=IDENTIFY,
    ),
    Fault(
        "an observer, or the terminal, does not return",
        lambda h: _observe(h, lambda: h.release.wait(timeout=PATIENCE_S) and None),
        "the run goes on without it",
        "nothing",
        only=IDENTIFY,
    ),
)
