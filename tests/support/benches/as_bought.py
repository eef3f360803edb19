"""A rig as it comes out of its boxes."""

import random
import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from palpate.base.errors import PalpateError
from palpate.base.vocabulary import IdentificationVerdict, Strategy
from palpate.config import RigFile, load_rig, shipped_rig
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.recognizer import Catalogue
from palpate.rig.bench import choose_placements, environment, set_up
from palpate.rig.identification.result import IdentificationJob
from palpate.rig.session.run import run_identification
from support.benches.rigs import STAGE, firm_rig, small, small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# What a first day on hardware brings, emulated: each row is something of adapters or mechanics.
#
# A run ends with the right answer, within its bounds; or with the row's own message or verdict; with torque
# off in both cases, as the emulated servos themselves say.

_TORQUE_ENABLE = 64


@dataclass(frozen=True)
class Row:
    """One thing that is different: keys of `[emulation]` in TOML, and what may be said instead of an answer.

    `says`: a pattern of the error's line, or of a verdict that is no answer; "" if only the right answer will
    do. `bounds`: changes to the rig file's text, by which it declares what the row needs declared. `unsure`:
    why an answer may be outside of its bounds here, which then counts by itself; "" if it must not.
    """

    name: str
    emulation: str
    says: str = ""
    bounds: tuple[tuple[str, str], ...] = ()
    unsure: str = ""


@dataclass(frozen=True)
class Outcome:
    """What came of a run: `kind` is right, message, unsure or wrong; `rig_s` of runs that were answered."""

    kind: str
    text: str
    rig_s: float
    hardest_n: float
    torque_on: tuple[int, ...]
    notices: tuple[str, ...]


_GONE = r"failed|is gone|does not answer|do not answer|did not answer|sent no frame|has sent"
_HELD = "did not reach|is held"
_POWER = "hardware error|restarted|not answer"
_TAKEN = "another program"
_NO_ANSWER = "moving|unknown|unresolved|indistinguishable"
_DEFLECTION = (("heading_deg = 0.02\n", "heading_deg = 0.02\ndeflection_mm_per_n = 0.06\n"),)

ROWS: tuple[Row, ...] = (
    Row("as it should be", ""),
    Row("latency timer of 1 ms", "bus_adapter = {latency_ms = 1}\narray_adapter = {latency_ms = 1}"),
    Row("latency timer of 16 ms at the bus", "bus_adapter = {latency_ms = 16}"),
    Row(
        "latency timer of 16 ms everywhere",
        "bus_adapter = {latency_ms = 16}\narray_adapter = {latency_ms = 16}",
    ),
    Row("bus's hub stalls for 20 … 80 ms", "bus_adapter = {stall_ms = [20, 80], stall_every_s = 1}", _GONE),
    Row(
        "bus's hub stalls for 100 … 400 ms",
        "bus_adapter = {stall_ms = [100, 400], stall_every_s = 5}",
        _GONE + "|too late|above max_force_n",
    ),
    Row(
        "arrays' hub stalls for 20 … 80 ms", "array_adapter = {stall_ms = [20, 80], stall_every_s = 1}", _GONE
    ),
    Row(
        "arrays' hub stalls for 100 … 400 ms",
        "array_adapter = {stall_ms = [100, 400], stall_every_s = 20}",
        _GONE,
    ),
    Row("bus's adapter echoes", "bus_adapter = {echoes = true}"),
    Row("arrays' adapters echo", "array_adapter = {echoes = true}"),
    Row("bus's adapter goes and comes back", "bus_adapter = {gone_after_s = [1, 25]}", "port .* failed"),
    Row(
        "bus's adapter comes back under another name",
        'bus_adapter = {gone_after_s = [1, 25], comes_back_as = "other"}',
        "port .* failed",
    ),
    Row("an array's adapter goes and comes back", "array_adapter = {gone_after_s = [1, 25]}", _GONE),
    Row(
        "an array's adapter comes back under another name",
        'array_adapter = {gone_after_s = [1, 25], comes_back_as = "other"}',
        _GONE,
    ),
    Row("another program has the bus's port for 15 s", "bus_adapter = {grabbed_s = 15}", _TAKEN),
    Row("another program has the arrays' ports for 15 s", "array_adapter = {grabbed_s = 15}", _TAKEN),
    Row("arrays reset as their ports open", "array_boot_s = 1.5"),
    Row("an array resets in a run", "array_reset_s = [1, 25]\narray_boot_s = 0.8", _GONE),
    Row("friction of 1 … 2.4 times the model's", "mechanics = {friction = [1, 2.4]}", _HELD),
    Row("friction of 3 … 4 times: more than max_force_n", "mechanics = {friction = [3, 4]}", _HELD),
    Row("twice the friction at rest", "mechanics = {rest_friction = [1.5, 2.3]}", _HELD),
    Row("3 … 4 times the friction at rest", "mechanics = {rest_friction = [3, 4]}", _HELD),
    Row("cogging", "mechanics = {cogging = [0.3, 1]}", _HELD),
    Row("warm motors", "mechanics = {torque_loss = [0.1, 0.25]}", _HELD),
    Row("a supply of 0.5 … 4 ohm", "mechanics = {supply_ohm = [0.5, 4]}", _POWER),
    Row("a supply of 30 … 60 ohm", "mechanics = {supply_ohm = [30, 60]}", _POWER + "|torque off"),
    Row("cables that pull", "mechanics = {cable_n = [-1, 1]}", _HELD),
    Row(
        "slides that give way under load",
        "mechanics = {slide_deflection_mm_per_n = [0.02, 0.06]}",
        bounds=_DEFLECTION,
    ),
    Row(
        "a screw that slips",
        "mechanics = {slip_mm = [0.5, 3], slip_after_s = [3, 20]}",
        _NO_ANSWER,
        unsure="a slide that has slipped looks like a part that lies elsewhere",
    ),
    Row(
        "a screw that slips, with check_slips",
        "mechanics = {slip_mm = [0.5, 3], slip_after_s = [20, 30]}",
        _NO_ANSWER + "|meets its back stop",
        bounds=(
            ("max_grips = 12", "max_grips = 12\ncheck_slips = true"),
            ("zero_mm = 40.0", "zero_mm = 40.0\nstops_mm = [42.0, 253.0]"),
        ),
    ),
)


