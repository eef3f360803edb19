"""Proof, in a run's first contacts, that each array is on the finger that the rig file says.

Nothing but a touch shows which finger carries an array. If arrays or servo ids are exchanged, the finger
whose array feels the part stops, and the one that presses goes on. So all fingers are stopped at the first
contact of each array, as soon as a right rig stops the one. Then the finger goes back, and its array must
feel nothing any more. Likewise where an array feels a force while its finger stands, and those that move feel
none.
"""

from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Protocol

from palpate.base.errors import SafetyStop
from palpate.config import RigFile
from palpate.drivers.tactile import TactileFrame
from palpate.rig.fingers import HostFinger
from palpate.rig.motion.array_guard import ArrayReading
from palpate.rig.motion.touch import ApproachState

_FRAMES = 8  # whose median is compared
_SETTLE_S = 0.04
_LEFT_SHARE = 0.5  # of contact_force_n: a finger that has come free feels less
_MAX_RETREATS = 2  # the second one twice as far: fingers may have run further into it than they back off


class _Hand(Protocol):
    """Part of a hand that proofs need."""

    proven: set[HostFinger]

    @property
    def rig(self) -> RigFile: ...

    @property
    def fingers(self) -> Sequence[HostFinger]: ...

    def reading(self, finger: HostFinger, /) -> ArrayReading: ...

    def settle(self, fingers: Sequence[HostFinger], seconds: float, /) -> None: ...

    def collect(self, fingers: Sequence[HostFinger], count: int, /) -> list[list[TactileFrame]]: ...


Retreat = Callable[[Mapping[ApproachState, float]], None]
"""Moves fingers along their lines, back to travels (mm)."""


class SearchWatch:
    """Watch over all arrays while fingers search; `suspect`: whose contact must be proven.

    From then on no finger goes on outwards.
    """

    def __init__(self, hand: _Hand, runs: Sequence[ApproachState]) -> None:
        self._hand, self._runs = hand, runs
        self._free: set[HostFinger] = set()
        self.suspect: HostFinger | None = None

    def look(self) -> HostFinger | None:
        """The suspect, by the newest readings."""
        if self.suspect is not None:
            return self.suspect
        hand, contact_n = self._hand, self._hand.rig.closing.contact_force_n
        searching = [run.finger for run in self._runs if run.searching]
        for finger in hand.fingers:
            if not finger.spec.array.has_device:
                continue  # its servos' currents are its own
            reading = hand.reading(finger)
            if reading.force_n <= contact_n:
                if reading.frames and finger not in searching and reading.force_n <= _LEFT_SHARE * contact_n:
                    self._free.add(finger)  # it stands, and has felt nothing there
            elif finger in searching:
                if len(searching) == 1:
                    hand.proven.add(finger)
                elif finger not in hand.proven:
                    self.suspect = finger
            elif finger in self._free and searching and not any(hand.reading(f).force_n for f in searching):
                self.suspect = finger
        return self.suspect

    def prove(self, moved: Sequence[ApproachState], retreat: Retreat) -> ApproachState | None:
        """Let the suspect go back, if it is among those that have `moved`; it is returned.

        All stand. Raises SafetyStop if that does not end the force on its array: once the others have gone
        back, too, it says whose way back did.
        """
        finger, back_mm = self.suspect, self._hand.rig.closing.back_off_mm
        assert finger is not None
        own = next((run for run in moved if run.finger is finger), None)
        others = [run for run in moved if run is not own]
        felt_n = self._force_n(finger)
        if own is None and (self._is_left(felt_n) or any(self._force_n(run.finger) for run in others)):
            return None  # a disturbance is over, or the part is pushed by a finger that feels it
        gone: list[str] = []
        for run in (*([] if own is None else [own]), *others):
            for times in range(1, _MAX_RETREATS + 1):
                retreat({run: max(0.0, run.travel_mm - times * back_mm)})
                left_n = self._force_n(finger)
                if not self._is_left(left_n):
                    continue
                if run is own:
                    if not self._is_left(felt_n):
                        self._hand.proven.add(finger)
                    return own
                raise SafetyStop(
                    f"array {finger.name} felt {felt_n:.2g} N until finger {run.name} went back; finger "
                    f"{finger.name} {'had gone back before' if own else 'stood'}: the arrays of "
                    f"{finger.name} and {run.name}, or their servos' ids, may be exchanged; fingers were "
                    "stopped; palpate check --press shows which array answers"
                )
            gone.append(run.name)
        raise SafetyStop(
            f"array {finger.name} felt {felt_n:.2g} N, and still feels {left_n:.2g} N after "
            f"{' and '.join(gone)} went back; fingers were stopped; palpate check with nothing near the tips "
            "shows whether its zero moves"
        )

    def _force_n(self, finger: HostFinger) -> float:
        """Force on an array while all fingers stand."""
        self._hand.settle([finger], _SETTLE_S)
        (frames,) = self._hand.collect([finger], _FRAMES)
        return median(finger.extractor.force_n(frame) for frame in frames)

    def _is_left(self, force_n: float) -> bool:
        return force_n <= _LEFT_SHARE * self._hand.rig.closing.contact_force_n
