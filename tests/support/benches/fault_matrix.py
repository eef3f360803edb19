"""Faults at every phase of a grip, and their page."""

import os
import random
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palpate.base.errors import OutputError
from palpate.base.vocabulary import Strategy
from palpate.calibration.consistency_checks import contact_uncertainties
from palpate.calibration.measurements import Probe
from palpate.config import (
    RigFile,
    SlideFingerConfig,
    apply_calibration,
    load_objects,
    load_rig,
    shipped_objects,
)
from palpate.recognizer import Catalogue
from palpate.rig.bench import environment
from palpate.rig.commissioning.hand_prober import HandProber
from palpate.rig.diagnostics.calibration_check import retouch
from palpate.rig.diagnostics.motion_checks import check_hold, with_light_touch
from palpate.rig.emulated.scene import ReferencePlacer
from palpate.rig.identification.result import IdentificationJob
from palpate.rig.session.log import SessionLog
from palpate.rig.session.run import run_identification
from support.benches.calibration_files import bench_calibration
from support.benches.fault_rows import FAULTS, JUST_BEFORE, LOOKED, Fault, Host, shove
from support.benches.rigs import firm_rig, small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session
from support.benches.touched_references import DISC
from support.commands.command import log_events
from support.commands.repository import EXAMPLES, ROOT

# ----------------------------------------------------------------------------------------------------
# The fault matrix: every fault, in every phase of every command that moves, on the emulated bench.
#
# A cell runs a command in virtual time, lets the fault happen at an instant of the phase, drawn by a seed,
# and
# looks at the devices themselves afterwards. Which phase an instant belongs to is read off the call stack
# of a
# run without faults, which is the same up to that instant. On the small bench ways are shorter and fingers
# fewer; speeds, frames and limits are those of the whole one.

SEED = 7
_DRAWN_S = 4.0
_CALIBRATING = 1.5  # the rig that is calibrated approaches at 30 mm/s, the shipped one at 20
_LIMIT_N = 8.0  # max_force_n of the rigs, by the slides' current limit
_INERTIA_N = 2.0  # of a finger that runs into the part unstopped at 20 mm/s; it grows with the speed


def _identify(host: Host, folder: Path) -> None:
    session = host.session
    put = session.bench_rig.placements
    job = IdentificationJob(session.rig, Catalogue(host.objects.objects), put, Strategy.PLANNED, SEED, None)
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
        prober = HandProber(hand, ReferencePlacer(session.bench, SEED))
        spec = session.rig.fingers[0]
        assert isinstance(spec, SlideFingerConfig)
        assert spec.slide.stops_mm is not None
        prober.home(0, spec.slide.stops_mm[0])
        prober.swing()
        prober.put(DISC, (0.0, 0.0))
        middles = [_middle(prober, finger) for finger in range(len(session.rig.fingers))]
        touched = prober.touch(middles, 0)
        contacts = [
            Probe(probe.approach, _travel_mm(prober, probe, found.servos_rad[1]))
            for probe, found in zip(middles, touched, strict=True)
            if found is not None
        ]
        prober.press(contacts, 0)
        prober.stop(contacts, session.rig.closing.approach_speed_mm_s)


