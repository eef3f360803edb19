"""Taxel step of a diagnosis: taxels that are dead, hot, unsteady or drift, by an untouched array's frames.

Or by its own account. Whether taxels are where the array says cannot be seen while nothing touches them:
`palpate watch` shows it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import quantity
from palpate.base.geometry import Bools, Floats
from palpate.config.diagnosis_results import Cause, DoctorStepOut, FindingOut
from palpate.drivers.tactile import SelfTestResult, TactileFrame, TaxelFault
from palpate.rig.diagnostics.array_examination import ExaminedArray
from palpate.rig.diagnostics.steps import DiagnosisCase, error_finding, finish_step, join_words
from palpate.rig.pads import has_pads

_MIN_FRAMES = 16  # frames
_HOT_SHARE = 0.95  # of the largest count
_MAX_DEAD_CHANCE = 1e-6  # chance for a live taxel to read the same in every frame
_UNSTEADY_RATIO = 6.0  # times the median noise
_MIN_NOISE_COUNTS = 0.3  # counts: of a taxel whose noise is lost in rounding
_DRIFT_SIGMAS = 6.0  # above which a slope is no chance
_DRIFT_STRETCHES = 12


@dataclass(frozen=True, eq=False)
class UntouchedStatistics:
    """What frames of an untouched array show, by taxel (rows, cols).

    `dead` never change, which is certain only where there is noise enough (`tells_dead`); `at_zero` of them
    read 0, as one does whose zero has drifted below what can be read. `noise_counts`: median of the live
    taxels' standard deviations. `drift_counts_per_s`: the fastest drift that is certain, in absolute value, 0
    if none is; `drifting`: how many taxels' is beyond what was allowed.
    """

    dead: Bools
    at_zero: Bools
    hot: Bools
    unsteady: Bools
    noise_counts: float
    drift_counts_per_s: float
    drifting: int
    tells_dead: bool


def analyse_untouched(
    frames: Sequence[TactileFrame], max_count: int, allowed_drift: float
) -> UntouchedStatistics | None:
    """Look at frames of an array that nothing touches; None if they are too few.

    A taxel drifts for certain if a straight line through the means of a dozen stretches is steeper than
    `allowed_drift` (counts/s) by six times its error. The error comes from how far the means lie off the
    line, of this taxel or in the median, which noise of any colour moves.
    """
    if len(frames) < _MIN_FRAMES:
        return None
    counts = np.stack([frame.counts for frame in frames]).astype(float)
    times = np.array([frame.device_time_s for frame in frames])
    mean, spread = counts.mean(axis=0), counts.std(axis=0)
    hot = mean >= _HOT_SHARE * max_count
    moving = spread > 0
    noise = float(np.median(spread[moving & ~hot])) if (moving & ~hot).any() else 0.0
    still = ~moving & ~hot
    certain = noise > 0 and math.erf(0.5 / (noise * math.sqrt(2))) ** len(frames) < _MAX_DEAD_CHANCE
    low = still & (mean == 0)
    dead = (still & certain & ~low) | (
        low & (np.median(mean) > 4 * max(noise, 1.0))
    )  # others rest well above
    live = ~(dead | hot)
    slope, error = _slopes(counts, times, max(noise, _MIN_NOISE_COUNTS))
    unsteady = live & (_frame_noise(counts) > _UNSTEADY_RATIO * max(noise, _MIN_NOISE_COUNTS))
    beyond = live & ~unsteady & (np.abs(slope) - allowed_drift > _DRIFT_SIGMAS * error)
    fastest = float(np.abs(slope)[beyond].max()) if beyond.any() else 0.0
    return UntouchedStatistics(dead, dead & low, hot, unsteady, noise, fastest, int(beyond.sum()), certain)


def _frame_noise(counts: Floats) -> Floats:
    """Noise from one frame to the next, which drift does not move: (rows, cols) standard deviation."""
    result: Floats = np.diff(counts, axis=0).std(axis=0) / math.sqrt(2)
    return result


def _slopes(counts: Floats, times: Floats, noise: float) -> tuple[Floats, Floats]:
    """Slope of each taxel (counts/s) and its standard error, by the means of stretches."""
    parts = np.array_split(np.arange(len(times)), _DRIFT_STRETCHES)
    means = np.stack([counts[part].mean(axis=0) for part in parts])
    at = np.array([times[part].mean() for part in parts])
    off = at - at.mean()
    along = float((off**2).sum())
    slope: Floats = np.tensordot(off, means, axes=1) / along
    rest = means - means.mean(axis=0) - off[:, None, None] * slope
    variance = (rest**2).sum(axis=0) / (_DRIFT_STRETCHES - 2)
    # A taxel's own ten degrees of freedom are too few: in one of ten thousand chance makes them too small.
    least = max(noise**2 * _DRIFT_STRETCHES / len(times), float(np.median(variance)))
    error: Floats = np.sqrt(np.maximum(variance, least) / along)
    return slope, error


TAXEL_MAP = ("taxel map", "let arrays test themselves, and looked for taxels that are stuck or unsteady")

_MAX_TAXELS_NAMED = 6


@dataclass(frozen=True, eq=False)
class UntouchedArray:
    """An array that introduced itself, and what its frames show."""

    seen: ExaminedArray
    shown: UntouchedStatistics | None
    known_bad: frozenset[tuple[int, int]]


def judge_taxels(case: DiagnosisCase, arrays: Sequence[UntouchedArray]) -> DoctorStepOut:
    """The step on the taxels of arrays that fit the rig file."""
    leave_out = "list it in array.taxels.unusable" if has_pads(case.rig) else "calibrate, which leaves it out"
    findings = [found for array in arrays for found in (*_hardware(array), *_bad_taxels(array, leave_out))]
    count = sum(array.seen.description.taxels for array in arrays if array.seen.description is not None)
    known = sum(len(array.known_bad) for array in arrays)
    more = f", {known} of them known to the calibration and left out" if known else ""
    tested = sum(array.seen.report is not None for array in arrays)
    saw = f"{count} taxels of {quantity(len(arrays), 'array', 'arrays')}{more}; {tested} tested themselves"
    return finish_step(*TAXEL_MAP, saw, findings)


def _hardware(array: UntouchedArray) -> list[FindingOut]:
    report = array.seen.report
    if report is None or not report.result & ~SelfTestResult.TAXELS:
        return []
    parts = [str(p.name).replace("_", " ").lower() for p in SelfTestResult if p in report.result]
    named = join_words([part for part in parts if part != "taxels"])
    return [
        error_finding(
            Cause.ARRAY_HARDWARE,
            array.seen.name,
            f"its self-test finds fault with its {named or 'parts that only its maker can name'}",
            "it is broken, or has too little supply",
            "check its supply, then repair or replace it",
        )
    ]


def _bad_taxels(array: UntouchedArray, leave_out: str) -> list[FindingOut]:
    """Taxels that are bad by the array's own account or by their frames, and not left out already."""
    described, shown = array.seen.description, array.shown
    assert described is not None
    dead, hot, unsteady = (np.zeros((described.rows, described.cols), dtype=bool) for _ in range(3))
    if shown is not None:
        dead, hot, unsteady = shown.dead.copy(), shown.hot.copy(), shown.unsteady.copy()
        if (
            shown.drifting and array.seen.report is not None
        ):  # which says what is dead; these have drifted to 0
            dead &= ~shown.at_zero
    by_fault = {TaxelFault.STUCK_LOW: dead, TaxelFault.STUCK_HIGH: hot, TaxelFault.UNSTEADY: unsteady}
    for bad in () if array.seen.report is None else array.seen.report.bad:
        if bad.row < described.rows and bad.col < described.cols:
            by_fault[bad.fault][bad.row, bad.col] = True
    dead &= ~hot
    unsteady &= ~(hot | dead)
    for row, col in array.known_bad:
        dead[row, col] = hot[row, col] = unsteady[row, col] = False
    return [
        *_dead(array.seen, dead, leave_out),
        *_stuck(array.seen, hot, leave_out),
        *_unsteady(array.seen, unsteady, leave_out),
    ]


