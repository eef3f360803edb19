"""Array steps of a diagnosis: identity, geometry, force scale and hardware.

*Taxels.* Dead, hot and unsteady ones, by frames of an untouched array or by its own account. Whether taxels
are where the array says cannot be seen while nothing touches them: `palpate watch` shows it.
"""

import math

import numpy as np

from palpate.base.errors import InputError, quantity
from palpate.base.geometry import Bools
from palpate.config.diagnosis_results import Cause, FindingOut
from palpate.drivers.tactile import SelfTestResult, Shape, TaxelFault
from palpate.rig.arrays import bare_extractor, pad_problem, shape_warning
from palpate.rig.diagnostics.array_examination import ExaminedArray, UntouchedArray
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.diagnostics.steps import DiagnosisCase, Judgement, join_words, name_flag, warning, wrong

_MAX_RADIUS_ERROR_SHARE = 0.1
_MAX_SCALE_RATIO = 2.0  # factor between what should be the same


def judge_answers(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Arrays that do not introduce themselves."""
    there, count = list(readings.misfits), quantity(len(readings.arrays), "array", "arrays")
    findings = [_silent(item) for item in readings.arrays if item.description is None]
    if not there:
        return "none answers", findings
    kinds = sorted({_kind(item) for item in there})
    named = [f"{item.spec.name} {_kind(item)}" for item in there]
    shown = f"each {join_words(kinds)}" if len(kinds) == 1 < len(there) else join_words(named)
    return f"{len(there)} of {count}: {shown}", findings


def judge_geometry(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Arrays that do not fit the rig file, and flat ones on tips that are no pads."""
    findings = [found for misfits in readings.misfits.values() for found in misfits]
    findings += [found for array in readings.untouched for found in _odd_shape(array.seen)]
    fitting = quantity(len(readings.untouched), "array fits", "arrays fit")
    return f"{fitting} the rig file", findings


def _kind(item: ExaminedArray) -> str:
    described = item.description
    assert described is not None
    if item.spec.array.reports_contacts:
        return "a contact source"
    return f"{described.rows} × {described.cols} {described.shape.name.lower()}"


def _silent(item: ExaminedArray) -> FindingOut:
    array = item.spec.array
    if item.other_rate is not None:
        return wrong(
            Cause.ARRAY_BAUD_RATE,
            item.device,
            f"it answers at {item.other_rate} baud, not at the rig file's {array.baudrate_bps}",
            "array and rig file agree in all but the rate",
            f"write baudrate_bps = {item.other_rate} for finger {item.spec.name}'s array in the rig file",
        )
    if item.other_protocol is not None:
        return wrong(
            Cause.ARRAY_PROTOCOL,
            item.device,
            f'it answers in the protocol "{item.other_protocol}", not in the rig file\'s "{array.protocol}"',
            "the rig file names another kind of array, or this is another finger's port",
            f'write protocol = "{item.other_protocol}" for finger {item.spec.name}\'s array in the rig file',
        )
    if item.answered:
        return wrong(
            Cause.ARRAY_FIRMWARE,
            item.device,
            str(item.failure),
            "it speaks the protocol, and not as palpate does",
            "put firmware on it that speaks the protocol's present version (docs/tactile-protocol.md)",
        )
    if item.noisy:
        return wrong(
            Cause.ARRAY_PROTOCOL,
            item.device,
            f'it sends what is no message of the protocol "{array.protocol}" at {array.baudrate_bps} baud',
            "what it feels cannot be read",
            f"check protocol, baudrate_bps and port of finger {item.spec.name}'s array in the rig file",
        )
    return wrong(
        Cause.ARRAY_SILENT,
        item.device,
        f"its port {array.port} opens, and nothing answers there at any usual baud rate",
        "what it feels cannot be read",
        f"see that the array of finger {item.spec.name} has power; if so, check its cable and its port",
    )


def find_misfits(case: DiagnosisCase, item: ExaminedArray) -> list[FindingOut]:
    """Find what of an array that introduced itself does not fit the rig file."""
    described, spec = item.description, item.spec
    assert described is not None
    calibrated = spec.array.taxels
    if calibrated is not None:
        shape = len(calibrated.gain), len(calibrated.gain[0])
        if shape != (described.rows, described.cols):
            return [
                wrong(
                    Cause.ARRAY_GEOMETRY,
                    item.device,
                    f"{described.rows} × {described.cols} taxels; {shape[0]} × {shape[1]} were calibrated",
                    "gains and zeros that were calibrated are not those of the array that answers",
                    f"see that {spec.array.port} is the port of finger {spec.name}'s array; if it is, "
                    + case.calibrate_or("correct or leave out its array.taxels"),
                )
            ]
    try:
        bare_extractor(case.rig, spec, described)
    except InputError as error:
        return [
            wrong(
                Cause.ARRAY_GEOMETRY,
                item.device,
                str(error),
                "contacts cannot be computed from such an array",
                "correct what the array says of itself (docs/tactile-protocol.md)",
            )
        ]
    if item.spec.tip.kind.has_face:
        return _pad_geometry(item)
    if described.shape is not Shape.CYLINDER:
        return []
    return [*_radius(item), *_coverage(item)]


def _pad_geometry(item: ExaminedArray) -> list[FindingOut]:
    assert item.description is not None
    problem = pad_problem(item.spec, item.description)
    if problem is None:
        return []
    return [
        wrong(
            Cause.ARRAY_GEOMETRY,
            item.device,
            problem,
            "contacts would be taken for ones elsewhere on the pad",
            f"measure the pad of finger {item.spec.name} and its array, and correct what is wrong",
        )
    ]


def _radius(item: ExaminedArray) -> list[FindingOut]:
    described, tip = item.description, item.spec.tip
    assert described is not None
    if (
        abs(described.tip_radius_mm - tip.radius_mm)
        <= _MAX_RADIUS_ERROR_SHARE * tip.radius_mm + tip.radius_bound_mm
    ):
        return []
    return [
        wrong(
            Cause.ARRAY_GEOMETRY,
            item.device,
            f"it says its tip's radius is {described.tip_radius_mm:g} mm, the rig file {tip.radius_mm:g} mm",
            "contacts would be taken for ones elsewhere on the tip",
            f"measure the tip of finger {item.spec.name}, and correct the number that is wrong",
        )
    ]


def _coverage(item: ExaminedArray) -> list[FindingOut]:
    """An array that covers less than approaches are planned for."""
    described, array = item.description, item.spec.array
    assert described is not None
    if described.cols < 2:
        return []
    pitch = (described.columns[-1] - described.columns[0]) / (described.cols - 1)
    covered = math.degrees(pitch * described.cols)
    if covered >= array.coverage_deg - 1.5 * math.degrees(pitch):
        return []
    return [
        wrong(
            Cause.ARRAY_GEOMETRY,
            item.device,
            f"its {described.cols} columns cover {covered:.0f}°, the rig file says {array.coverage_deg:g}°",
            "approaches would be planned whose contact no taxel sees",
            f"write coverage_deg = {math.floor(covered)} for finger {item.spec.name}'s array in the rig file",
        )
    ]


def _odd_shape(item: ExaminedArray) -> list[FindingOut]:
    assert item.description is not None
    odd = shape_warning(item.spec, item.description)
    if odd is None:
        return []
    saw, _, rest = odd.partition(": ")
    do, _, means = rest.rpartition(", or ")
    return [warning(Cause.FLAT_ARRAY, item.device, saw, means, do)]


def judge_scale(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Counts per N beside full scale, bits and the other arrays."""
    seen = [array.seen for array in readings.with_taxels]
    per_n = {item: item.description.counts_per_n for item in seen if item.description}
    usual = float(np.median(list(per_n.values())))
    findings = []
    for item, found in per_n.items():
        described = item.description
        assert described is not None
        full = found * described.full_scale_n
        if not 1 / _MAX_SCALE_RATIO <= full / described.max_count <= _MAX_SCALE_RATIO:
            saw = (
                f"{found:g} counts per N up to {described.full_scale_n:.3g} N make {full:.0f} counts; "
                f"{described.bit_depth} bits end at {described.max_count}"
            )
            off = max(full / described.max_count, described.max_count / full)
            why = f"forces would be off by a factor of about {off:.2g}"
            findings.append(wrong(Cause.FORCE_SCALE, item.device, saw, why, _WHERE_SCALE))
        elif len(per_n) > 2 and not 1 / _MAX_SCALE_RATIO <= found / usual <= _MAX_SCALE_RATIO:
            saw = f"{found:g} counts per N; the rig's other arrays have {usual:g}"
            why = "arrays of different sensitivity, or a number that is wrong"
            findings.append(warning(Cause.FORCE_SCALE, item.device, saw, why, _WHERE_SCALE))
    low, high = min(per_n.values()), max(per_n.values())
    saw = f"{low:g} counts per N" if low == high else f"{low:g} to {high:g} counts per N"
    return saw, findings


_WHERE_SCALE = (
    "correct counts_per_n, in the array's firmware or in the rig file, by pressing with a known weight"
)


_MAX_TAXELS_NAMED = 6


def judge_taxels(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Taxels of arrays that fit the rig file."""
    arrays = readings.with_taxels
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
            "what it feels cannot be relied on",
            "check its supply, then run this again: if it is the same, repair or replace it",
        )
    ]


