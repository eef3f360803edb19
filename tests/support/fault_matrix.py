"""The fault matrix: every fault, in every phase of every command that moves, on the emulated bench.

A cell runs a command in virtual time, lets the fault happen at an instant of the phase, drawn by a seed, and
looks at the devices themselves afterwards. Which phase an instant belongs to is read off the call stack of a
run without faults, which is the same up to that instant.
"""

import os
import random
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

import numpy as np
from emulated_session import EmulatedSession, emulated_session
from touched_references import DISC, FRESH
from truth_calibration import bench_calibration

from palpate.calibration.agreement import contact_uncertainties
from palpate.calibration.prober import Probe
from palpate.config import apply_calibration, load_objects, load_rig, shipped_objects, shipped_rig
from palpate.drivers.emulators.faults import FaultRates, WireRates
from palpate.drivers.emulators.servo import OVERLOAD_BIT
from palpate.drivers.emulators.tip import PartSection
from palpate.errors import DeviceError, OutputError, SafetyStop
from palpate.recognizer import Catalogue
from palpate.rig.bench import environment
from palpate.rig.commissioning.rig_prober import HandProber
from palpate.rig.diagnostics.retouch import retouch
from palpate.rig.emulated.reference_table import EmulatedTable
from palpate.rig.session.log import SessionLog
from palpate.rig.session.run import IdentificationJob, run_identification
from palpate.vocabulary import Strategy

__all__ = ["COMMANDS", "FAULTS", "Cell", "Fault", "Outcome", "cells", "problems", "run_cell"]

SEED = 7
_DRAWN_S = 4.0
_CALIBRATING = 1.5  # the rig that is calibrated approaches at 30 mm/s, the shipped one at 20
FORCE_N = 10.0
"""max_force_n of the rigs (8 N, by the slides' current limit) and a quarter for inertia."""

NOTICED_MM, SILENT_MM, UNHEARD_MM = 5.0, 7.0, 12.0
"""Bounds of docs/safety.md on the travel after a fault that the host notices, a silent array, or one that
nobody can tell the servos of."""


@dataclass
class Host:
    """What of a run's host side a fault can reach."""

    session: EmulatedSession
    log: SessionLog | None = None
    release: Event = field(default_factory=Event)
    observer: Callable[[], None] = lambda: None
    interrupts: int = 0


# ---------------------------------------------------------------------------------------------- commands


def _identify(host: Host, folder: Path) -> None:
    session = host.session
    objects = load_objects(shipped_objects())
    job = IdentificationJob(
        session.rig, Catalogue(objects.objects), session.placement, Strategy.PLANNED, SEED, None
    )
    with SessionLog(folder, session.clock, {}, stalled_s=0.3) as log:
        host.log = log
        run = run_identification(job, environment(session.bench_rig, log), log, [lambda _: host.observer()])
    if run.late_failure is not None:
        raise run.late_failure


def _calibrate(host: Host, _folder: Path) -> None:
    """What a calibration has moved, a little of each."""
    session = host.session
    with environment(session.bench_rig).hand(session.rig) as hand:
        hand.prepare()
        prober = HandProber(hand, EmulatedTable(session.bench, SEED))
        spec = session.rig.fingers[0]
        assert spec.type == "slide"
        assert spec.slide.stops_mm is not None
        prober.home(0, spec.slide.stops_mm[0])
        prober.swing()
        prober.put(DISC, (0.0, 0.0))
        middles = [_middle(prober, finger) for finger in range(len(session.rig.fingers))]
        touched = prober.touch(middles, 0)
        contacts = [
            Probe(probe.approach, found.servos_rad[1])
            for probe, found in zip(middles, touched, strict=True)
            if found is not None
        ]
        prober.press(contacts, 0)
        prober.stop(contacts, session.rig.closing.approach_speed_mm_s)


