"""Observers of a run: told what happens as it happens, beside the thread that drives devices."""

from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Protocol, Self

from palpate.recognizer import Grip, Recognition
from palpate.rig.background import Background, failed
from palpate.rig.motion.guarded_approach import Stage, Touch

__all__ = ["Observer", "Observers"]

_CAPACITY = 1_000
_PATIENCE_S = 2.0  # for what they were told last


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

    One that has raised is told nothing more, and ends the run at its next grip; one that does not return
    misses what follows.
    """

    def __init__(self, observers: Sequence[Observer], record: Observer | None = None) -> None:
        """`record` is told on the calling thread, first; it must neither raise nor wait."""
        self._record = record
        self._beside = [(observer, Background(_tell, _CAPACITY)) for observer in observers]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for _, background in self._beside:
            background.close(_PATIENCE_S)
        if error is None:
            self.check()

    def check(self) -> None:
        """Raise OutputError if an observer has raised."""
        for observer, background in self._beside:
            if background.failure is not None:
                what = f"observer {type(observer).__name__}"
                raise failed(what, background.failure) from background.failure

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
        for observer, background in self._beside:
            background.put(partial(what, observer))


def _tell(calls: Sequence[Callable[[], None]]) -> None:
    for call in calls:
        call()
