"""A run from the first port to the answer: used by `identify` on devices and by `replay` on a recording.

Where an emulated part really was is an event of the log: an engine moves the part, and a replay has none.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from pydantic import BaseModel, ValidationError

from palpate.base.errors import InputError
from palpate.config.fields import Number
from palpate.recognizer import Configuration
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.loop import Event, Observer, Observers, StageEvent, identify
from palpate.rig.identification.result import IdentificationJob, IdentificationRun, Truth
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.hand import Environment
from palpate.rig.motion.press import check_slips, slides_at_stops
from palpate.rig.session.calibration_drift import calibration_used, check_devices
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.workers import BackgroundCall

TRUTH_EVENT = "truth"


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
    used = None
    if job.calibration is not None and job.started is not None:
        used = calibration_used(result, job.rig, job.calibration, job.started)
    return IdentificationRun(job, result, emulated, environment.clock.now(), truth, used, late)
