"""Calibration run from the first step to the file, on real or emulated rigs.

Runs the steps of `calibration` one after the other, each with a hand of its own that knows what the earlier
ones found, and keeps what is done in a run record, a file from which it can be resumed.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Protocol

import numpy as np

from palpate.base.errors import InputError
from palpate.base.file_io import write_text
from palpate.calibration.finger_fit import FingerFit, ReferencePlacement, TouchArrays
from palpate.calibration.finger_model import FingerModel, SlowTouch
from palpate.calibration.finger_step import (
    calibrate_stage,
    fit_touches,
    hold_out,
    measure_stage,
    plan_placements,
    touch_placing,
)
from palpate.calibration.frame_alignment import (
    AlignedFit,
    TouchErrors,
    align_fit,
    bound_contacts,
    calibrate_place,
    calibrate_plays,
    estimate_array_headings,
    summarise_residuals,
)
from palpate.calibration.measurements import (
    Prober,
    ReferenceDisc,
    ReferencePlate,
    RunRecord,
    TouchMeasurement,
)
from palpate.calibration.rig_models import KnownFingers, calibrated_models
from palpate.calibration.tactile_step import measure_actuators, measure_tactile
from palpate.config import (
    CalibrationDevice,
    CalibrationFile,
    FingerConfig,
    RigFile,
    apply_calibration,
    geometry_sha256,
)
from palpate.config.calibration_file import (
    CalibrationReference,
    ReferencesFile,
    StageCalibration,
    references_sha256,
)
from palpate.config.calibration_finger import Actuators, FingerCalibration, TactileCalibration
from palpate.config.calibration_overlay import frame_offset_bound_mm
from palpate.config.loading import load_json
from palpate.drivers.tactile import Description, TactileFrame
from palpate.rig.arrays import bare_extractor, doubt_warning
from palpate.rig.commissioning.hand_prober import HandProber, TableOperator, approaches_of
from palpate.rig.fingers import Stage
from palpate.rig.motion.hand import Environment
from palpate.rig.session.calibration_drift import devices_of
from palpate.rig.workers import BackgroundCall

STEPS = ("actuators", "tactile", "fingers", "stage")
"""Steps in the order in which they build on one another; the last is for rigs with a turning stage only."""

_TARE_S = 0.5


@dataclass(frozen=True, eq=False)
class ConnectedRig:
    """A rig that is connected: what can be measured with it, its arrays' descriptions, its devices.

    `prober` may only be used if the rig was made ready to move.
    """

    prober: Prober
    arrays: Sequence[Description]
    devices: list[CalibrationDevice]
    emulated: bool


class RigConnector(Protocol):
    """Connects a rig for as long as the context lasts; torque is off afterwards, whatever happens."""

    def __call__(self, rig: RigFile, *, moving: bool) -> AbstractContextManager[ConnectedRig]:
        """`rig`: as far as it is known by then. `moving`: make it ready to move."""
        ...


class RunRecordStore(Protocol):
    """Keeps the run record between runs."""

    def load(self) -> RunRecord | None:
        """The record of an earlier run, None if there is none."""
        ...

    def save(self, record: RunRecord) -> None:
        """Keep this in its place."""
        ...


@dataclass(frozen=True, eq=False)
class CalibrationJob:
    """Job of a calibration: the rig as its file describes it, the references, the steps, what was known.

    `rig_sha256`: of the rig file's bytes. `before`: the rig's calibration so far, None if it has none.
    """

    rig: RigFile
    rig_sha256: str
    references: ReferencesFile
    steps: Sequence[str]
    coverage: float
    made: datetime
    before: CalibrationFile | None


def calibrate(
    job: CalibrationJob, connect: RigConnector, keeper: RunRecordStore, tell: Callable[[str], None]
) -> CalibrationFile:
    """Carry out the steps that are not done yet, and put together the file.

    The record is kept beside the thread that moves the rig. `tell` is called on that thread: it must neither
    raise nor wait. Raises InputError for references that are not what they should be, DeviceError and
    SafetyStop for devices, OutputError for a record that cannot be kept for the next step. One that could not
    be kept after the last step is only reported: the calibration is complete.
    """
    with BackgroundCall("the run record", keeper.save) as save:
        run = _CalibrationRun(job, connect, save, tell)
        run.begin(keeper.load())
        for step in steps_of(job.rig, job.steps):
            run.carry_out(step)
        file = run.file()
    if save.late_failure is not None:
        tell(str(save.late_failure))
    return file


def steps_of(rig: RigFile, asked: Sequence[str]) -> list[str]:
    """The steps that were asked for and that a rig has, in their order; InputError if that is none.

    Or if it has pads: what they touch of a disc, and what their arrays then show, is not modelled.
    """
    rig.require("calibrate")
    found = [step for step in STEPS if step in asked and (step != "stage" or Stage.of(rig).turns)]
    if not found:
        raise InputError(f'rig "{rig.name}" has no turning stage to calibrate: calibrate the other steps')
    return found


def build_references(file: ReferencesFile) -> tuple[ReferenceDisc, ReferencePlate]:
    """The disc and the plate; InputError for a plate that is not convex."""
    try:
        plate = ReferencePlate("plate", np.array(file.plate.outline_mm), file.plate.tolerance_mm)
    except ValueError as error:
        raise InputError(f"references: plate.outline_mm {error}") from None
    return ReferenceDisc("disc", file.disc.diameter_mm / 2, file.disc.tolerance_mm), plate


@dataclass(frozen=True, eq=False)
class _FittedPlaces:
    """All fingers' places, as `fit_touches` finds them, and in the hand frame."""

    models: Sequence[FingerModel]
    touched: Sequence[TouchMeasurement]
    touches: TouchArrays
    fit: FingerFit
    without: FingerFit
    hand: AlignedFit


