"""Result of `palpate doctor`: `palpate/doctor@1`."""

from enum import StrEnum
from typing import Literal

from palpate.config.results import Out

__all__ = ["DEVICE_CAUSES", "Cause", "DoctorOut", "DoctorStepOut", "FindingOut", "Outcome", "Severity"]


class Cause(StrEnum):
    """What is wrong with a set-up. Values stay as they are: programs may compare them."""

    PORT_MISSING = "port-missing"
    PORT_FORBIDDEN = "port-forbidden"
    PORT_BUSY = "port-busy"
    PORT_UNUSABLE = "port-unusable"
    MODEM_MANAGER = "modem-manager"
    BRLTTY = "brltty"
    LATENCY_TIMER = "latency-timer"
    BUS_SILENT = "bus-silent"
    BAUD_RATE = "baud-rate"
    WRONG_ID = "wrong-id"
    DUPLICATE_ID = "duplicate-id"
    SERVO_SILENT = "servo-silent"
    WRONG_MODEL = "wrong-model"
    SERVO_FIRMWARE = "servo-firmware"
    SUPPLY_LOW = "supply-low"
    SUPPLY_HIGH = "supply-high"
    SUPPLY_DROP = "supply-drop"
    SUPPLY_MIXED = "supply-mixed"
    HARDWARE_ERROR = "hardware-error"
    TOO_HOT = "too-hot"
    TORQUE_ON = "torque-on"
    LIMITS_IMPOSSIBLE = "limits-impossible"
    LIMITS_NOT_SET = "limits-not-set"
    DRIVE_REVERSED = "drive-reversed"
    HOMING_OFFSET = "homing-offset"
    SHADOW_ID = "shadow-id"
    PROTECTION_OFF = "protection-off"
    BUS_LOSSY = "bus-lossy"
    BUS_SLOW = "bus-slow"
    ZERO_OFF = "zero-off"
    DIRECTION_WRONG = "direction-wrong"
    MOTION_FAILED = "motion-failed"
    ARRAY_SILENT = "array-silent"
    ARRAY_BAUD_RATE = "array-baud-rate"
    ARRAY_PROTOCOL = "array-protocol"
    ARRAY_FIRMWARE = "array-firmware"
    ARRAY_HARDWARE = "array-hardware"
    ARRAY_GEOMETRY = "array-geometry"
    DEAD_COLUMN = "dead-column"
    DEAD_ROW = "dead-row"
    DEAD_TAXEL = "dead-taxel"
    HOT_TAXEL = "hot-taxel"
    UNSTEADY_TAXEL = "unsteady-taxel"
    NO_FRAMES = "no-frames"
    FRAMES_LOST = "frames-lost"
    FRAMES_SLOW = "frames-slow"
    NOISE = "noise"
    DRIFT = "drift"
    HIDDEN_PUSH = "hidden-push"
    FORCE_SCALE = "force-scale"
    ARRAYS_SWAPPED = "arrays-swapped"
    OTHER_DEVICES = "other-devices"
    CALIBRATION_OLD = "calibration-old"


DEVICE_CAUSES = frozenset(
    {
        Cause.PORT_MISSING,
        Cause.PORT_FORBIDDEN,
        Cause.PORT_BUSY,
        Cause.PORT_UNUSABLE,
        Cause.BRLTTY,
        Cause.BUS_SILENT,
        Cause.SERVO_SILENT,
        Cause.ARRAY_SILENT,
        Cause.NO_FRAMES,
    }
)
"""Causes for which a device counts as missing or not answering."""


class Severity(StrEnum):
    """How bad a finding is: with a warning a rig can be worked with."""

    WRONG = "wrong"
    WARNING = "warning"


class Outcome(StrEnum):
    """How a step ended: as its worst finding, or it was not carried out."""

    WELL = "well"
    WARNING = "warning"
    WRONG = "wrong"
    SKIPPED = "skipped"


class FindingOut(Out):
    """One thing that is not as it should be: what was seen, what that means, and the next thing to do."""

    cause: Cause
    severity: Severity
    device: str
    saw: str
    means: str
    next: str


class DoctorStepOut(Out):
    """A step. `saw` is empty and `skipped_because` says why, if it was skipped."""

    step: str
    outcome: Outcome
    looked_at: str
    saw: str
    findings: tuple[FindingOut, ...] = ()
    skipped_because: str | None = None


class DoctorOut(Out):
    """All steps, in the order in which things go wrong. `well`: nothing is wrong; there may be warnings.

    `device_missing`: something is missing or does not answer. `moved`: fingers were moved to see their
    directions. `next`: what to do first; null if there is nothing to do.
    """

    format: Literal["palpate/doctor@1"] = "palpate/doctor@1"
    rig: str
    emulated: bool
    well: bool
    device_missing: bool
    moved: bool
    steps: tuple[DoctorStepOut, ...]
    next: str | None

    @property
    def findings(self) -> tuple[FindingOut, ...]:
        """All findings, in the steps' order."""
        return tuple(item for step in self.steps for item in step.findings)