def rig_of(row: Row) -> RigFile:
    """The small firm bench with what the row declares."""
    text = small(firm_rig())
    for old, new in row.bounds:
        assert old in text
        text = text.replace(old, new)
    described = tomllib.loads(text)
    described["emulation"] |= tomllib.loads(row.emulation)
    return RigFile.model_validate(described)


def run_row(row: Row, seed: int) -> Outcome:
    """Identify a part of the small catalogue, drawn by the seed."""
    rig, objects, notices = rig_of(row), small_objects(), list[str]()
    (placement,) = choose_placements(rig, objects, None, seed)
    bench = set_up(rig, [placement], seed)
    job = IdentificationJob(rig, Catalogue(objects.objects), (placement,), Strategy.PLANNED, seed, None)
    rig_s = 0.0
    try:
        run = run_identification(job, environment(bench), notice=notices.append)
    except PalpateError as error:
        text = "; ".join([str(error), *getattr(error, "__notes__", [])])
        kind = "message" if row.says and re.search(row.says, text) else "wrong"
    else:
        out = run.out(wall_seconds=0.0, session=None)
        assert out.truth is not None
        text, rig_s = f"{out.verdict} {out.object}", out.rig_seconds
        if out.verdict == IdentificationVerdict.IDENTIFIED:
            kind = "right" if out.truth.named and out.truth.inside_bounds else "wrong"
            if row.unsure and out.truth.named and not out.truth.inside_bounds:
                kind = "unsure"
        else:
            kind = "message" if row.says and re.search(row.says, out.verdict) else "wrong"
    assert bench.emulated is not None
    fingers = bench.emulated.bench.fingers
    on = tuple(servo.dxl_id for finger in fingers for servo in finger.servos if _is_on(servo))
    if on:
        kind = "wrong"
    return Outcome(kind, text, rig_s, max(f.hardest_n for f in fingers), on, tuple(notices))


def _is_on(servo: EmulatedServo) -> bool:
    """Whether a servo holds its shaft, as it says itself."""
    answer = servo.answer_block(_TORQUE_ENABLE, 1)
    return bool(answer is not None and answer.params[0])


