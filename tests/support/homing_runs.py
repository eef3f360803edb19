"""Whole runs on small benches whose fingers start anywhere, undisturbed or with a blink of power."""

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from emulated_session import EmulatedSession, emulated_session
from quick_rig import STAGE, small_objects, small_rig
from repository import EXAMPLES

from palpate.base.errors import PalpateError
from palpate.base.vocabulary import IdentificationVerdict, Strategy
from palpate.config import RigFile, load_rig, shipped_rig
from palpate.recognizer import Catalogue
from palpate.rig.bench import environment
from palpate.rig.session.run import IdentificationJob, run_identification

__all__ = ["RIGS", "Outcome", "anywhere_rig", "run_after_blink", "run_from_anywhere"]

_LONGEST_S = 90.0  # from which instants of blinks are drawn: about as long as a run


@dataclass(frozen=True)
class Outcome:
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


def run_from_anywhere(seed: int, kind: str = "slides") -> Outcome:
    """One run from the posture that the seed draws."""
    return _run(_session(seed, kind), seed)


def run_after_blink(seed: int) -> tuple[Outcome, Outcome]:
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


def _run(session: EmulatedSession, seed: int) -> Outcome:
    begun, first, pushed = session.clock.now(), [0.0], [0.0, 0.0]
    job = IdentificationJob(
        session.rig, Catalogue(small_objects().objects), session.placement, Strategy.PLANNED, seed
    )

    def push() -> None:
        displaced = session.bench.part.displacement
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
    return Outcome(kind, text, on, first[0], hardest(), session.clock.now() - begun, *pushed)


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
