"""Events of an identification, and observers, called with each beside the thread that drives devices."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from palpate.base.errors import PalpateError
from palpate.base.short_repr import ShortRepr
from palpate.recognizer import Grip, Recognition
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.workers import BackgroundCall


@dataclass(frozen=True, eq=False, repr=False)
class StageEvent(ShortRepr):
    """Fingers began a stage of a grip. Grips count from 1."""

    grip: int
    stage: GripPhase


@dataclass(frozen=True, eq=False, repr=False)
class TouchEvent(ShortRepr):
    """A grip was carried out: a touch for each of its fingers, misses included."""

    grip: int
    touches: Sequence[Touch]


@dataclass(frozen=True, eq=False, repr=False)
class RecognitionEvent(ShortRepr):
    """All contacts so far were interpreted.

    Where several parts are sought, `recognition` and `others` are of those that the leading division of the
    touches has, as far as they were touched enough, and `divisions` are left; None where one is.
    """

    grip: int
    recognition: Recognition
    others: tuple[Recognition, ...] = ()
    divisions: int | None = None


@dataclass(frozen=True, eq=False, repr=False)
class PlanEvent(ShortRepr):
    """The next grip was chosen by what hypotheses predict of it. `reason`: why the run goes on, in words."""

    grip: int
    plan: Grip
    reason: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class MoveEvent(ShortRepr):
    """Earlier contacts no longer count from this grip on: it contradicts them, or the part may lie elsewhere.

    `furthest_mm`: as far as fingers may have moved the part, more than contacts can be carried over; None
    where the grip contradicts them.
    """

    grip: int
    furthest_mm: float | None = None


Event = StageEvent | TouchEvent | RecognitionEvent | PlanEvent | MoveEvent
Observer = Callable[[Event], None]


class Observers:
    """Several observers as one that neither raises nor waits. Use as a context manager.

    One that has raised is called no more, and ends the run before its next grip (`check`); at the end of the
    run it is `late_failure`. One that does not return misses what follows.
    """

    def __init__(self, observers: Sequence[Observer] = (), record: Observer | None = None) -> None:
        """`record` is called on the calling thread, first; it must neither raise nor wait."""
        self._record = record
        self._beside = [
            BackgroundCall(f"observer {type(observer).__name__}", observer) for observer in observers
        ]

    def __call__(self, event: Event) -> None:
        """Pass an event on."""
        if self._record is not None:
            self._record(event)
        for observer in self._beside:
            observer(event)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for observer in self._beside:
            observer.__exit__(kind, error, trace)

    def check(self) -> None:
        """Raise OutputError if an observer has raised: ends the run that is under way."""
        for observer in self._beside:
            observer.check()

    @property
    def late_failure(self) -> PalpateError | None:
        """OutputError if an observer has raised, to be reported beside the result of a complete run."""
        failures = (observer.late_failure for observer in self._beside)
        return next((failure for failure in failures if failure is not None), None)