# ----------------------------------------------------------------------------------------------------
# Whole runs on small benches whose fingers start anywhere, undisturbed or with a blink of power.

_LONGEST_S = 90.0  # from which instants of blinks are drawn: about as long as a run


@dataclass(frozen=True)
class HomingOutcome:
    """What came of a run: `kind` is right, message, unresolved or wrong.

    `homed`: seconds of the rig's time until the first grip; 0 if none began. `at_start_n`, `moved_mm`: the
    hardest that a tip pressed until then, and how far the part was moved by it.
    """

    kind: str
    text: str
    torque_on: tuple[int, ...]
    homed: float
    hardest_n: float
    rig_s: float
    at_start_n: float
    moved_mm: float


RIGS = ("slides", "arms", "stage")
"""Benches that `anywhere_rig` knows."""

_PART = {"engine": "quasi-static", "mass_kg": [1.5, 3.0]}


@cache
def anywhere_rig(kind: str = "slides") -> RigFile:
    """A small bench that starts anywhere: the XM430's, the same on a turning stage, or three arms."""
    if kind == "arms":
        rig = load_rig(EXAMPLES / "two-link-rig.toml")
        rig = rig.model_copy(update={"workspace": rig.workspace.model_copy(update={"radius_mm": 70.0})})
    else:
        rig = small_rig(shipped_rig("xm430-bench"))
    data = rig.model_dump(mode="json", exclude_unset=True)
    data["emulation"] |= {"start": "anywhere"}
    if kind == "arms":
        data["emulation"] |= {"part": _PART}
        data["search"] |= {"part_holds_n": 4.0, "part_support_mm": 20.0}
    if kind == "stage":
        data["stage"] = STAGE
        data["emulation"] |= {"stage_backlash_deg": 0.02, "stage_error_deg": 0.02}
    return RigFile.model_validate(data)


def run_from_anywhere(seed: int, kind: str = "slides") -> HomingOutcome:
    """One run from the posture that the seed draws."""
    return _run(_session(seed, kind), seed)


def run_after_blink(seed: int) -> tuple[HomingOutcome, HomingOutcome]:
    """A run in which one servo is without power for a moment, and the next one on the same bench."""
    session, rng = _session(1000 + seed), random.Random(seed)
    servo = session.servos[rng.choice(sorted(session.servos))]
    lasts_s = rng.choice((0.0, 0.002, 0.02, 0.2))

    def blink() -> None:
        servo.power_off()
        session.clock.after(lasts_s, servo.power_on)

    session.clock.after(rng.uniform(0.0, _LONGEST_S), blink)
    return _run(session, seed), _run(session, seed)


def _session(seed: int, kind: str = "slides") -> EmulatedSession:
    return emulated_session(seed=seed, rig=anywhere_rig(kind), objects=small_objects())


def _run(session: EmulatedSession, seed: int) -> HomingOutcome:
    begun, first, pushed = session.clock.now(), [0.0], [0.0, 0.0]
    job = IdentificationJob(
        session.rig, Catalogue(small_objects().objects), session.bench_rig.placements, Strategy.PLANNED, seed
    )

    def push() -> None:
        displaced = session.bench.parts.displacements[0]
        pushed[:] = hardest(), float(np.hypot(*displaced.shift_mm))

    def hardest() -> float:
        return max(finger.hardest_n for finger in session.bench.fingers)

    def note(_: object) -> None:
        if not first[0]:
            first[0] = session.clock.now() - begun
            push()

    kind, text = _ended(lambda: run_identification(job, environment(session.bench_rig), note))
    on = tuple(dxl_id for dxl_id, is_on in session.torque().items() if is_on)
    if not first[0]:
        push()
    return HomingOutcome(kind, text, on, first[0], hardest(), session.clock.now() - begun, *pushed)


def _ended(run: Callable[[], object]) -> tuple[str, str]:
    try:
        done = run()
    except PalpateError as error:
        return "message", str(error)
    out = done.out(wall_seconds=1.0, session=None)  # type: ignore[attr-defined]
    if out.verdict is not IdentificationVerdict.IDENTIFIED:
        return "unresolved", out.verdict.value
    right = out.truth is not None and out.truth.named and out.truth.inside_bounds
    return ("right" if right else "wrong"), out.verdict.value
