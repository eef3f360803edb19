"""Grips that a caller chose, in a session's log: written while they are carried out, and replayed.

Whoever chooses grips may do so by whatever means, so a replay does not choose again: it carries out the
recorded approaches with the same code, and every byte and every touch must come about again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

from pydantic import TypeAdapter, ValidationError

from palpate.base.errors import InputError
from palpate.config import CalibrationFile, RigFile
from palpate.drivers.transport import Replayer
from palpate.recognizer import Configuration, FingerApproach
from palpate.rig.conversion import finger_of
from palpate.rig.emulated.hidden_truth import PartTruth
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.events import StageEvent, TouchEvent
from palpate.rig.identification.result import Truth, WiringProof
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.hand import Environment, Hand
from palpate.rig.motion.touch import Touch
from palpate.rig.session.log import SessionEvents
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.session.run import TRUTH_EVENT, Replayed, prepared_hand, replay_with

_GRIP_EVENT, _LEFT_EVENT = "grip", "left"


class GripRecorder:
    """Carries out grips and tells a session's log, if there is one, of each."""

    def __init__(
        self,
        events: SessionEvents | None = None,
        placements_now: Callable[[], tuple[Placement, ...]] | None = None,
    ) -> None:
        """`placements_now`: how parts on an emulated table lie now, in the answers' frame."""
        self._events, self._placements_now = events, placements_now
        self._at_measurement: list[tuple[Configuration, ...]] = []
        self.grips: list[Sequence[Touch]] = []
        """Touches of every grip that was carried out."""

    def carry_out(self, hand: Hand, approaches: Sequence[FingerApproach]) -> list[Touch]:
        """Touches of a grip; raises as `carry_out_grip`."""
        number, events = len(self.grips) + 1, self._events
        if events is None:
            touches = carry_out_grip(hand, approaches, lambda _: None)
        else:
            told = [_values_of(item) for item in approaches]
            events.event(_GRIP_EVENT, grip=number, approaches=told)
            touches = carry_out_grip(hand, approaches, lambda stage: self._tell(number, stage, events))
            events(TouchEvent(number, touches))
        self.grips.append(touches)
        return touches

    def _tell(self, number: int, stage: GripPhase, events: SessionEvents) -> None:
        events(StageEvent(number, stage))
        if stage is GripPhase.RETRACTING and self._placements_now is not None:
            self._at_measurement.append(tuple(item.configuration for item in self._placements_now()))

    def tell_left(self, how: str, message: str) -> None:
        """Log that the caller's own error ends the connection."""
        if self._events is not None:
            self._events.event(_LEFT_EVENT, how=how, message=message)

    def tell_truth(self, parts: Sequence[PartTruth]) -> None:
        """Log what lay on an emulated table; `parts`: how each of them moves, empty if nothing moves them."""
        if self._events is None or self._placements_now is None:
            return
        by_part = list(zip(*self._at_measurement, strict=True))
        placements = self._placements_now()
        truth = Truth(placements, by_part or [()] * len(placements))
        self._events.event(TRUTH_EVENT, **truth.values(parts))


def _values_of(approach: FingerApproach) -> dict[str, Any]:
    return {key: value for key, value in asdict(approach).items() if key != "finger"}


_APPROACH_KEYS = {item.name for item in fields(FingerApproach)} - {"finger"}
_POINT = TypeAdapter(tuple[float, float])


def _approaches_in(values: Mapping[str, Any], rig: RigFile, file: SessionFile) -> list[FingerApproach]:
    """Approaches of the event `grip`. Raises InputError for one that palpate does not write."""
    try:
        return [_approach_in(item, rig) for item in values["approaches"]]
    except (KeyError, TypeError, IndexError, ValidationError):
        raise InputError(
            f'{file.path}: an event "{_GRIP_EVENT}" must have a list of approaches with '
            f"{', '.join(sorted(_APPROACH_KEYS))}"
        ) from None


def _approach_in(values: Mapping[str, Any], rig: RigFile) -> FingerApproach:
    known = {key: values[key] for key in _APPROACH_KEYS}
    start = _POINT.validate_python(known.pop("start_mm"))
    return FingerApproach(finger=finger_of(rig.fingers[known["finger_index"]]), start_mm=start, **known)


def replay_grips(
    file: SessionFile,
    rig: RigFile,
    calibration: CalibrationFile | None,
    proof: WiringProof | None,
    latency_s: float,
) -> Replayed:
    """Carry out a session's grips again, against what was recorded.

    Raises InputError for events that palpate does not write.
    """
    carried = [_approaches_in(values, rig, file) for values in file.told(_GRIP_EVENT)]
    left, truths = file.told(_LEFT_EVENT), file.told(TRUTH_EVENT)

    def again(replayer: Replayer, events: SessionEvents) -> None:
        environment = Environment(replayer.clock, replayer.open, latency_s)
        grips = GripRecorder(events)
        try:
            with prepared_hand(environment, rig, calibration, proof, lambda _: None) as hand:
                for approaches in carried:
                    grips.carry_out(hand, approaches)
                for values in left:
                    how, message = str(values.get("how")), str(values.get("message"))
                    grips.tell_left(how, message)
                    # The caller's error is of a kind that need not exist here; by name it is the same.
                    raise type(how, (Exception,), {})(message)
        finally:
            for values in truths:  # an engine moved the part, and a replay has none
                events.event(TRUTH_EVENT, **values)

    return replay_with(file, rig.bus.port, again)
