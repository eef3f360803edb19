"""Calibration steps for actuators and for tactile arrays: what idle, moving and pressing fingers show.

Gains of taxels, phase, stiffness and crosstalk follow from the presses: columns first (`press_model`);
within a column the taxels share the load, as references stand higher than the array and touch it along all
of its rows. A reference that leans would be taken for a slope of gains along the tip. Force comes from the
finger's own servos: the currents that they need besides friction. Results are fingers' tables `tactile`.

*Actuators.* Homing, direction, backlash, friction, latency and overshoot are measured for slides and aims.
For arms only direction and friction of the joints and the stopping of tips are measured; their backlash stays
as declared, and is refined by the fit of the fingers. The table is cleared for homing; presses and stops need
a disc. Results are fingers' tables `actuators`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats
from palpate.calibration.actuator_estimators import StopStalls, fit_stops
from palpate.calibration.experiment_design import LocatedReference, locate_reference, probes_at_bearing
from palpate.calibration.finger_doubt import check_arrays
from palpate.calibration.finger_fit import ReferencePlacement
from palpate.calibration.finger_model import ActuatorMeasurements, FingerModel, encoder_rate_sigma
from palpate.calibration.idle_statistics import (
    COVERAGE_SIGMAS,
    IdleFit,
    PressAtBearing,
    PressLevels,
    analyse_idle,
    average_levels,
    informative_presses,
    least_contact_force_n,
)
from palpate.calibration.measurements import LEG_IN, PressMeasurement, Prober, Reference, StopMeasurement
from palpate.calibration.press_model import HEADING_BOUND_DEG, PressFit, dent_and_bearing, fit_presses
from palpate.calibration.rig_models import nominal_model, nominal_models
from palpate.config import FingerConfig, TactileCalibration, UnusableTaxel
from palpate.config.calibration_finger import Actuators
from palpate.drivers.tactile import Description, Shape, column_windows

_STALLS_PER_STOP = 2
_BEARINGS_DEG = (-20.0, 0.0, 20.0)
_STOPS_PER_SPEED = 2


def measure_actuators(
    prober: Prober,
    specs: Sequence[FingerConfig],
    disc: Reference,
    *,
    touch_speed_mm_s: float,
    approach_speed_mm_s: float,
    coverage: float,
    tell: Callable[[str], None],
) -> list[Actuators]:
    """Measure every finger's actuators. Raises InputError for what is not as described."""
    prober.clear()
    frictions = [0.0] * len(specs)
    models = nominal_models(specs)
    if any(model.slide is not None for model in models):
        tell("aims: friction")
        frictions = prober.swing()
    stalls = [_stall(prober, index, model, tell) for index, model in enumerate(models)]
    tell("disc in the middle: play, friction and stopping")
    prober.put(disc, (0.0, 0.0))
    found = locate_reference(prober, models, [ReferencePlacement(disc, (0.0, 0.0))], [], specs)
    check_arrays(specs, models, found.touched, found.fit)
    presses = _presses(prober, models, found, tell)
    all_stops = _stops(prober, models, found, touch_speed_mm_s, approach_speed_mm_s, tell)
    stops = {spec.name: [stop for stop in all_stops if stop.finger == spec.name] for spec in specs}
    results: list[Actuators] = []
    for index, (spec, model) in enumerate(zip(specs, models, strict=True)):
        own = [press for press in presses if press.finger == spec.name]
        if not own:
            raise InputError(
                f"finger {spec.name}: no approach meets the disc head-on; put it nearer to the middle "
                "and begin again"
            )
        step_mm = max(press.step_mm for press in own)
        touched = [k for k, item in enumerate(found.touched) if item.finger == spec.name]
        measured = ActuatorMeasurements(
            own,
            fit_stops(stops[spec.name], step_mm, touch_speed_mm_s, coverage),
            stalls[index],
            frictions[index],
            [found.touched[k] for k in touched],
            found.fit.normal[touched],
        )
        results.append(model.describe_actuators(measured))
    return results


def _stall(prober: Prober, index: int, model: FingerModel, tell: Callable[[str], None]) -> StopStalls | None:
    """Stalls of a slide at both stops; None without a slide or without stops that are described."""
    if model.slide is None:
        return None
    stops = model.slide.stops_mm
    if stops is None:
        tell(f"{model.name}: no slide.stops_mm in the rig file, so travel and zero are taken as described")
        return None
    tell(f"{model.name}: homing against {stops[0]:g} and {stops[1]:g} mm")
    back, front = (np.array([prober.home(index, stop) for _ in range(_STALLS_PER_STOP)]) for stop in stops)
    return StopStalls(stops, back, front)


