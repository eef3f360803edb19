"""Calibration step for tactile arrays: idle, and pressed on a disc and a plate at many bearings.

Results are fingers' tables `tactile`. Force comes from the finger's own servos: the currents that they
need besides friction.
"""

import math
from collections.abc import Callable, Sequence

from palpate.calibration.finger_fit import ReferencePlacement
from palpate.calibration.finger_model import nominal_models
from palpate.calibration.fitted_kinematics import FingerModel
from palpate.calibration.idle import analyse_idle
from palpate.calibration.press_levels import PressAtBearing
from palpate.calibration.prober import Prober
from palpate.calibration.reference import Reference
from palpate.calibration.reference_search import locate_reference, probes_at_bearing
from palpate.calibration.taxel_gains import fit_gains
from palpate.config import FingerConfig, TactileCalibration
from palpate.drivers.tactile.messages import Description

__all__ = ["IDLE_S", "measure_tactile"]

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
        for item in _pressed(prober, specs, models, reference, bearings, placing, tell):
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


def _pressed(
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
