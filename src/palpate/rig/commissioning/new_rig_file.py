"""Text of a new rig file, commented, for the devices that were found; what must be measured is marked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from palpate.base.errors import InputError
from palpate.config.commissioning_results import ScannedServoOut
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
        _finger(k, count, known[2 * k : 2 * k + 2], arrays[k] if k < len(arrays) else None)
        + (_BOUNDS_BY_HAND if pads else _BOUNDS)
        for k in range(count)
    ]
    left = f"# Servo {known[-1].id} is left over: a finger has two.\n" if len(known) % 2 else ""
    head = _HEAD.format(
        name=name,
        port=bus_port,
        baudrate=rates.pop(),
        left=left,
        search=_SEARCH_BY_PADS if pads else "",
        contact=0.4 if pads else 0.3,
    )
    return head + ("" if pads else _HOLDS) + "".join(fingers)


def _finger(
    number: int, count: int, servos: Sequence[ScannedServoOut], array: DescribedArray | str | None
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
    return _FINGER.format(
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
    )


def _pad(array: Description) -> tuple[str, str]:
    """Lines of a rig file on a pad and the flat array on it, as far as the array says it."""
    pitches = [after - before for before, after in pairwise(array.columns)]
    width = array.columns[-1] - array.columns[0] + (pitches[0] + pitches[-1]) / 2
    pitch = math.ceil(1e3 * max(pitches) - 1e-3) / 1e3  # columns are no further apart
    tip = _PAD_TIP.format(width=f"width_mm = {width:.4g}".ljust(31))
    return tip, f"pitch_mm = {pitch:g}".ljust(31) + " # as the array says: its columns are no further apart\n"


_HEAD = """\
#:schema ./rig.schema.json
# A rig for palpate, made by `palpate init` for the devices that answered. Lines with MEASURE have values of a
# typical bench, which are surely wrong for yours; docs/rig-file.md explains every key. `palpate check --rig`
# asks every device, moves nothing, and says what is wrong. Directions are counter-clockwise from +x of the
# frame W, whose origin is the middle of the table.
{left}format = "palpate/rig@1"
name = "{name}"

[bus]
port = "{port}"
baudrate_bps = {baudrate}

[workspace]
radius_mm = 125.0               # MEASURE: parts lie inside; fingers wait outside

[closing]
approach_speed_mm_s = 20.0      # slow enough to stop at once
{search}touch_speed_mm_s = 4.0
back_off_mm = 1.5
contact_force_n = {contact}           # well above the arrays' noise, well below what moves a part
max_force_n = 6.0               # fingers stop above it
clearance_mm = 5.0
sample_rate_hz = 100.0

[search]
max_grips = 8
goal_position_mm = 1.0
goal_orientation_deg = 1.0
"""

_SEARCH_BY_PADS = """\
search_speed_mm_s = 8.0         # a pad may meet two corners at once, each with the force that check says
"""

_HOLDS = """\
# part_holds_n = 0.3            # MEASURE, for parts that slide when pushed: palpate check --hold
"""

_FINGER = """
[[fingers]]
name = "{name}"
base_mm = [{x}, {y}]            # MEASURE: axis of the aim, in W
heading_deg = {heading}            # MEASURE: direction of the slide at aim 0, towards the table's middle
height_mm = 10.0                # MEASURE: middle of the tip above the table

[fingers.aim]                   # the servo that turns the slide
dxl_id = {near}
model = "{near_model}"
gear_ratio = 5.0                # MEASURE: turns of the servo for one of the slide
range_deg = [-35.0, 35.0]       # MEASURE: as far as it may turn
backlash_deg = 0.1              # MEASURE: bound on play, either way
zero_deg = 180.0                # servo angle at aim 0, from Goal Position 0

[fingers.slide]                 # the servo that moves the tip in and out
dxl_id = {far}
model = "{far_model}"
mm_per_turn = 100.0             # MEASURE: negative if growing angles pull the tip back
range_mm = [45.0, 250.0]        # MEASURE: from the aim's axis to the middle of the tip
backlash_mm = 0.1               # MEASURE
zero_mm = 40.0                  # MEASURE: where the tip would be at Present Position 0

[fingers.tip]
{tip}stiffness_n_per_mm = 2.5        # MEASURE: force per mm of dent
stiffness_spread = 0.3          # it is known to ± 30 %

[fingers.array]
port = "{port}"   # {said}
baudrate_bps = 2000000
protocol = "palpate"
gain_spread = 0.25
{more}"""

_ROUND = (
    "radius_mm = 5.0                 # MEASURE\n",
    "heading_deg = 0.0               # MEASURE: the array's middle, from where the finger goes\n",
)

_PAD_TIP = """\
shape = "pad"                   # its array is flat; CHANGE to a radius_mm if what touches is round
{width} # MEASURE: the face, from edge to edge; the array's columns reach so far
"""

_BOUNDS = """
[fingers.bounds]                # how well the above was measured; palpate calibrate finds more
base_mm = 2.0
heading_deg = 2.0
"""

_BOUNDS_BY_HAND = """
[fingers.bounds]                # MEASURE, by hand: docs/pads.md
base_mm = 2.0
heading_deg = 2.0
"""
