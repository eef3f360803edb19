"""Text of a new rig file for the devices found, commented; values to be measured are marked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from palpate.base.errors import InputError
from palpate.config.commissioning_results import ScannedServoOut
from palpate.config.loading import template_text
from palpate.config.rig_servos import without_current
from palpate.drivers.tactile import Description, Shape, TactileArray
from palpate.drivers.transport import MonotonicClock, open_port

_ARRAY_BAUDRATE_BPS = 2_000_000
_BASE_MM = 190.0


@dataclass(frozen=True)
class DescribedArray:
    """A tactile array that described itself on a port."""

    port: str
    description: Description

    @property
    def shows_face(self) -> bool:
        """True if it is flat, and shows where along a face it is touched."""
        return self.description.shape is Shape.FLAT and self.description.cols > 1


def describe_array(port: str, baudrate_bps: int = _ARRAY_BAUDRATE_BPS) -> DescribedArray:
    """Ask the array on a port what it is. Raises DeviceError for a port that is missing or silent."""
    with open_port(port, baudrate_bps) as opened:
        return DescribedArray(port, TactileArray(opened, MonotonicClock(), port).connect())


def rig_text(
    name: str, bus_port: str, servos: Sequence[ScannedServoOut], arrays: Sequence[DescribedArray | str]
) -> str:
    """The text of a rig file: servos are paired in order of their ids, arrays put on fingers in order.

    An array that was not found stands as the name of its port, or as a placeholder where there are too few.
    The tip of a flat array is a pad.
    Raises InputError for fewer than two servos, for servos of different baud rates, of unknown models or of
    models that do not report their current.
    """
    known = sorted(servos, key=lambda servo: servo.id)
    if len(known) < 2:
        raise InputError(f"{len(known)} servos answered; a finger has two: check power, cables and ids")
    rates = {servo.baudrate_bps for servo in known}
    if len(rates) > 1:
        listed = ", ".join(f"id {servo.id} at {servo.baudrate_bps} bit/s" for servo in known)
        raise InputError(f"servos answer at different baud rates ({listed}): palpate setup-motors sets them")
    for servo in known:
        if servo.model is None:
            raise InputError(f"the servo with id {servo.id} is of a model that palpate does not know")
        if (why := without_current(servo.model)) is not None:
            raise InputError(f"the servo with id {servo.id} {why}")
    count = len(known) // 2
    pads = any(isinstance(item, DescribedArray) and item.shows_face for item in arrays[:count])
    fingers = [
        _finger(k, count, known[2 * k : 2 * k + 2], arrays[k] if k < len(arrays) else None, pads=pads)
        for k in range(count)
    ]
    left = f"# Servo {known[-1].id} is left over: a finger has two.\n" if len(known) % 2 else ""
    head = template_text("rig").format(
        name=name,
        port=bus_port,
        baudrate=rates.pop(),
        left=left,
        search=_SEARCH_BY_PADS if pads else "",
        contact=0.4 if pads else 0.3,
    )
    return "\n".join([head + ("" if pads else _HOLDS), *fingers])


def _finger(
    number: int,
    count: int,
    servos: Sequence[ScannedServoOut],
    array: DescribedArray | str | None,
    *,
    pads: bool,
) -> str:
    angle = 2 * math.pi * number / count + math.pi / 2
    x, y = round(_BASE_MM * math.cos(angle), 1) + 0.0, round(_BASE_MM * math.sin(angle), 1) + 0.0
    near, far = servos
    tip, more = _ROUND
    if isinstance(array, DescribedArray):
        shape = array.description
        flat = ", flat" if shape.shape is Shape.FLAT else ""
        port, said = array.port, f"answered: {shape.rows} × {shape.cols} taxels{flat}"
        tip, more = _pad(shape) if array.shows_face else _ROUND
    else:
        port = array or f"/dev/serial/by-id/array-{number + 1}"
        said = "CHANGE: did not answer" if array else "CHANGE: palpate find-port says which it is"
    return template_text("finger").format(
        name=f"f{number + 1}",
        x=x,
        y=y,
        heading=round(math.degrees(angle) % 360 + 180, 1) % 360,
        near=near.id,
        near_model=near.model,
        far=far.id,
        far_model=far.model,
        port=port,
        said=said,
        tip=tip,
        more=more,
        bounds=_BOUNDS_BY_HAND if pads else _BOUNDS,
    )


def _pad(array: Description) -> tuple[str, str]:
    """Lines of a rig file on a pad and the flat array on it, as far as the array says it."""
    pitches = [after - before for before, after in pairwise(array.columns)]
    width = array.columns[-1] - array.columns[0] + (pitches[0] + pitches[-1]) / 2
    pitch = math.ceil(1e3 * max(pitches) - 1e-3) / 1e3  # columns are no further apart
    tip = _PAD_TIP.format(width=f"width_mm = {width:.4g}".ljust(31))
    return tip, f"pitch_mm = {pitch:g}".ljust(31) + " # as the array says: its columns are no further apart\n"


_SEARCH_BY_PADS = """\
search_speed_mm_s = 8.0         # a pad may meet two corners at once, each with the force that check says
"""
_HOLDS = """\
# part_holds_n = 0.3            # MEASURE, for parts that slide when pushed: palpate check --hold
"""
_ROUND = (
    "radius_mm = 5.0                 # MEASURE\n",
    "heading_deg = 0.0               # MEASURE: the array's middle, from where the finger goes\n",
)
_PAD_TIP = """\
shape = "pad"                   # its array is flat; CHANGE to a radius_mm if what touches is round
{width} # MEASURE: the face, from edge to edge; the array's columns reach so far
"""
_BOUNDS = "how well the above was measured; palpate calibrate finds more"
_BOUNDS_BY_HAND = "MEASURE, by hand: docs/pads.md"