def _middle(prober: HandProber, finger: int) -> Probe:
    own = [k for k, item in enumerate(prober.approaches) if item.finger == finger]
    best = own[len(own) // 2]
    return Probe(best, prober.approaches[best].end_rad)


def _check_touch(host: Host, _folder: Path) -> None:
    session = host.session
    file = bench_calibration(session.rig, SEED)
    promises = contact_uncertainties(file, at_rest=False)
    assert promises is not None
    with environment(session.bench_rig).hand(apply_calibration(session.rig, file)) as hand:
        hand.prepare()
        retouch(session.rig, HandProber(hand, EmulatedTable(session.bench, SEED)), DISC, promises)


def _shipped(**changes: object) -> EmulatedSession:
    rig = load_rig(shipped_rig())
    search = rig.search.model_copy(update={"max_grips": 1})
    return emulated_session(seed=SEED, rig=rig.model_copy(update={"search": search}), **changes)  # type: ignore[arg-type]


def _fresh() -> EmulatedSession:
    rig = FRESH.model_copy(update={"fingers": FRESH.fingers[:2]})
    return emulated_session(seed=SEED, rig=rig, empty=True)


COMMANDS: dict[str, tuple[Callable[[], EmulatedSession], Callable[[Host, Path], None]]] = {
    "identify": (_shipped, _identify),
    "calibrate": (_fresh, _calibrate),
    "check --touch": (lambda: _shipped(empty=True), _check_touch),
}

PHASES: Sequence[tuple[str, str]] = (
    ("_switch_off_despite_interruptions", "torque off"),
    ("_connect", "connect"),
    ("prepare", "limits and torque on"),
    ("retract_all", "retract"),
    ("_to_lines", "aim"),
    ("tare", "tare"),
    ("go_to", "free travel"),
    ("measure_quasi_statically", "creep"),
    ("measure_at_rest", "measure"),
    ("_touched_at_once", "touch"),
    ("_move_until_touched", "approach"),
    ("press", "press"),
    ("stop_at_speed", "stop at speed"),
    ("_stalled", "homing"),
    ("swing", "swing"),
)
"""Functions and the phases that they are; the first of a stack's counts."""

MOVING = frozenset({"approach", "touch", "creep", "press", "stop at speed"})
"""Phases in which arrays stream and fingers move where they may touch."""

LOOKED = MOVING | {"free travel", "retract", "aim", "homing", "swing"}
"""Phases in which servos move."""


def _phase() -> str | None:
    names = set()
    frame = sys._getframe(1)
    while frame is not None:  # type: ignore[redundant-expr]
        names.add(frame.f_code.co_name)
        if frame.f_back is None:
            break
        frame = frame.f_back
    return next((phase for name, phase in PHASES if name in names), None)


@cache
def phases(command: str) -> dict[str, list[tuple[float, float]]]:
    """When a run without faults is in which phase: intervals of virtual time, s."""
    make, carry = COMMANDS[command]
    session = make()
    spans: dict[str, list[tuple[float, float]]] = {}
    last: list[tuple[str | None, float]] = [(None, 0.0)]

    def look() -> None:
        phase, now = _phase(), session.clock.now()
        before, since = last[0]
        if phase != before:
            if before is not None and now > since:
                spans.setdefault(before, []).append((since, now))
            last[0] = (phase, now)

    session.clock.on_tick = look
    with TemporaryDirectory() as folder:
        carry(Host(session), Path(folder))
    look()
    return spans


def instant_s(command: str, phase: str, draw: int) -> float:
    """An instant of a phase, evenly drawn over the first seconds of it: later ones are more of the same."""
    spans = phases(command)[phase]
    whole = min(_DRAWN_S, sum(until - since for since, until in spans))
    at = random.Random(f"{command} {phase} {draw}").uniform(0.02, 0.98) * whole
    for since, until in spans:
        if at <= until - since:
            return since + at
        at -= until - since
    return spans[-1][1]


# ------------------------------------------------------------------------------------------------ faults


@dataclass(frozen=True)
class Fault:
    """One row: what happens, what is done about it, and what the operator sees.

    `ends`: errors of which one must end the run if it happens in a phase of `noticed`; elsewhere it may.
    `within_s`: how soon then. `says`: a pattern of the error's line. `on`: servos whose torque may stay on,
    as `excuse` states.
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
    only: frozenset[str] = frozenset(COMMANDS)


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
    free, at = servo.step, servo.shaft_rad
    servo.step = lambda dt_s, load_nm: free(  # type: ignore[method-assign]
        dt_s, load_nm - 50.0 * (servo.shaft_rad - at) - 0.3 * servo.shaft_rad_s
    )


def _shove(host: Host) -> None:
    """Something hard is pushed 4.5 mm deep into the first tip."""
    finger = host.session.bench.fingers[0]
    x, y = finger.centre_mm
    finger.put(_box(x + 0.5, y))


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
        "the silent servo was told, and cannot confirm",
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
        "no servo can be told",
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
        "no servo can be told",
        UNHEARD_MM,
    ),
    Fault(
        "1 % of the bus's bytes are flipped",
        lambda h: _rates(h, FaultRates(flipped=0.01)),
        "asked and told again; where three tries fail, torque off",
        "nothing, or `device error: … was lost or damaged …`, exit code 3",
        EITHER,
        r"servo|port",
    ),
    Fault(
        "a third of the bus's packets are lost",
        lambda h: _rates(h, FaultRates(lost=0.33)),
        "asked and told again; where three tries fail, torque off",
        "nothing, or `device error: …`, exit code 3, or `safety stop: … felt … N`, where a stop came late",
        EITHER,
        r"servo|port|finger f. felt",
        travel_mm=UNHEARD_MM,
    ),
    Fault(
        "an array's cable breaks",
        lambda h: setattr(h.session.cables["mock://f1"], "cut", True),
        "all motion ends within 0.15 s and a look, torque off",
        "`device error: tactile array f1 on … has sent nothing for 0.15 s …`, exit code 3",
        DEVICE,
        r"tactile array f1 on .*(sent nothing|(does|did) not answer|no frame)",
        MOVING,
        travel_mm=SILENT_MM,
    ),
    Fault(
        "an array is unplugged",
        lambda h: setattr(_wire(h, "mock://f1"), "unplugged", True),
        "torque off",
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
        _shove,
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
        "Bus Watchdog stops every finger; a grip is begun again, once",
        "`servo … heard nothing for 0.5 s …; the grip is begun again`, or the error that ends the run",
        EITHER,
        r"heard nothing|torque off|above max_force_n|finger|servo",
        travel_mm=2 * UNHEARD_MM,
    ),
    Fault(
        "the computer stops, or palpate is killed",
        _die,
        "Bus Watchdog stops a move within 0.5 s, **with torque on**; `palpate stop` switches it off",
        "nothing; the log is whole up to its last 0.1 s",
        DEVICE,
        r"",
        LOOKED,
        ALL,
        "nobody is left to tell the servos",
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
        "the run ends at the next look, torque off; what was written stays",
        "`output error: session log … cannot be written: No space left on device …`, exit code 5",
        OUTPUT,
        r"session log .* No space left",
        LOOKED,
        travel_mm=np.inf,
        within_s=8.0,  # of virtual time; the log's thread lives in real time
        only=IDENTIFY,
    ),
    Fault(
        "the log's disk takes nothing any more",
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
        "it is told nothing more; the run ends before its next grip, torque off; after the last one, "
        "the answer comes first",
        "`output error: observer … failed …`, exit code 5",
        OUTPUT,
        r"observer .* failed: OSError",
        travel_mm=np.inf,
        only=IDENTIFY,
    ),
    Fault(
        "an observer, or the terminal, does not return",
        lambda h: _observe(h, lambda: h.release.wait(20.0) and None),
        "the run goes on without it",
        "nothing",
        only=IDENTIFY,
    ),
)


# ------------------------------------------------------------------------------------------------- cells


@dataclass(frozen=True)
class Cell:
    """One fault at one instant of one phase of one command."""

    command: str
    phase: str
    fault: int
    draw: int = 0

    @property
    def row(self) -> Fault:
        """Its fault."""
        return FAULTS[self.fault]

    def __str__(self) -> str:
        return f"{self.command}, {self.phase}: {self.row.name}"


@dataclass(frozen=True)
class Outcome:
    """What came of a cell, as the devices have it.

    `stop_s`: from the fault until no tip moved any more; `ended_s`: until the command had ended.
    """

    error: str | None
    kinds: tuple[str, ...]
    message: str
    notes: tuple[str, ...]
    torque_on: frozenset[int]
    moved_mm: float
    travel_mm: float
    hardest_n: float
    stop_s: float
    ended_s: float


def cells(draws: int = 1) -> list[Cell]:
    """All of them."""
    return [
        Cell(command, phase, number, draw)
        for command in COMMANDS
        for phase in phases(command)
        for number, fault in enumerate(FAULTS)
        if command in fault.only
        for draw in range(draws)
    ]


class _Watch:
    """What fingers do from the fault on, as the bench knows it and the host does not."""

    def __init__(self, session: EmulatedSession) -> None:
        self._session, self._next_s = session, 0.0
        self.since_s = session.clock.now()
        self._at = [finger.centre_mm for finger in session.bench.fingers]
        self._seen = self._at
        self.travel_mm = self.stop_s = 0.0
        for finger in session.bench.fingers:
            finger.hardest_n = 0.0

    def look(self) -> None:
        now = self._session.clock.now()
        if now < self._next_s:
            return
        self._next_s = now + 1e-3
        seen = [finger.centre_mm for finger in self._session.bench.fingers]
        gone = max(float(np.hypot(*(b - a))) for a, b in zip(self._at, seen, strict=True))
        self.travel_mm = max(self.travel_mm, gone)
        if any(float(np.hypot(*(b - a))) > 0.05 for a, b in zip(self._seen, seen, strict=True)):
            self.stop_s, self._seen = now - self.since_s, seen


def run_cell(cell: Cell) -> Outcome:
    """Carry it out."""
    make, carry = COMMANDS[cell.command]
    host = Host(make())
    session, watches = host.session, []

    def strike() -> None:
        watch = _Watch(session)
        watches.append(watch)
        session.clock.on_tick = watch.look
        cell.row.strike(host)

    session.clock.after(instant_s(cell.command, cell.phase, cell.draw), strike)
    error: BaseException | None = None
    with TemporaryDirectory() as folder, ExitStack() as ends:
        ends.callback(_let_go, host)
        try:
            carry(host, Path(folder))
        except (Exception, KeyboardInterrupt) as ended:
            error = ended
    if not watches:
        raise AssertionError(f"{cell}: the run ended before the fault") from error
    (watch,) = watches
    ended_s = session.clock.now() - watch.since_s
    for servo in session.servos.values():
        servo.set_supply(12.0)
    session.rest(1.0)
    moved = session.rest(0.5)
    return Outcome(
        None if error is None else type(error).__name__,
        () if error is None else tuple(kind.__name__ for kind in type(error).__mro__),
        "" if error is None else str(error),
        tuple(getattr(error, "__notes__", ())),
        frozenset(dxl_id for dxl_id, on in session.torque().items() if on),
        moved,
        watch.travel_mm,
        max(finger.hardest_n for finger in session.bench.fingers),
        watch.stop_s,
        ended_s,
    )


def _let_go(host: Host) -> None:
    """Whatever hangs may go on, so that its thread ends."""
    host.release.set()
    reader = getattr(host.release, "reader", None)
    if reader is not None:
        os.close(reader)


def problems(cell: Cell, found: Outcome) -> list[str]:
    """What is not as the row says."""
    fault, wrong = cell.row, []
    on = found.torque_on - fault.on
    if on:
        wrong.append(f"torque is on at {sorted(on)}")
    if found.moved_mm > 1e-3:
        wrong.append(f"still moving, {found.moved_mm:.2f} mm in 0.5 s")
    if cell.phase in fault.noticed and found.error is None:
        wrong.append("nobody noticed")
    if cell.phase in fault.noticed and found.ended_s > fault.within_s:
        wrong.append(f"ended {found.ended_s:.1f} s later")
    if found.error is not None:
        if not {kind.__name__ for kind in fault.ends} & set(found.kinds):
            wrong.append(f"ends as {found.error}: {found.message}")
        elif re.search(fault.says, found.message) is None:
            wrong.append(f"says: {found.message}")
        if "\n" in found.message:
            wrong.append("says more than one line")
    if found.error is not None and cell.phase in LOOKED and cell.phase != "torque off":
        if found.hardest_n > FORCE_N and fault.strike is not _shove:
            wrong.append(f"pressed with {found.hardest_n:.1f} N")
        allowed = fault.travel_mm * (_CALIBRATING if cell.command == "calibrate" else 1.0)
        if cell.phase in fault.noticed and found.travel_mm > allowed:
            wrong.append(f"went on for {found.travel_mm:.1f} mm")
    return wrong