class _CalibrationRun:
    """The steps of one calibration and what they have found so far."""

    def __init__(
        self,
        job: CalibrationJob,
        connect: RigConnector,
        save: BackgroundCall,
        tell: Callable[[str], None],
    ) -> None:
        self._job, self._connect, self._save, self._tell = job, connect, save, tell
        self._disc, self._plate = build_references(job.references)
        self._emulated = False
        self._last_fit: _FittedPlaces | None = None

    def begin(self, kept: RunRecord | None) -> None:
        """Connect once, see which devices these are, and take up a record of them if there is one."""
        with self._connect(self._job.rig, moving=False) as there:
            devices = there.devices
            self._emulated = there.emulated
        self._record = self._fresh(devices)
        if kept is not None and kept.is_for(self._record):
            self._record = kept
            self._tell(f"resuming: {_record_summary(kept)}")
        elif kept is not None:
            raise InputError(
                f"a calibration was begun before ({', '.join(kept.steps)}; {_record_summary(kept)}) with "
                "other steps, references or devices, or before the rig file was changed: finish that one, or "
                "restart, which forgets it"
            )

    def carry_out(self, step: str) -> None:
        """Do one step, unless it is done."""
        if getattr(self._record, step, None) is not None:
            self._tell(f"{step}: done already")
            return
        rig = self._rig_with_places() if step == "stage" else self._rig_so_far()
        specs = rig.fingers
        self._tell(f"{step}:")
        with self._connect(rig, moving=True) as there:
            prober = there.prober
            if step == "actuators":
                found = measure_actuators(
                    prober,
                    specs,
                    self._disc,
                    touch_speed_mm_s=rig.closing.touch_speed_mm_s,
                    approach_speed_mm_s=rig.closing.approach_speed_mm_s,
                    coverage=self._job.coverage,
                    tell=self._tell,
                )
                self._keep(actuators=found)
            elif step == "tactile":
                self._keep(
                    tactile=measure_tactile(
                        prober, specs, there.arrays, self._disc, self._plate, tell=self._tell
                    )
                )
                self._tell_doubts(there)
            elif step == "stage":
                found_of_stage = measure_stage(prober, rig, self._disc, tell=self._tell)
                self._stage_of(found_of_stage, rig)  # raises what is wrong with them
                self._keep(stage=found_of_stage)
            else:
                self._touch(prober, specs)
            prober.clear()

    def _tell_doubts(self, there: ConnectedRig) -> None:
        """Say which arrays are not believed with this calibration, as `check` would."""
        rig = self._rig_so_far()
        idles = {idle.finger: idle for idle in there.prober.idle(_TARE_S)}
        for spec, description in zip(rig.fingers, there.arrays, strict=True):
            idle = idles[spec.name]
            frames = zip(idle.time_s.tolist(), idle.counts, strict=True)
            extractor = bare_extractor(rig, spec, description)
            extractor.tare([TactileFrame(k, t, t, counts) for k, (t, counts) in enumerate(frames)])
            if (doubt := doubt_warning(rig, spec, extractor)) is not None:
                self._tell(f"array {spec.name}: {doubt}")

    def file(self) -> CalibrationFile:
        """The calibration file of what is known now; what this run did not do is as it was before."""
        file = self._file_with_places()
        if self._record.stage is None:
            return file
        rig = apply_calibration(self._job.rig, file)
        return file.model_copy(update={"stage": self._stage_of(self._record.stage, rig)})

    def _file_with_places(self) -> CalibrationFile:
        """The file without what this run has found of the stage."""
        file, before = self._file_of_devices(), self._job.before
        if self._record.touched:
            return self._with_places(file)
        if before is None:
            return file
        places = {item.name: item for item in before.fingers}
        fingers = [
            item.model_copy(update={"place": places[item.name].place, "bounds": places[item.name].bounds})
            for item in file.fingers
        ]
        return file.model_copy(
            update={"fingers": fingers, "residuals": before.residuals, "stage": before.stage}
        )

    def _rig_with_places(self) -> RigFile:
        """The rig with its fingers where they were found; InputError if they were not."""
        file = self._file_with_places()
        if any(item.place is None or item.actuators is None for item in file.fingers):
            raise InputError(
                "the stage is measured with fingers whose places are known: calibrate these first, or all at "
                "once with `palpate calibrate --rig FILE all`"
            )
        return apply_calibration(self._job.rig, file)

    def _stage_of(self, touched: Sequence[TouchMeasurement], rig: RigFile) -> StageCalibration:
        """The stage by its touches; `rig`: with its fingers where they were found."""
        drawn = self._job.rig
        offset_mm = frame_offset_bound_mm(drawn, Stage.of(drawn).centre_mm)
        return calibrate_stage(
            drawn, self._known_fingers(rig), rig.fingers, touched, self._disc, offset_mm, self._job.coverage
        )

    def _known_fingers(self, rig: RigFile) -> KnownFingers:
        """Fingers with what is not known of them: from this run's fit, else from the file."""
        if not self._record.touched:
            return KnownFingers.from_calibration(rig.fingers, self._file_with_places().fingers)
        fitted = self._fit_places()
        return KnownFingers(fitted.models, fitted.hand.values, fitted.hand.covariance)

    def _file_of_devices(self) -> CalibrationFile:
        """The file without places: what is known of actuators and arrays."""
        job, record = self._job, self._record
        return CalibrationFile(
            rig=job.rig.name,
            rig_sha256=job.rig_sha256,
            geometry_sha256=record.geometry_sha256,
            made=job.made,
            palpate=version("palpate"),
            emulated=self._emulated,
            coverage=job.coverage,
            references=[
                CalibrationReference(name=item.name, sha256=record.references_sha256)
                for item in (self._disc, self._plate)
            ],
            devices=record.devices,
            fingers=[
                FingerCalibration(
                    name=spec.name, actuators=self._actuators(index), tactile=self._tactile(index)
                )
                for index, spec in enumerate(job.rig.fingers)
            ],
        )

    def _touch(self, prober: Prober, specs: Sequence[FingerConfig]) -> None:
        """Touch the references at every placing that is not done."""
        placings = self._placings()
        models = self._models(specs)
        for number in range(len(self._record.touched), len(placings)):
            x, y = placings[number].about_mm
            name = placings[number].reference.name
            self._tell(f"placing {number + 1} of {len(placings)}: {name} near ({x:.0f}, {y:.0f}) mm")
            known = [item for touches in self._record.touched for item in touches]
            touched = touch_placing(prober, specs, models, placings[: number + 1], known, tell=self._tell)
            self._keep(touched=[*self._record.touched, touched])

    def _with_places(self, file: CalibrationFile) -> CalibrationFile:
        """The file with fingers' places and bounds."""
        specs, fitted = self._rig_so_far().fingers, self._fit_places()
        models, hand, touched = fitted.models, fitted.hand, fitted.touched
        touches, fit, without = fitted.touches, fitted.fit, fitted.without
        out = hold_out(len(touched))
        residuals = summarise_residuals(touches, fit, without, out, [spec.name for spec in specs], hand.frame)
        headings = estimate_array_headings(touched, touches, models, specs, fit)
        closing = self._job.rig.closing
        approaches = approaches_of(self._job.rig)
        tolerance_mm = max(self._disc.tolerance_mm, self._plate.tolerance_mm)
        errors = TouchErrors(residuals, tolerance_mm, self._job.coverage)
        fingers = []
        for index, (item, model) in enumerate(zip(file.fingers, models, strict=True)):
            assert item.actuators is not None
            assert item.tactile is not None
            bounds = bound_contacts(
                model,
                hand,
                index,
                approaches,
                headings[index],
                SlowTouch(item.actuators, item.tactile.phase_deg, closing.touch_speed_mm_s),
                errors,
            )
            place = calibrate_place(model, hand, index, headings[index])
            seen = calibrate_plays(model, item.actuators, hand, index)
            fingers.append(item.model_copy(update={"place": place, "bounds": bounds, "actuators": seen}))
        return file.model_copy(update={"fingers": fingers, "residuals": residuals})

    def _fit_places(self) -> "_FittedPlaces":
        """The fit of the fingers' places; it is made once for the same touches."""
        touched = [item for touches in self._record.touched for item in touches]
        if self._last_fit is None or self._last_fit.touched != touched:
            specs = self._rig_so_far().fingers
            models = self._models(specs)
            found = fit_touches(specs, models, self._placings(), touched)
            self._last_fit = _FittedPlaces(
                models, touched, *found, align_fit(self._job.rig.fingers, found[1])
            )
        return self._last_fit

    def _placings(self) -> list[ReferencePlacement]:
        return plan_placements(self._disc, self._plate, self._job.rig)

    def _rig_so_far(self) -> RigFile:
        """The rig with what is known of its actuators and arrays; where fingers stand is as described."""
        return apply_calibration(self._job.rig, self._file_of_devices())

    def _actuators(self, index: int) -> Actuators | None:
        """Calibration of a finger's actuators: from this run, else from before."""
        if self._record.actuators is not None:
            return self._record.actuators[index]
        return None if self._job.before is None else self._job.before.fingers[index].actuators

    def _tactile(self, index: int) -> TactileCalibration | None:
        """Calibration of a finger's array: from this run, else from before."""
        if self._record.tactile is not None:
            return self._record.tactile[index]
        return None if self._job.before is None else self._job.before.fingers[index].tactile

    def _models(self, specs: Sequence[FingerConfig]) -> list[FingerModel]:
        """Priors of all fingers; InputError if actuators or arrays have not been measured."""
        actuators = [self._actuators(index) for index in range(len(specs))]
        found = [item for item in actuators if item is not None]
        if len(found) < len(specs) or any(self._tactile(index) is None for index in range(len(specs))):
            raise InputError(
                "where fingers stand is measured with what is known of actuators and arrays: calibrate "
                "these first, or all at once with `palpate calibrate --rig FILE all`"
            )
        return calibrated_models(specs, found)

    def _keep(self, **found: object) -> None:
        self._record = self._record.model_copy(update=found)
        self._save(self._record)
        self._save.check()

    def _fresh(self, devices: list[CalibrationDevice]) -> RunRecord:
        return RunRecord(
            steps=steps_of(self._job.rig, self._job.steps),
            geometry_sha256=geometry_sha256(self._job.rig),
            references_sha256=references_sha256(self._job.references),
            places=[(item.reference.name, *item.about_mm) for item in self._placings()],
            devices=devices,
        )


