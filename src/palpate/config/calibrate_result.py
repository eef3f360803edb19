"""Result of `palpate calibrate --json`, format `palpate/calibrate@1`."""

from typing import Literal

from palpate.config.results import Out, Rounded

__all__ = ["CalibrateOut", "CalibratedFingerOut", "CalibratedStageOut"]


class CalibratedFingerOut(Out):
    """One finger, as far as it is calibrated; null where it is not.

    `position_mm`, `direction_deg`: bounds on its contacts. `moved_mm`, `turned_deg`: how far base and heading
    are from what the rig file says. `unusable`: taxels that are left out.
    """

    name: str
    position_mm: Rounded | None
    direction_deg: Rounded | None
    moved_mm: Rounded | None
    turned_deg: Rounded | None
    tip_radius_mm: Rounded | None
    backlash_mm: Rounded | None
    stiffness_n_per_mm: Rounded | None
    unusable: int | None


class CalibratedStageOut(Out):
    """The turning stage: its axis in W with the bound on that, and its play.

    `moved_mm`: how far the axis is from what the rig file says. `rms_mm`: residuals of touches at its angles.
    """

    centre_mm: tuple[Rounded, Rounded]
    centre_bound_mm: Rounded
    moved_mm: Rounded
    backlash_deg: Rounded
    touches: int
    rms_mm: Rounded


class CalibrateOut(Out):
    """A calibration that was carried out. `steps`: those that it was asked for; `file`, `report`: written.

    `rms_mm`, `held_out_rms_mm`: residuals of touches, fitted and predicted; null before fingers were placed.
    `stage`: null if there is none, or if it is not calibrated.
    `rig_seconds` is the rig's own time (virtual when emulated), `wall_seconds` what the user waited.
    """

    format: Literal["palpate/calibrate@1"] = "palpate/calibrate@1"
    rig: str
    emulated: bool
    steps: tuple[str, ...]
    file: str
    report: str
    coverage: Rounded
    fingers: tuple[CalibratedFingerOut, ...]
    touches: int | None
    outliers: int | None
    rms_mm: Rounded | None
    held_out_rms_mm: Rounded | None
    stage: CalibratedStageOut | None
    rig_seconds: Rounded
    wall_seconds: Rounded
