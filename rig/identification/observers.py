"""Observers of a run: told what happens as it happens, beside the thread that drives devices."""

from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Protocol, Self

from palpate.errors import PalpateError
from palpate.recognizer import Grip, Recognition
from palpate.rig.background import BackgroundCall
from palpate.rig.motion.guarded_approach import Stage, Touch

__all__ = ["Observer", "Observers"]


class Observer(Protocol):
    """Told what happens, as it happens: progress display, session log."""

    def stage(self, grip: int, stage: Stage) -> None:
        """Fingers began something."""
        ...

    def touches(self, grip: int, touches: Sequence[Touch]) -> None:
        """A grip was carried out."""
        ...

    def recognised(self, grip: int, recognition: Recognition) -> None:
        """All contacts so far were understood."""
        ...

    def planned(self, grip: int, plan: Grip) -> None:
        """The next grip was chosen to tell hypotheses apart."""
        ...

    def moved(self, grip: int) -> None:
        """The part seems to have been moved before this grip: what was felt earlier counts no more."""
        ...


class Observers:
    """Several observers as one that neither raises nor waits. Use as a context manager.

    One that has raised is told nothing more, and ends the run at its next grip (`check`); at the end of the
    run it is `late_failure`. One that does not return misses what follows.
    """

    def __init__(self, observers: Sequence[Observer] = (), record: Observer | None = None) -> None:
        """`record` is told on the calling thread, first; it must neither raise nor wait."""
        self._record = record
        self._beside = [
            BackgroundCall(f"observer {type(observer).__name__}", partial(_tell, observer))
            for observer in observers
        ]

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

    def stage(self, grip: int, stage: Stage) -> None:
        """Fingers began something."""
        self._tell(lambda observer: observer.stage(grip, stage))

    def touches(self, grip: int, touches: Sequence[Touch]) -> None:
        """A grip was carried out."""
        self._tell(lambda observer: observer.touches(grip, touches))

    def recognised(self, grip: int, recognition: Recognition) -> None:
        """All contacts so far were understood."""
        self._tell(lambda observer: observer.recognised(grip, recognition))

    def planned(self, grip: int, plan: Grip) -> None:
        """The next grip was chosen."""
        self._tell(lambda observer: observer.planned(grip, plan))

    def moved(self, grip: int) -> None:
        """The part seems to have been moved before this grip."""
        self._tell(lambda observer: observer.moved(grip))

    def _tell(self, what: Callable[[Observer], None]) -> None:
        if self._record is not None:
            what(self._record)
        for observer in self._beside:
            observer(what)


def _tell(observer: Observer, what: Callable[[Observer], None]) -> None:
    what(observer)