def _record_summary(record: RunRecord) -> str:
    """Contents of a record, in words."""
    parts = [step for step in STEPS if getattr(record, step, None) is not None]
    if record.touched:
        parts.append(f"{len(record.touched)} placings")
    return ", ".join(parts) + " done before" if parts else "nothing is done yet"


def rig_connector(
    environment: Environment, table: TableOperator, notice: Callable[[str], None]
) -> RigConnector:
    """A connector of the rig in this environment; `notice` is called with what the operator should do."""

    @contextmanager
    def connect(rig: RigFile, *, moving: bool) -> Iterator[ConnectedRig]:
        with environment.hand(rig, notice) as hand:
            if moving:
                hand.prepare()
            arrays = [finger.array.description for finger in hand.fingers]
            yield ConnectedRig(HandProber(hand, table), arrays, devices_of(hand), hand.emulated)

    return connect


class RunRecordFile:
    """Keeps the run record in a file that is always whole."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> RunRecord | None:
        """Load what is there; InputError if it cannot be read."""
        if not self._path.exists():
            return None
        try:
            return load_json(self._path, RunRecord, {})
        except InputError as error:
            raise InputError(
                f"{error}: the calibration that was begun cannot be taken up; restart to begin anew"
            ) from None

    def save(self, record: RunRecord) -> None:
        """Replace what is there."""
        write_text(self._path, record.model_dump_json(indent=1) + "\n")

    def forget(self) -> None:
        """There is nothing to resume any more."""
        self._path.unlink(missing_ok=True)