def _presses(
    prober: Prober, models: Sequence[FingerModel], found: LocatedReference, tell: Callable[[str], None]
) -> list[PressMeasurement]:
    presses: list[PressMeasurement] = []
    for number, bearing in enumerate(_BEARINGS_DEG):
        tell(f"press {number + 1} of {len(_BEARINGS_DEG)}")
        contacts = [probe for probe, _ in probes_at_bearing(found, prober, models, math.radians(bearing))]
        presses += prober.press(contacts, 0)
    return presses


def _stops(
    prober: Prober,
    models: Sequence[FingerModel],
    found: LocatedReference,
    touch_mm_s: float,
    approach_mm_s: float,
    tell: Callable[[str], None],
) -> list[StopMeasurement]:
    """Stops at three speeds up to the fastest approach, head-on."""
    contacts = [probe for probe, _ in probes_at_bearing(found, prober, models, 0.0)]
    slow = min(2 * touch_mm_s, approach_mm_s)
    stops: list[StopMeasurement] = []
    for speed in dict.fromkeys((slow, (slow + approach_mm_s) / 2, approach_mm_s)):
        tell(f"stopping from {speed:g} mm/s")
        for _ in range(_STOPS_PER_SPEED):
            stops += prober.stop(contacts, speed)
    return stops


_ROW_SHARE = 0.003  # rows do not share a load more evenly
_MAX_SILENT_SHARE = 0.15  # of what its column's taxels read
_MIN_LOAD_SIGMAS = 40.0  # what a column must read to tell a silent taxel
_MIN_LIT_SHARE = 0.02  # of the strongest column: residuals of weaker ones say nothing
_MAX_CROSSTALK = 0.25
_MAX_STIFFNESS_BOUND = 0.99  # what a calibration file can hold
_MAX_MISFIT_RATIO = (
    3.0  # a press is left out that is off by so many deviations, and so many times as much as most
)


def fit_gains(
    presses: Sequence[PressAtBearing], description: Description, idle: IdleFit, spec: FingerConfig
) -> TactileCalibration:
    """Calibrate the array of one finger from its presses at several bearings.

    Bounds hold in 99.9 % of cases. A gain is counts per N over what the array says; of a taxel that was not
    pressed it is 1, bounded by the rig file's `gain_spread`. The newtons are those that currents show, whose
    scale all gains and the stiffness share. Only the way in is looked at: there the backlash is taken up and
    friction always has the same sign. Rows are taken to bear even shares: those of an emulated ball do, those
    of a real one do not. Presses that met nothing where they should have, and those that no place on the
    reference explains, as a corner in the patch, are left out, as long as they are fewer than half. Raises
    InputError without presses, for an array that is not bent round a cylinder, for real balls, and for
    presses that move or load the array too little.
    """
    if not presses:
        raise InputError("gains of an array: there are no presses; press a reference at several bearings")
    if description.shape is not Shape.CYLINDER or description.cols < 2:
        raise InputError(
            f"array {description.unique_id.hex()}: only arrays bent round a cylindrical tip are calibrated "
            "by presses; give the gains of this one in the rig file"
        )
    why = spec.tip.kind.cannot.get("calibrate taxels")
    if why is not None and not description.emulated:
        raise InputError(f"finger {spec.name}: its tip is {spec.tip.kind.with_article}, and {why}")
    full = description.max_count - 0.5 - idle.zero_counts
    used = informative_presses(presses, idle.live, full, idle.noise_counts)
    columns = _fit_columns(used, full, description, idle, spec)
    while (worst := _worst_press(columns.found)) is not None and 2 * (len(used) - 1) > len(presses):
        used = [*used[:worst], *used[worst + 1 :]]
        columns = _fit_columns(used, full, description, idle, spec)
    stiffness_sigma = math.hypot(columns.found.stiffness_log_sigma, encoder_rate_sigma(spec))
    stiffness_bound = math.expm1(COVERAGE_SIGMAS * stiffness_sigma)
    levels, silent, found = columns.levels, columns.silent, columns.found
    usable = idle.live & ~silent
    ratio, ratio_sigma = _row_gains(levels, usable, columns.counts, found.counts, idle.noise_counts)
    bound = np.expm1(COVERAGE_SIGMAS * np.hypot(found.gain_log_sigma, ratio_sigma))
    pressed = usable & (bound < spec.array.gain_spread)
    if stiffness_bound > _MAX_STIFFNESS_BOUND or not pressed.any():
        raise _unexplained(spec)
    phase_sigma_deg = math.hypot(math.degrees(found.phase_sigma_rad), nominal_model(spec).facing_sigma_deg)
    _check_phase(spec, math.degrees(found.phase_rad), COVERAGE_SIGMAS * phase_sigma_deg)
    gain = np.where(pressed, found.gain * ratio, 1.0)
    lit = np.abs(found.counts) > _MIN_LIT_SHARE * found.counts.max(axis=1, keepdims=True)
    faults = ((idle.dead, "dead"), (idle.hot, "hot"), (np.argwhere(silent).tolist(), "unresponsive"))
    return TactileCalibration(
        gain=gain.tolist(),
        gain_bound=np.where(pressed, bound, spec.array.gain_spread).tolist(),
        unusable=[
            UnusableTaxel.model_validate({"row": row, "col": col, "what": what})
            for places, what in faults
            for row, col in places
        ],
        noise_counts=idle.noise_counts,
        offset_counts=float(idle.zero_counts[idle.live].mean()),
        drift_counts_per_s=idle.drift_counts_per_s,
        force_drift_n_per_s=idle.drift_of_sums(column_windows(usable / (gain * description.counts_per_n))),
        crosstalk=min(max(found.crosstalk, 0.0), _MAX_CROSSTALK),
        crosstalk_bound=COVERAGE_SIGMAS * found.crosstalk_sigma,
        stiffness_n_per_mm=found.stiffness_n_per_mm,
        stiffness_bound=stiffness_bound,
        least_contact_force_n=least_contact_force_n(idle, description.counts_per_n),
        saturates_n=_saturates_n(used, levels, found, idle.live, full, spec),
        phase_deg=math.degrees(found.phase_rad),
        phase_sigma_deg=phase_sigma_deg,
        presses=len(used),
        residual_share=float(np.sqrt((found.off[lit] ** 2).mean())),
    )