def _bad_taxels(array: UntouchedArray, leave_out: str) -> list[FindingOut]:
    """Taxels that are bad by the array's own account or by their frames, and not left out already."""
    described, shown = array.seen.description, array.shown
    assert described is not None
    dead, hot, unsteady = (np.zeros((described.rows, described.cols), dtype=bool) for _ in range(3))
    if shown is not None:
        dead, hot, unsteady = shown.dead.copy(), shown.hot.copy(), shown.unsteady.copy()
        unsteady[list(shown.disturbed.rows)] = False
        for place in shown.disturbed.taxels:
            unsteady[place] = True
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
    replace = "check the plugs of its flat cable; if they sit fast, repair it or replace the array"
    if len(rows) == len(dead):
        saw = f"none of its {dead.size} taxels ever changes"
        do = "check the cable between skin and electronics"
        return [wrong(Cause.ARRAY_HARDWARE, item.device, saw, _FEELS_NOTHING, do)]
    found = []
    left = dead.copy()
    for cause, name, numbers in ((Cause.DEAD_COLUMN, "column", columns), (Cause.DEAD_ROW, "row", rows)):
        if not len(numbers):
            continue
        which = join_words([str(number) for number in numbers])
        saw = f"all taxels of {name}{'' if len(numbers) == 1 else 's'} {which} are dead"
        found.append(wrong(cause, item.device, saw, _FEELS_NOTHING, replace))
        left[:, columns] = False
        left[rows] = False
    if left.any():
        saw = f"{quantity(int(left.sum()), 'dead taxel', 'dead taxels')}: {_places(left)}"
        found.append(wrong(Cause.DEAD_TAXEL, item.device, saw, _FEELS_NOTHING, f"repair it, or {leave_out}"))
    return found


def _stuck(item: ExaminedArray, hot: Bools, leave_out: str) -> list[FindingOut]:
    if not hot.any():
        return []
    saw = f"{quantity(int(hot.sum()), 'taxel', 'taxels')} at full scale without a touch: {_places(hot)}"
    do = f"look at the skin there, and take off what presses on it; if nothing does, {leave_out}"
    return [wrong(Cause.HOT_TAXEL, item.device, saw, _FEELS_NOTHING, do)]


def _unsteady(item: ExaminedArray, unsteady: Bools, leave_out: str) -> list[FindingOut]:
    if not unsteady.any():
        return []
    noisy = quantity(int(unsteady.sum()), "taxel", "taxels")
    saw = f"{noisy} far noisier than the others: {_places(unsteady)}"
    means = "its jumps pass for contacts"
    return [wrong(Cause.UNSTEADY_TAXEL, item.device, saw, means, f"repair it, or {leave_out}")]


_FEELS_NOTHING = "no contact is felt there"


def _places(taxels: Bools) -> str:
    return join_words([f"row {row} column {col}" for row, col in np.argwhere(taxels)], _MAX_TAXELS_NAMED)
