"""Stream steps of a diagnosis: frames, noise, drift and disturbances of untouched arrays."""

import math

from palpate.base.errors import quantity
from palpate.config.diagnosis_results import Cause, FindingOut
from palpate.rig.arrays import bare_extractor, doubt_warning, threshold_problem
from palpate.rig.diagnostics.array_examination import (
    ExaminedArray,
    UntouchedArray,
    UntouchedStatistics,
    frame_rate_hz,
    is_loss_too_high,
    is_rate_too_low,
)
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.diagnostics.steps import DiagnosisCase, Judgement, join_words, warning, wrong

_HUNG_SHARE = 0.1  # of the frames, at the end
_FEELS_NOTHING = "its finger would press on without feeling it"
_LIKE_CONTACTS = "that passes for contacts"


def judge_frames(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Rates of frames, and those that are lost or damaged."""
    wanted, arrays = case.rig.closing.sample_rate_hz, readings.untouched
    findings = [
        found for array in arrays for found in (*_stream(array.seen, wanted), *_repeated(array, wanted))
    ]
    rates = [f"{frame_rate_hz(array.seen.frames):.0f}" for array in arrays]
    lost = sum(array.seen.lost for array in arrays)
    return f"{join_words(sorted(set(rates)))} a second of {wanted:g}, {lost} lost or damaged", findings


def _stream(item: ExaminedArray, wanted: float) -> list[FindingOut]:
    got, lost, rate = len(item.frames), item.lost, frame_rate_hz(item.frames)
    if is_loss_too_high(lost, got):
        return [
            wrong(
                Cause.FRAMES_LOST,
                item.device,
                f"{lost} of {got + lost} frames were lost or damaged"
                + (f"; {item.broken}" if item.broken else ""),
                "contacts are noticed late",
                "plug the array into the computer directly, then run this again: if as many are lost, take "
                "another cable, apart from motor cables",
            )
        ]
    limit = 0.0 if item.description is None else item.description.max_rate_hz
    if item.broken is not None and wanted > limit:
        return [
            wrong(
                Cause.FRAMES_SLOW,
                item.device,
                item.broken,
                f"the rig file asks for more frames than it can send (at most {limit:g} a second)",
                f"write sample_rate_hz = {limit:g} or less below [closing] in the rig file",
            )
        ]
    if item.broken is not None or not got:
        return [
            wrong(
                Cause.NO_FRAMES,
                item.device,
                item.broken or "it answers, and sends no frames",
                _FEELS_NOTHING,
                "power it off and on, then run this again: if it sends none then, either, replace it",
            )
        ]
    if not is_rate_too_low(rate, wanted):
        return []
    return [
        warning(
            Cause.FRAMES_SLOW,
            item.device,
            f"{rate:.0f} frames a second arrive instead of {wanted:g}",
            "contacts are noticed later",
            f"write sample_rate_hz = {math.floor(rate)} in the rig file, or raise the array's baud rate",
        )
    ]


def _repeated(array: UntouchedArray, wanted: float) -> list[FindingOut]:
    """Frames that carry no new reading."""
    if array.shown is None:
        return []
    repeats, device = array.shown.repeats, array.seen.device
    if repeats.last > _HUNG_SHARE * repeats.frames:
        saw = f"the last {repeats.last + 1} frames carry one and the same reading, taxel by taxel"
        if repeats.certain:
            why = f"it hangs, and {_FEELS_NOTHING}"
            return [wrong(Cause.ARRAY_HUNG, device, saw, why, "power it off and on, then run this again")]
        why = f"it has no noise at all, or it hangs and {_FEELS_NOTHING}"
        do = f"press the tip of finger {array.seen.spec.name} while palpate watch shows it: it must change"
        return [warning(Cause.ARRAY_HUNG, device, saw, why, do)]
    if not repeats.certain:
        return []
    saw = (
        f"only {repeats.rate_hz:.0f} of {wanted:g} frames a second carry a new reading; the others repeat it"
    )
    why = f"it samples more slowly than it sends: what it shows is up to {1e3 / repeats.rate_hz:.0f} ms old"
    do = (
        f"let its firmware sample as fast as it sends, or write sample_rate_hz = "
        f"{max(math.floor(repeats.rate_hz), 1)} below [closing]"
    )
    return [warning(Cause.FRAMES_REPEATED, device, saw, why, do)]


def judge_noise(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Noise that would pass for a contact, and zeros that move."""
    heard = [(array, array.shown) for array in readings.untouched if array.shown is not None]
    findings = [found for array, shown in heard for found in _noise_and_drift(case, array, shown)]
    own = [shown for array, shown in heard if array in readings.with_taxels]
    if not own:
        return "contact sources: what they report at rest, beside contact_force_n", findings
    noises = [shown.noise_counts for shown in own]
    drifts = [shown.drift_counts_per_s for shown in own]
    drift = f"drift up to {max(drifts):.2g} counts/s" if any(drifts) else "no drift beyond what is declared"
    noise = " to ".join(dict.fromkeys(f"{value:.2g}" for value in (min(noises), max(noises))))
    return f"noise of {noise} counts, {drift}", findings


def _noise_and_drift(
    case: DiagnosisCase, array: UntouchedArray, shown: UntouchedStatistics
) -> list[FindingOut]:
    spec, described = array.seen.spec, array.seen.description
    assert described is not None
    if spec.array.reports_contacts:
        return _source_at_rest(case, array)
    if shown.drifting:
        allowed = spec.array.drift_counts_per_s
        return [
            wrong(
                Cause.DRIFT,
                array.seen.device,
                f"zeros of {quantity(shown.drifting, 'taxel', 'taxels')} move by up to "
                f"{shown.drift_counts_per_s:.2g} counts/s; the rig file allows {allowed:g}",
                "a contact is felt that is none, or missed",
                "leave it on for ten minutes with nothing near the tip, then run this again: if it drifts as "
                "much, raise drift_counts_per_s",
            )
        ]
    if (found := _disturbance_findings(array, shown)) or shown.unsteady.any():  # which the taxel map has
        return found
    extractor = bare_extractor(case.rig, spec, described)
    extractor.tare(array.seen.frames)
    noisy = threshold_problem(extractor, case.rig.closing, spec.tip)
    if noisy is not None:
        return [
            wrong(
                Cause.NOISE,
                array.seen.device,
                noisy.partition("; ")[0],
                _LIKE_CONTACTS,
                "switch the servos' supply off: if noise goes, part the cables, join the grounds; if not, "
                + noisy.partition("; ")[2],
            )
        ]
    doubt = doubt_warning(case.rig, spec, extractor)
    if doubt is None:
        return []
    means, _, do = doubt.partition("; ")[2].partition(": ")
    return [warning(Cause.HIDDEN_PUSH, array.seen.device, doubt.partition("; ")[0], means, do)]


def _source_at_rest(case: DiagnosisCase, array: UntouchedArray) -> list[FindingOut]:
    """A contact source that reports at rest what contacts would be taken for."""
    spec, described = array.seen.spec, array.seen.description
    assert described is not None
    extractor = bare_extractor(case.rig, spec, described)
    extractor.tare(array.seen.frames)
    problem = threshold_problem(extractor, case.rig.closing, spec.tip)
    if problem is not None:
        saw, _, do = problem.partition("; ")
        return [wrong(Cause.NOISE, array.seen.device, saw, _LIKE_CONTACTS, do)]
    doubt = doubt_warning(case.rig, spec, extractor)
    if doubt is None:
        return []
    saw, means = doubt.partition(": ")[0].split("; ")
    do = "let it know its force better, or hold parts down and leave part_holds_n out"
    return [warning(Cause.HIDDEN_PUSH, array.seen.device, saw, means, do)]


def _disturbance_findings(array: UntouchedArray, shown: UntouchedStatistics) -> list[FindingOut]:
    """Readings that something else than a touch moves."""
    disturbed, device = shown.disturbed, array.seen.device
    if disturbed.common:
        saw = (
            f"all taxels jump together, by up to {disturbed.common_counts:.0f} counts, in "
            f"{disturbed.common} of {disturbed.frames} frames"
        )
        do = (
            "switch the servos' supply off: if they go, part the cables and join the grounds; if not, look "
            "at the array's own supply and cable"
        )
        return [wrong(Cause.INTERFERENCE, device, saw, _LIKE_CONTACTS, do)]
    if not disturbed.rows:
        return []
    rows, times = join_words([str(row) for row in disturbed.rows]), sum(disturbed.rows.values())
    saw = (
        f"whole rows ({rows}) jump by up to {disturbed.row_counts:.0f} counts, {times} times in "
        f"{disturbed.frames} frames"
    )
    do = "check the plugs of the flat cable between skin and electronics; if they sit fast, replace the array"
    return [wrong(Cause.UNSTEADY_ROW, device, saw, _LIKE_CONTACTS, do)]