@dataclass(frozen=True, eq=False)
class _Columns:
    """A fit of columns, with what went into it: `counts` (m, cols), means over the rows that are used."""

    levels: PressLevels
    silent: Bools
    counts: Floats
    found: PressFit


def _fit_columns(
    used: Sequence[PressAtBearing], full: Floats, description: Description, idle: IdleFit, spec: FingerConfig
) -> _Columns:
    levels = average_levels(used, idle.live, full, idle.noise_counts)
    silent = _silent_taxels(levels, idle)
    usable = idle.live & ~silent
    rows_used = usable.sum(axis=0)
    counts = (levels.counts * usable).sum(axis=1) / np.maximum(rows_used, 1)
    try:
        found = fit_presses(used, levels, counts, rows_used, idle.noise_counts, description, spec)
    except np.linalg.LinAlgError as error:
        raise _unexplained(spec) from error
    return _Columns(levels, silent, counts, found)


def _check_phase(spec: FingerConfig, phase_deg: float, bound_deg: float) -> None:
    """Refuse an array that looks elsewhere than the rig file allows: its columns are not where it says."""
    told, allowed = spec.array.heading_deg, spec.array.heading_bound_deg or HEADING_BOUND_DEG
    if abs(math.remainder(phase_deg - told, 360)) > allowed + bound_deg:
        raise InputError(
            f"finger {spec.name}: by its presses the middle of its array looks at {phase_deg:.0f}° ± "
            f"{bound_deg:.2g}°, and the rig file says {told:g}° ± {allowed:g}°; palpate check --press shows "
            "whether the array is turned or mirrored"
        )


def _unexplained(spec: FingerConfig) -> InputError:
    return InputError(
        f"finger {spec.name}: the columns of its array that answered do not fit where the reference pressed "
        "on its tip, so that neither gains nor stiffness follow; palpate check --press shows whether the "
        "array is turned or mirrored"
    )


def _worst_press(found: PressFit) -> int | None:
    """The press that is off most, if the others are not off nearly as much."""
    worst = int(found.misfit.argmax())
    limit = _MAX_MISFIT_RATIO * max(1.0, float(np.median(found.misfit)))
    return worst if found.misfit[worst] > limit else None


def _silent_taxels(levels: PressLevels, idle: IdleFit) -> Bools:
    """Live taxels (rows, cols) that read next to nothing where their column reads much."""
    live = idle.live
    total = (levels.counts * levels.samples[:, None, None]).sum(axis=0)
    noise = idle.noise_counts * math.sqrt(float(levels.samples.sum()))
    middle = np.zeros(live.shape[1])
    for col in np.flatnonzero(live.any(axis=0)):
        middle[col] = np.median(total[live[:, col], col])
    result: Bools = live & (middle > _MIN_LOAD_SIGMAS * noise) & (total < _MAX_SILENT_SHARE * middle)
    return result