def _dead(item: ExaminedArray, dead: Bools, leave_out: str) -> list[FindingOut]:
    columns, rows = np.flatnonzero(dead.all(axis=0)), np.flatnonzero(dead.all(axis=1))
    replace = "repair the flat cable or replace the array"
    if len(rows) == len(dead):
        saw = f"none of its {dead.size} taxels ever changes"
        why = "its skin is not connected to its electronics"
        return [
            error_finding(
                Cause.ARRAY_HARDWARE, item.name, saw, why, "check the cable between skin and electronics"
            )
        ]
    found = []
    left = dead.copy()
    for cause, name, numbers in ((Cause.DEAD_COLUMN, "column", columns), (Cause.DEAD_ROW, "row", rows)):
        if not len(numbers):
            continue
        which = join_words([str(number) for number in numbers])
        saw = f"all taxels of {name}{'' if len(numbers) == 1 else 's'} {which} are dead"
        found.append(
            error_finding(
                cause, item.name, saw, f"a line of the {name} is broken, or its plug does not touch", replace
            )
        )
        left[:, columns] = False
        left[rows] = False
    if left.any():
        saw = f"{quantity(int(left.sum()), 'dead taxel', 'dead taxels')}: {_places(left)}"
        found.append(
            error_finding(Cause.DEAD_TAXEL, item.name, saw, _WORN_SKIN, f"repair it, or {leave_out}")
        )
    return found


def _stuck(item: ExaminedArray, hot: Bools, leave_out: str) -> list[FindingOut]:
    if not hot.any():
        return []
    saw = f"{quantity(int(hot.sum()), 'taxel', 'taxels')} at full scale without a touch: {_places(hot)}"
    why = "a short circuit in the skin, or something is pressed into it"
    return [
        error_finding(
            Cause.HOT_TAXEL,
            item.name,
            saw,
            why,
            f"look at the skin there; then {leave_out}",
        )
    ]


def _unsteady(item: ExaminedArray, unsteady: Bools, leave_out: str) -> list[FindingOut]:
    if not unsteady.any():
        return []
    noisy = quantity(int(unsteady.sum()), "taxel", "taxels")
    saw = f"{noisy} far noisier than the others: {_places(unsteady)}"
    why = "a contact in skin or plug is loose"
    return [error_finding(Cause.UNSTEADY_TAXEL, item.name, saw, why, f"repair it, or {leave_out}")]


_WORN_SKIN = "the skin is worn or damaged there"


def _places(taxels: Bools) -> str:
    return join_words([f"row {row} column {col}" for row, col in np.argwhere(taxels)], _MAX_TAXELS_NAMED)
