"""Whole runs on a small bench whose slides start anywhere, undisturbed or with a blink of power."""

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from emulated_session import EmulatedSession, emulated_session
from quick_rig import small_objects, small_rig

from palpate.config import RigFile, shipped_rig
from palpate.errors import PalpateError
from palpate.recognizer import Catalogue
from palpate.rig.bench import environment
from palpate.rig.session.run import IdentificationJob, run_identification
from palpate.vocabulary import IdentificationVerdict, Strategy

__all__ = ["Outcome", "anywhere_rig", "run_after_blink", "run_from_anywhere"]

_LONGEST_S = 90.0  # from which instants of blinks are drawn: about as long as a run


@dataclass(frozen=True)
class Outcome:
    """What came of a run: `kind` is right, message, unresolved or wrong.

    `homed`: seconds of the rig's time until the first grip; 0 if none began.
    """

    kind: str
    text: str
    torque_on: tuple[int, ...]
    homed: float
    hardest_n: float
    rig_s: float


@cache
def anywhere_rig() -> RigFile:
    """The XM430 bench, small, whose slides and aims start anywhere."""
    rig = small_rig(shipped_rig("xm430-bench"))
    assert rig.emulation is not None
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"start": "anywhere"})})


def run_from_anywhere(seed: int) -> Outcome:
    """One run from the posture that the seed draws."""
    return _run(_session(seed), seed)


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


def _session(seed: int) -> EmulatedSession:
    return emulated_session(seed=seed, rig=anywhere_rig(), objects=small_objects())


def _run(session: EmulatedSession, seed: int) -> Outcome:
    begun, first = session.clock.now(), [0.0]
    job = IdentificationJob(
        session.rig, Catalogue(small_objects().objects), session.placement, Strategy.PLANNED, seed
    )

    def note(_: object) -> None:
        first[0] = first[0] or session.clock.now() - begun

    kind, text = _ended(lambda: run_identification(job, environment(session.bench_rig), note))
    on = tuple(dxl_id for dxl_id, is_on in session.torque().items() if is_on)
    hardest = max(finger.hardest_n for finger in session.bench.fingers)
    return Outcome(kind, text, on, first[0], hardest, session.clock.now() - begun)


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