def _row_gains(
    levels: PressLevels, usable: Bools, column_counts: Floats, modelled: Floats, noise: float
) -> tuple[Floats, Floats]:
    """Gain of taxels over the mean of their column's usable ones, ± a share of it; (rows, cols).

    Counts are weighed by what the model says of the column, which has no noise of its own in it.
    """
    weight = np.maximum(modelled, 0.0)
    along = np.einsum("mc,mrc->rc", weight, levels.counts)
    mean = np.einsum("mc,mc->c", weight, column_counts)
    noise_of_sum = noise * np.sqrt(np.einsum("mc,m->c", weight**2, 1 / levels.samples))
    safe = np.maximum(mean, 1e-9)
    ratio = np.where(usable, along / safe, 1.0)
    sigma = np.hypot(_ROW_SHARE, noise_of_sum / safe / np.maximum(ratio, 0.1))
    return ratio, np.minimum(sigma, 10.0)


def _saturates_n(
    presses: Sequence[PressAtBearing],
    levels: PressLevels,
    found: PressFit,
    live: Bools,
    full: Floats,
    spec: FingerConfig,
) -> float | None:
    """Least force on the tip with a live taxel at its largest count, by the dent on the way in."""
    least = math.inf
    for at, start, touch, bearing in zip(
        presses, levels.start_mm, found.touch_mm, found.bearing_rad, strict=True
    ):
        saturated = ((at.press.counts >= full) & live).any(axis=(1, 2)) & (at.press.leg == LEG_IN)
        travel = at.approach_mm()[saturated] - start - touch
        curvature = np.full(len(travel), at.curvature_per_mm)
        dent, _ = dent_and_bearing(travel, np.full(len(travel), bearing), spec.tip.radius_mm, curvature)
        least = min(least, float(dent.min(initial=math.inf)) * found.stiffness_n_per_mm)
    return None if math.isinf(least) else least


_DISC_DEG = (
    0.0,
    *(side * angle for angle in (6.0, 12.0, 18.0, 24.0, 30.0, 36.0, 42.0, 47.0) for side in (-1, 1)),
)
_PLATE_DEG = (-10.0, 10.0)
IDLE_S = 30.0
"""Each recording of untouched arrays: a drift that is measured in less is mostly noise."""

_BEARING_SIGMA_RAD = math.radians(0.3)


def measure_tactile(
    prober: Prober,
    specs: Sequence[FingerConfig],
    arrays: Sequence[Description],
    disc: Reference,
    plate: Reference,
    *,
    tell: Callable[[str], None],
) -> list[TactileCalibration]:
    """Measure every finger's array; `arrays`: their descriptions. Raises what `fit_gains` raises."""
    prober.clear()
    tell(f"arrays untouched for {IDLE_S:g} s")
    idles = prober.idle(IDLE_S)
    models = nominal_models(specs)
    presses: dict[str, list[PressAtBearing]] = {spec.name: [] for spec in specs}
    for placing, (reference, bearings) in enumerate(((disc, _DISC_DEG), (plate, _PLATE_DEG))):
        tell(f"{reference.name} in the middle: {len(bearings)} presses of each finger")
        prober.put(reference, (0.0, 0.0))
        for item in _press_at_bearings(prober, specs, models, reference, bearings, placing, tell):
            presses[item.press.finger].append(item)
    prober.clear()
    tell(f"arrays untouched for {IDLE_S:g} s")
    idles += prober.idle(IDLE_S)
    return [
        fit_gains(
            presses[spec.name],
            array,
            analyse_idle([item for item in idles if item.finger == spec.name], array.max_count),
            spec,
        )
        for spec, array in zip(specs, arrays, strict=True)
    ]


def _press_at_bearings(
    prober: Prober,
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    reference: Reference,
    bearings_deg: Sequence[float],
    placing: int,
    tell: Callable[[str], None],
) -> list[PressAtBearing]:
    """Presses of all fingers at each bearing that they can reach."""
    found = locate_reference(prober, models, [ReferencePlacement(reference, (0.0, 0.0))], [], specs)
    if not reference.turns:
        check_arrays(specs, models, found.touched, found.fit)
    result = []
    taken: set[int] = set()
    for number, wanted in enumerate(bearings_deg):
        tell(f"press {number + 1} of {len(bearings_deg)}")
        contacts = probes_at_bearing(found, prober, models, math.radians(wanted))
        contacts = [item for item in contacts if item[0].approach not in taken]
        taken |= {probe.approach for probe, _ in contacts}
        bearing = {specs[prober.approaches[p.approach].finger].name: angle for p, angle in contacts}
        for press in prober.press([probe for probe, _ in contacts], placing) if contacts else []:
            curvature = reference.curvature_per_mm()
            result.append(PressAtBearing(press, bearing[press.finger], _BEARING_SIGMA_RAD, curvature))
    return result
