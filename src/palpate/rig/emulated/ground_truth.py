"""Ground truth on an emulated table, in the frame of the answers, and the error of an answer.

A calibration cannot measure where the rig stands on its table. Its answers are in the hand frame, in which
the fingers are nearest to where the rig file has them; the emulators' truth is in the table's frame. Scenes
that fingers cannot touch, because the part is outside the workspace or below the fingers, are allowed for
testing runs on an apparently empty table.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import shapely
from shapely import affinity

from palpate.calibration.frame_alignment import BasePose, align_to_nominal
from palpate.config import FingerConfig, RigFile, RigOnBench
from palpate.config.recognition_results import PlacedOut, TruthOut
from palpate.drivers.emulators import ArmTruth, FingerTruth
from palpate.recognizer import CatalogueState, Configuration, Hypothesis
from palpate.rig.catalogue.finger_model import at_heights, finger_heights_text
from palpate.rig.catalogue.reachability import workspace_words
from palpate.rig.catalogue.section_stack import region_within
from palpate.rig.emulated.devices import EmulatedRig, emulate
from palpate.rig.emulated.finger_truth import DRAWS
from palpate.rig.emulated.scene import Placement, displace


def compare_answer(
    placement: Placement,
    hypotheses: Sequence[Hypothesis],
    at_measurement: Sequence[Configuration] | None = None,
) -> TruthOut:
    """Compare the truth with the best of the hypotheses that name its object and state.

    `at_measurement`: where the part was when each grip's contacts were measured.
    """
    truth = TruthOut(
        object=placement.model.name,
        state=placement.state.name,
        configuration=Configuration(placement.x_mm, placement.y_mm, placement.theta_rad),
        named=False,
        inside_bounds=False,
        position_error_mm=None,
        orientation_error_rad=None,
        at_measurement=at_measurement,
    )
    found = [
        _compare_hypothesis(placement, item, truth)
        for item in hypotheses
        if (item.state.object_name, item.state.state.name) == (truth.object, truth.state)
    ]
    return min(found, key=lambda item: (not item.inside_bounds, item.position_error_mm), default=truth)


def compare_answers(
    placements: Sequence[Placement],
    hypotheses: Sequence[Hypothesis],
    at_measurement: Sequence[Sequence[Configuration]] | None = None,
) -> TruthOut | None:
    """Compare the part that the hypotheses fit best with them, the others beside it; None for an empty table.

    `at_measurement`: where each part was when each grip's contacts were measured.
    """
    found = [
        compare_answer(lies, hypotheses, None if at_measurement is None else at_measurement[number])
        for number, lies in enumerate(placements)
    ]
    if not found:
        return None
    best = min(
        found, key=lambda item: (not item.named, not item.inside_bounds, item.position_error_mm or 0.0)
    )
    others = tuple(PlacedOut.of(item) for item in found if item is not best)
    return TruthOut.of(best, others=others)


def _compare_hypothesis(placement: Placement, hypothesis: Hypothesis, truth: TruthOut) -> TruthOut:
    """Return the truth with its errors beside an answer that names its object and state."""
    answer, bounds = hypothesis.configuration, hypothesis.search_bounds
    theta = _equal_turn(hypothesis.state, placement.theta_rad, answer.theta_rad)
    # A symmetry turns the object about its centroid, which stays where it is.
    cx, cy = hypothesis.state.origin_mm
    x, y = placement.x_mm, placement.y_mm
    x += _rotated_x(cx, cy, placement.theta_rad) - _rotated_x(cx, cy, theta)
    y += _rotated_x(cy, -cx, placement.theta_rad) - _rotated_x(cy, -cx, theta)
    inside = all(
        lo <= value <= hi
        for value, (lo, hi) in ((x, bounds.x_mm), (y, bounds.y_mm), (theta, bounds.theta_rad))
    )
    return TruthOut.of(
        truth,
        configuration=Configuration(float(x), float(y), float(theta)),
        named=True,
        inside_bounds=inside,
        position_error_mm=math.hypot(answer.x_mm - x, answer.y_mm - y),
        orientation_error_rad=abs(answer.theta_rad - theta),
    )


def _equal_turn(state: CatalogueState, theta_rad: float, near_rad: float) -> float:
    """The orientation next to `near_rad` at which the state looks as it does at `theta_rad`."""
    if state.symmetry_order == 0:
        return near_rad
    turn = 2 * math.pi / state.symmetry_order
    return theta_rad + turn * round((near_rad - theta_rad) / turn)


def _rotated_x(x: float, y: float, angle: float) -> float:
    """First coordinate of (x, y) turned by `angle`; the second is that of (y, −x)."""
    return math.cos(angle) * x - math.sin(angle) * y


def placements_in_hand_frame(
    on_bench: RigOnBench, placements: Sequence[Placement], seed: int, emulated: EmulatedRig | None = None
) -> tuple[Placement, ...]:
    """The placements in the frame that the rig's answers are in: the hand frame once fingers' places were
    calibrated, else that of the rig file.

    `emulated`: the rig as described, as it was made for this seed; made anew without it.
    With it, the parts are where fingers have pushed them by now.
    """
    if emulated is not None:
        moved = emulated.bench.parts.displacements
        placements = [displace(lies, by) for lies, by in zip(placements, moved, strict=True)]
    file = on_bench.calibration
    if not placements or file is None or all(finger.place is None for finger in file.fingers):
        return tuple(placements)
    devices = emulated or emulate(on_bench.described, (), seed)
    truths = [item.truth for item in devices.bench.fingers]
    return tuple(in_hand_frame(lies, on_bench.described, truths) for lies in placements)


def in_hand_frame(placement: Placement, rig: RigFile, truths: Sequence[FingerTruth | ArmTruth]) -> Placement:
    """The placement as a calibrated rig speaks of it: fingers stand nearest to the drawing there.

    `rig` is the drawing, the rig file before it was calibrated; `truths` are its fingers', in their order.
    """
    drawn = [BasePose(finger.base_mm, math.radians(finger.heading_deg)) for finger in rig.fingers]
    built = [built_pose(spec, truth) for spec, truth in zip(rig.fingers, truths, strict=True)]
    moved = align_to_nominal(drawn, built)
    x, y = moved.point_mm((placement.x_mm, placement.y_mm))
    return replace(placement, x_mm=x, y_mm=y, theta_rad=placement.theta_rad + moved.angle_rad)


def built_pose(spec: FingerConfig, truth: FingerTruth | ArmTruth) -> BasePose:
    """True place of a finger, with its heading as a calibration has it."""
    return BasePose(truth.base_mm, DRAWS[type(spec)].heading_rad(spec, truth))


_ORIGIN = shapely.Point(0, 0)
_TOLERANCE_MM = 0.01
_EMPTY = "the table will seem empty"
_NOT_THERE = "it will seem not to be there"


def scene_lines(rig: RigFile, placements: Sequence[Placement]) -> list[str]:
    """A line for each part that a scene puts on an emulated table and that cannot be touched as it should."""
    return [line for lies in placements for line in _placement_lines(rig, lies, alone=len(placements) == 1)]


def _placement_lines(rig: RigFile, placement: Placement, *, alone: bool) -> list[str]:
    name = f"scene: {placement.model.name}, {placement.state.name}"
    unseen = _EMPTY if alone else _NOT_THERE
    heights = at_heights(rig)
    met = shapely.union_all([_region(placement, at.span_mm) for at in heights])
    if met.is_empty:
        high = f"{placement.state.top_mm:.3g} mm high"
        fingers = finger_heights_text(heights)
        return [f"{name} ({high}): nothing at the height of any finger, {fingers}; {unseen}"]
    if shapely.distance(met, _ORIGIN) >= rig.workspace.radius_mm:
        return [f"{name}: lies outside of {workspace_words(rig)}; {unseen}"]
    beyond = sticks_out_mm(rig, placement)
    if beyond > 0:
        return [f"{name}: sticks out of {workspace_words(rig)}, by {beyond:.3g} mm; fingers may start on it"]
    return []


def sticks_out_mm(rig: RigFile, placement: Placement) -> float:
    """Distance by which the part sticks out of the workspace at the heights of fingers; 0 if it does not."""
    met = shapely.union_all([_region(placement, at.span_mm) for at in at_heights(rig)])
    if met.is_empty:
        return 0.0
    beyond = float(shapely.hausdorff_distance(met, _ORIGIN)) - rig.workspace.radius_mm
    return beyond if beyond > _TOLERANCE_MM else 0.0


def _region(placement: Placement, span_mm: tuple[float, float]) -> shapely.Geometry:
    region = region_within(placement.state, span_mm)
    turned = affinity.rotate(region, placement.theta_rad, (0, 0), use_radians=True)
    return affinity.translate(turned, placement.x_mm, placement.y_mm)
