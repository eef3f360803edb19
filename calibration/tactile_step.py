"""The step of calibration that measures arrays: still, and pressed on a disc and a plate at many bearings.

From a prober to a finger's table `tactile`. Force comes from the finger's own servo: the current that it
needs besides friction.
"""

import math
from collections.abc import Callable, Sequence

from palpate.calibration.finger_fit import FingerModel, ReferencePlacement
from palpate.calibration.finger_model import finger_model, mm_per_rad_of, touching
from palpate.calibration.gains import GainFit, GainPriors, PressAtBearing, gains_of
from palpate.calibration.idle import IdleFit, idle_of, least_contact_force_n
from palpate.calibration.prober import Prober
from palpate.calibration.reference import Reference
from palpate.calibration.reference_search import at_bearing, find
from palpate.config import SlideFingerConfig
from palpate.config.calibration_finger import TactileCalibration, UnusableTaxel
from palpate.drivers.dynamixel.models import model_named
from palpate.drivers.tactile.messages import Description

__all__ = ["measure_tactile"]

_DISC_DEG = (
    0.0,
    -6.0,
    6.0,
    -12.0,
    12.0,
    -18.0,
    18.0,
    -24.0,
    24.0,
    -30.0,
    30.0,
    -36.0,
    36.0,
    -42.0,
    42.0,
    -47.0,
    47.0,
)
_PLATE_DEG = (-10.0, 10.0)
_IDLE_S = 6.0
_BEARING_SIGMA_RAD = math.radians(0.3)
_FORCE_BOUND = 0.0
_HEADING_BOUND_RAD = math.radians(5.0)


def measure_tactile(
    prober: Prober,
    specs: Sequence[SlideFingerConfig],
    arrays: Sequence[Description],
    disc: Reference,
    plate: Reference,
    *,
    tell: Callable[[str], None],
) -> list[TactileCalibration]:
    """Measure every finger's array; `arrays`: their descriptions. Raises InputError for too little felt."""
    prober.clear()
    tell(f"arrays untouched for {_IDLE_S:g} s")
    idles = prober.idle(_IDLE_S)
    models = [finger_model(spec, touching(spec, None, None)) for spec in specs]
    presses: dict[str, list[PressAtBearing]] = {spec.name: [] for spec in specs}
    for placing, (reference, bearings) in enumerate(((disc, _DISC_DEG), (plate, _PLATE_DEG))):
        tell(f"{reference.name} in the middle: {len(bearings)} presses of each finger")
        prober.put(reference, (0.0, 0.0))
        for item in _pressed(prober, specs, models, reference, bearings, placing, tell):
            presses[item.press.finger].append(item)
    prober.clear()
    tell(f"arrays untouched for {_IDLE_S:g} s")
    idles += prober.idle(_IDLE_S)
    found = []
    for spec, array in zip(specs, arrays, strict=True):
        idle = idle_of([item for item in idles if item.finger == spec.name], array.max_count)
        found.append(
            _table(
                idle, gains_of(presses[spec.name], array, idle, _expected(spec)), array, presses[spec.name]
            )
        )
    return found


def _pressed(
    prober: Prober,
    specs: Sequence[SlideFingerConfig],
    models: Sequence[FingerModel],
    reference: Reference,
    bearings_deg: Sequence[float],
    placing: int,
    tell: Callable[[str], None],
) -> list[PressAtBearing]:
    """Presses of all fingers at each bearing that they can reach."""
    stiffness = [spec.tip.stiffness_n_per_mm for spec in specs]
    found = find(prober, models, [ReferencePlacement(reference, (0.0, 0.0))], [], stiffness)
    by_name = {spec.name: spec for spec in specs}
    result = []
    taken: set[int] = set()
    for number, wanted in enumerate(bearings_deg):
        tell(f"press {number + 1} of {len(bearings_deg)}")
        contacts = at_bearing(found, prober, models, math.radians(wanted))
        contacts = [item for item in contacts if item[0].approach not in taken]
        taken |= {probe.approach for probe, _ in contacts}
        bearing = {specs[prober.approaches[p.approach].finger].name: angle for p, angle in contacts}
        for press in prober.press([probe for probe, _ in contacts], placing) if contacts else []:
            per_a = _newton_per_a(by_name[press.finger])
            curvature = reference.curvature_per_mm()
            result.append(PressAtBearing(press, bearing[press.finger], _BEARING_SIGMA_RAD, curvature, per_a))
    return result


def _newton_per_a(spec: SlideFingerConfig) -> float:
    """Force at the tip for a current of the slide's servo, as the maker states its torque."""
    return model_named(spec.slide.model).known_torque.nm_per_a / (abs(mm_per_rad_of(spec)) / 1000)


def _expected(spec: SlideFingerConfig) -> GainPriors:
    return GainPriors(
        tip_radius_mm=spec.tip.radius_mm,
        mm_per_rad=mm_per_rad_of(spec),
        heading_rad=math.radians(spec.array.heading_deg),
        heading_bound_rad=math.radians(spec.array.heading_bound_deg) or _HEADING_BOUND_RAD,
        gain_spread=spec.array.gain_spread,
        force_bound=_FORCE_BOUND,
        current_step_a=model_named(spec.slide.model).known_torque.current_unit_a,
    )


def _table(
    idle: IdleFit, fit: GainFit, array: Description, presses: Sequence[PressAtBearing]
) -> TactileCalibration:
    faults = ((idle.dead, "dead"), (idle.hot, "hot"), (fit.unresponsive, "unresponsive"))
    return TactileCalibration(
        gain=fit.gain.tolist(),
        gain_bound=fit.gain_bound.tolist(),
        unusable=[
            UnusableTaxel.model_validate({"row": row, "col": col, "what": what})
            for places, what in faults
            for row, col in places
        ],
        noise_counts=idle.noise_counts,
        offset_counts=float(idle.zero_counts[idle.live].mean()),
        drift_counts_per_s=idle.drift_counts_per_s,
        crosstalk=min(max(fit.crosstalk, 0.0), 0.25),
        crosstalk_bound=fit.crosstalk_bound,
        stiffness_n_per_mm=fit.stiffness_n_per_mm,
        stiffness_bound=fit.stiffness_bound,
        least_contact_force_n=least_contact_force_n(idle, array.counts_per_n),
        saturates_n=fit.saturates_n,
        phase_deg=math.degrees(fit.phase_rad),
        phase_sigma_deg=math.degrees(fit.phase_sigma_rad),
        presses=len(presses),
        residual_share=fit.residual_share,
    )
