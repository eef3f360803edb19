"""A run from the first port to the answer: what `identify` does on devices and `replay` on a recording.

Where an emulated part really was is an event of the log: an engine moves the part, and a replay has none.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime

from pydantic import BaseModel, ValidationError

from palpate.base.errors import InputError, PalpateError
from palpate.base.short_repr import ShortRepr
from palpate.base.vocabulary import Strategy
from palpate.config import CalibrationFile, RigFile
from palpate.config.fields import Number
from palpate.config.recognition_results import CalibrationUsedOut, IdentificationOut
from palpate.recognizer import Catalogue, Configuration
from palpate.rig.emulated.part_truth import PartTruth
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.grip_choice import NotBounded, StabilityTable
from palpate.rig.identification.loop import Identification, identify
from palpate.rig.identification.motion_bounds import MotionBounds
from palpate.rig.identification.observers import Event, Observer, Observers, StageEvent
from palpate.rig.identification.result import RunFacts, identification_out
from palpate.rig.motion.end_stops import check_slips, slides_at_stops
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.hand import Environment
from palpate.rig.session.calibration_drift import calibration_used, check_devices
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.workers import BackgroundCall

TRUTH_EVENT = "truth"


@dataclass(frozen=True, eq=False)
class Truth:
    """What lay on an emulated table, in the frame of the answers.

    `placement`: how it lay when the fingers had left. `at_measurement`: where it was when each grip's
    contacts were measured, None if that was not noted.
    """

    placement: Placement
    at_measurement: Sequence[Configuration] | None = None

    def values(self, part: PartTruth | None) -> dict[str, object]:
        """Values of the event; `part`: how the part moves, None if nothing moves it."""
        return {
            "object": self.placement.model.name,
            "state": self.placement.state.name,
            "configuration": self.placement.configuration,
            "at_measurement": self.at_measurement,
            "part": part and asdict(part) | {"slip_n": part.slip_n},
        }


class _ConfigurationText(BaseModel):
    x_mm: Number
    y_mm: Number
    theta_rad: Number

    def value(self) -> Configuration:
        return Configuration(self.x_mm, self.y_mm, self.theta_rad)


class _TruthText(BaseModel):
    configuration: _ConfigurationText
    at_measurement: list[_ConfigurationText]


def recorded_truth(file: SessionFile, placement: Placement) -> Truth | None:
    """The truth that a session's log holds; None if it was recorded before logs held it.

    `placement`: what lay on the table and where it was put. Raises InputError for an event that palpate does
    not write.
    """
    events = file.told(TRUTH_EVENT)
    if not events:
        return None
    try:
        text = _TruthText.model_validate(events[-1])
    except ValidationError:
        raise InputError(
            f'{file.path}: the event "{TRUTH_EVENT}" must have a configuration and the list at_measurement'
        ) from None
    at = text.configuration
    placement = replace(placement, x_mm=at.x_mm, y_mm=at.y_mm, theta_rad=at.theta_rad)
    return Truth(placement, [item.value() for item in text.at_measurement])


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationJob(ShortRepr):
    """What a run starts from; `placement`, in the answer's frame, is what an emulated table is set with.

    `calibration` is in `rig` already, and refused if other devices are connected than it was made with.
    `started`: when the run began, from which the calibration's age counts; None: the answer tells nothing of
    the calibration.
    """

    rig: RigFile
    catalogue: Catalogue
    placement: Placement | None
    strategy: Strategy
    seed: int
    calibration: CalibrationFile | None = None
    started: datetime | None = None


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationRun(ShortRepr):
    """What came of a run, and the rig's own time (s) at its end.

    `truth`: what lay on an emulated table and where, in the answer's frame, to be compared with the answer.
    `late_failure`: an observer or the display failed at the end; that has no part in the result.
    """

    job: IdentificationJob
    result: Identification
    emulated: bool
    rig_seconds: float
    truth: Truth | None
    late_failure: PalpateError | None

    def out(self, *, wall_seconds: float, session: str | None) -> IdentificationOut:
        """The answer as `palpate/identification@1`."""
        strategy, calibration = self.job.strategy, self._calibration()
        return identification_out(
            self.result,
            None if self.truth is None else self.truth.placement,
            RunFacts(self.emulated, self.rig_seconds, wall_seconds, session, strategy, calibration),
            at_measurement=None if self.truth is None else self.truth.at_measurement,
            not_bounded=self._not_bounded(),
        )

    def _not_bounded(self) -> tuple[NotBounded, ...]:
        """States of the answer in which the fingers may have tipped or rolled the part."""
        bounds = MotionBounds(self.job.rig, self.job.catalogue)
        pushed_n = max((bounds.peak_force_n(grip) for grip in self.result.grips), default=0.0)
        table = StabilityTable(self.job.rig, self.job.catalogue, bounds)
        return table.not_bounded(self.result.recognition, pushed_n)

    def _calibration(self) -> CalibrationUsedOut | None:
        """What there is to say of the calibration."""
        job = self.job
        if job.calibration is None or job.started is None:
            return None
        return calibration_used(self.result, job.rig, job.calibration, job.started)


def run_identification(
    job: IdentificationJob,
    environment: Environment,
    record: Observer | None = None,
    observers: Sequence[Observer] = (),
    notice: Callable[[str], None] = lambda _: None,
    placement_now: Callable[[], Placement | None] | None = None,
) -> IdentificationRun:
    """Connect, identify, disconnect. `notice` is told what the operator should do now.

    `record` is told on this thread, in step with ports and clock; `observers` and `notice` beside it.
    `placement_now`: how the part on an emulated table lies now, in the answer's frame; None: as it was put.
    Raises what `identify` raises; torque is off then, too.
    """
    lies = placement_now or (lambda: job.placement)
    at_measurement: list[Configuration] = []

    def in_step(event: Event) -> None:
        measured = isinstance(event, StageEvent) and event.stage is GripPhase.RETRACTING
        if measured and (placement := lies()) is not None:
            at_measurement.append(placement.configuration)
        if record is not None:
            record(event)

    with (
        Observers(observers, in_step) as observed,
        BackgroundCall("the display", notice) as notice_beside,
        environment.hand(job.rig, notice_beside) as hand,
    ):
        check_devices(job.calibration, hand)
        hand.prepare()
        at_stops = slides_at_stops(hand) if job.rig.search.check_slips else {}
        result = identify(hand, job.catalogue, observed, strategy=job.strategy, seed=job.seed)
        if at_stops:
            check_slips(hand, at_stops)
        emulated = hand.emulated
    late = observed.late_failure or notice_beside.late_failure
    placement = lies()
    truth = None if placement is None else Truth(placement, at_measurement if placement_now else None)
    return IdentificationRun(job, result, emulated, environment.clock.now(), truth, late)
