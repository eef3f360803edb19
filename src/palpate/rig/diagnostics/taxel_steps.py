"""Taxel step of a diagnosis: taxels that are dead, hot or unsteady, by an untouched array's frames.

Or by its own account. Whether taxels are where the array says cannot be seen while nothing touches them:
`palpate watch` shows it.
"""

import numpy as np

from palpate.base.errors import quantity
from palpate.base.geometry import Bools
from palpate.config.diagnosis_results import Cause, FindingOut
from palpate.drivers.tactile import SelfTestResult, TaxelFault
from palpate.rig.diagnostics.array_examination import ExaminedArray, UntouchedArray
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.diagnostics.steps import DiagnosisCase, Judgement, join_words, name_flag, wrong

_MAX_TAXELS_NAMED = 6


def judge_taxels(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Taxels of arrays that fit the rig file."""
    arrays = readings.untouched
    leave_out = (
        "list it in array.taxels.unusable"
        if case.rig.why_not("calibrate")
        else "calibrate, which leaves it out"
    )
    findings = [found for array in arrays for found in (*_hardware(array), *_bad_taxels(array, leave_out))]
    count = sum(array.seen.description.taxels for array in arrays if array.seen.description is not None)
    known = sum(len(array.known_bad) for array in arrays)
    more = f", {known} of them known to the calibration and left out" if known else ""
    tested = sum(array.seen.report is not None for array in arrays)
    saw = f"{count} taxels of {quantity(len(arrays), 'array', 'arrays')}{more}; {tested} tested themselves"
    return saw, findings


def _hardware(array: UntouchedArray) -> list[FindingOut]:
    report = array.seen.report
    if report is None or not report.result & ~SelfTestResult.TAXELS:
        return []
    parts = [name_flag(part) for part in SelfTestResult if part in report.result]
    named = join_words([part for part in parts if part != "taxels"])
    return [
        wrong(
            Cause.ARRAY_HARDWARE,
            array.seen.device,
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
            wrong(Cause.ARRAY_HARDWARE, item.device, saw, why, "check the cable between skin and electronics")
        ]
    found = []
    left = dead.copy()
    for cause, name, numbers in ((Cause.DEAD_COLUMN, "column", columns), (Cause.DEAD_ROW, "row", rows)):
        if not len(numbers):
            continue
        which = join_words([str(number) for number in numbers])
        saw = f"all taxels of {name}{'' if len(numbers) == 1 else 's'} {which} are dead"
        found.append(
            wrong(
                cause,
                item.device,
                saw,
                f"a line of the {name} is broken, or its plug does not touch",
                replace,
            )
        )
        left[:, columns] = False
        left[rows] = False
    if left.any():
        saw = f"{quantity(int(left.sum()), 'dead taxel', 'dead taxels')}: {_places(left)}"
        found.append(wrong(Cause.DEAD_TAXEL, item.device, saw, _WORN_SKIN, f"repair it, or {leave_out}"))
    return found


def _stuck(item: ExaminedArray, hot: Bools, leave_out: str) -> list[FindingOut]:
    if not hot.any():
        return []
    saw = f"{quantity(int(hot.sum()), 'taxel', 'taxels')} at full scale without a touch: {_places(hot)}"
    why = "a short circuit in the skin, or something is pressed into it"
    return [
        wrong(
            Cause.HOT_TAXEL,
            item.device,
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
    return [wrong(Cause.UNSTEADY_TAXEL, item.device, saw, why, f"repair it, or {leave_out}")]


_WORN_SKIN = "the skin is worn or damaged there"


def _places(taxels: Bools) -> str:
    return join_words([f"row {row} column {col}" for row, col in np.argwhere(taxels)], _MAX_TAXELS_NAMED)