def _middle(prober: HandProber, finger: int) -> Probe:
    own = [k for k, item in enumerate(prober.approaches) if item.finger == finger]
    best = own[len(own) // 2]
    return Probe(best, prober.approaches[best].length_mm)


def _travel_mm(prober: HandProber, probe: Probe, slide_rad: float) -> float:
    approach = prober.approaches[probe.approach]
    return float(np.interp(slide_rad, approach.servos_rad[:, 1], [0.0, approach.length_mm]))


def _check_touch(host: Host, _folder: Path) -> None:
    session = host.session
    file = bench_calibration(session.rig, SEED)
    promises = contact_uncertainties(file, at_rest=False)
    assert promises is not None
    with environment(session.bench_rig).hand(apply_calibration(session.rig, file)) as hand:
        hand.prepare()
        retouch(session.rig, HandProber(hand, ReferencePlacer(session.bench, SEED)), DISC, promises)


def _check_hold(host: Host, _folder: Path) -> None:
    session = host.session
    with environment(session.bench_rig).hand(with_light_touch(session.rig, 0.0)) as hand:
        hand.prepare()
        check_hold(hand)


def _rig(path: Path, small: bool) -> RigFile:
    if not small:
        return load_rig(path)
    rig = small_rig(path)
    return rig.model_copy(update={"fingers": rig.fingers[:2]})


def _shipped(small: bool, empty: bool = False) -> Host:
    rig = _rig(firm_rig(), small)
    search = rig.search.model_copy(update={"max_grips": 1})
    objects = small_objects() if small else load_objects(shipped_objects())
    rig = rig.model_copy(update={"search": search})
    return Host(emulated_session(seed=SEED, rig=rig, objects=objects, empty=empty), objects)


def _fresh(small: bool) -> Host:
    rig = _rig(EXAMPLES / "fresh-rig.toml", small)
    rig = rig.model_copy(update={"fingers": rig.fingers[:2]})
    return Host(emulated_session(seed=SEED, rig=rig, empty=True))


COMMANDS: dict[str, tuple[Callable[[bool], Host], Callable[[Host, Path], None]]] = {
    "identify": (_shipped, _identify),
    "calibrate": (_fresh, _calibrate),
    "check --touch": (lambda small: _shipped(small, empty=True), _check_touch),
    "check --hold": (_shipped, _check_hold),
}
"""Makes the host, on the small bench or on the whole one, and what it carries out."""

PHASES: Sequence[tuple[str, str]] = (
    ("despite_interruptions", "torque off"),
    ("_connect", "connect"),
    ("prepare", "limits and torque on"),
    ("retract_all", "retract"),
    ("_move_to_starts", "aim"),
    ("tare", "tare"),
    ("move_along_lines", "free travel"),
    ("measure_quasi_statically", "creep"),
    ("push_until_slip", "creep"),
    ("measure_at_rest", "measure"),
    ("_back_off_and_touch", "touch"),
    ("_search_contacts", "approach"),
    ("press", "press"),
    ("stop_at_speed", "stop at speed"),
    ("_stall", "homing"),
    ("creep_to_stall", "homing"),
    ("swing", "swing"),
)
"""Functions and the phases that they are; the first of a stack's counts."""


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
def phases(command: str, small: bool = False) -> dict[str, list[tuple[float, float]]]:
    """When a run without faults is in which phase: intervals of virtual time, s."""
    make, carry = COMMANDS[command]
    host = make(small)
    session = host.session
    spans: dict[str, list[tuple[float, float]]] = {}
    last: list[tuple[str | None, float]] = [(None, 0.0)]
    touched_s: list[float] = []

    def look() -> None:
        phase, now = _phase(), session.clock.now()
        before, since = last[0]
        if phase != before:
            if before is not None and now > since:
                spans.setdefault(before, []).append((since, now))
            last[0] = (phase, now)
        if phase == "approach" and any(finger.press is not None for finger in session.bench.fingers):
            touched_s.append(now)

    session.clock.on_tick = look
    with TemporaryDirectory() as folder:
        carry(host, Path(folder))
    look()
    if touched_s:
        spans[JUST_BEFORE] = [(touched_s[0] - 0.1, touched_s[0] - 0.1)]
    return spans


def instant_s(cell: "Cell") -> float:
    """An instant of a phase, evenly drawn over the first seconds of it: later ones are more of the same."""
    spans = phases(cell.command, cell.small)[cell.phase]
    whole = min(_DRAWN_S, sum(until - since for since, until in spans))
    at = random.Random(f"{cell.command} {cell.phase} {cell.draw}").uniform(0.02, 0.98) * whole
    for since, until in spans:
        if at <= until - since:
            return since + at
        at -= until - since
    return spans[-1][1]


@dataclass(frozen=True)
class Cell:
    """One fault at one instant of one phase of one command."""

    command: str
    phase: str
    fault: int | Fault
    draw: int = 0
    small: bool = False

    @property
    def row(self) -> Fault:
        """Its fault."""
        return FAULTS[self.fault] if isinstance(self.fault, int) else self.fault

    def __str__(self) -> str:
        return f"{self.command}, {self.phase}: {self.row.name}"


@dataclass(frozen=True)
class Outcome:
    """What came of a cell, as the devices have it.

    `stop_s`: from the fault until no tip moved any more; `ended_s`: until the command had ended. `log`: what
    is wrong with the session log, if there is one.
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
    log: str = ""


def cells(draws: int = 1) -> list[Cell]:
    """All of them."""
    return [
        Cell(command, phase, number, draw)
        for command in COMMANDS
        for phase in phases(command)
        for number, fault in enumerate(FAULTS)
        if not fault.only or command in fault.only
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
    host = make(cell.small)
    session, watches = host.session, []

    def strike() -> None:
        watch = _Watch(session)
        watches.append(watch)
        session.clock.on_tick = watch.look
        cell.row.strike(host)

    session.clock.after(instant_s(cell), strike)
    error: BaseException | None = None
    with TemporaryDirectory() as folder, ExitStack() as ends:
        ends.callback(_let_go, host)
        try:
            carry(host, Path(folder))
        except (Exception, KeyboardInterrupt) as ended:
            error = ended
        log = ""
        if host.log is not None and OutputError not in cell.row.ends:  # else its disk may cut a line in two
            log = _log_trouble(host.log.path, error)
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
        log,
    )


def _log_trouble(path: Path, error: BaseException | None) -> str:
    """What keeps a log from being whole and saying how the run ended."""
    events = log_events(path)
    times = [event["t_s"] for event in events]
    how = "done" if error is None else type(error).__name__
    if (events[0]["event"], events[-1]["event"], events[-1].get("how")) != ("session", "end", how):
        return f"from {events[0]} to {events[-1]}"
    return "" if times == sorted(times) else "times that go back"


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
    if found.log:
        wrong.append(f"the log goes {found.log}")
    if found.error is not None and cell.phase in LOOKED and cell.phase != "torque off":
        faster = _CALIBRATING if cell.command == "calibrate" else 1.0
        if found.hardest_n > _LIMIT_N + _INERTIA_N * faster and fault.strike is not shove:
            wrong.append(f"pressed with {found.hardest_n:.1f} N")
        allowed = fault.travel_mm * faster
        if cell.phase in fault.noticed and found.travel_mm > allowed:
            wrong.append(f"went on for {found.travel_mm:.1f} mm")
    return wrong


# ----------------------------------------------------------------------------------------------------
# The table of docs/safety.md, written from the fault matrix.

PAGE = ROOT / "docs" / "safety.md"
_BEGIN, _END = "<!-- fault matrix: begin -->\n", "<!-- fault matrix: end -->"


def table() -> str:
    """One row a fault."""
    lines = [
        "| fault | what the stack does | what the operator sees | torque that may stay on |",
        "|---|---|---|---|",
    ]
    for fault in FAULTS:
        stays = fault.excuse or "none"
        lines.append(f"| {fault.name} | {fault.does} | {fault.sees} | {stays} |")
    return "\n".join(lines) + "\n"


def table_of_page() -> str:
    """The table as it stands on the page."""
    text = PAGE.read_text(encoding="utf-8")
    return text[text.index(_BEGIN) + len(_BEGIN) : text.index(_END)]


def write_page() -> None:
    """Write the table anew."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = text.index(_BEGIN) + len(_BEGIN), text.index(_END)
    PAGE.write_text(text[:begin] + table() + text[end:], encoding="utf-8")
