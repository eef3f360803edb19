"""Findings about a rig's wiring: what was seen in words, its cause, and the changes to the rig file."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from palpate.base.errors import quantity
from palpate.config import FingerConfig, RigFile, SlideFingerConfig
from palpate.config.diagnosis_results import Cause, FindingOut, WiringChangeOut
from palpate.rig.diagnostics.steps import NamedDevice, join_words, name_servo, name_together, wrong
from palpate.rig.diagnostics.wiring import (
    Candidate,
    FingerWiring,
    MeasuredFrame,
    Seen,
    Side,
    TipPress,
    explain,
    mounting,
    press_explains,
    standing_at,
    wiring_of,
)

_RETRACTED_MM = 1.0  # from the retracted end, as people leave slides
_WRITE = "palpate check --press --move --apply writes that into the rig file"
_WRITE_PRESSED = "palpate check --press --apply writes that into the rig file"
_MAX_SEEN = 3  # observations that are told
_TOUCHES = "a contact would count as another finger's, and fingers would press where nothing is felt"


@dataclass(frozen=True)
class WiringVerdict:
    """Verdict on a wiring: what is wrong, and the changes to the rig file that mend it.

    `is_proof`: nothing is, and each array felt two presses: one does not show whether it counts mirrored.
    """

    findings: tuple[FindingOut, ...]
    changes: tuple[WiringChangeOut, ...] = ()
    is_proof: bool = False


def judge_wiring(rig: RigFile, seen: Seen) -> WiringVerdict:
    """Judge a rig file's wiring by what was seen; nothing that was not seen is named as a cause."""
    told = wiring_of(rig)
    odd = tuple(_oddities(seen))
    if odd:
        return WiringVerdict(odd)
    found = explain(told, seen)
    differences = list(_differences(told, seen))
    saw = join_words(differences or ["something else than the rig file says"], _MAX_SEEN, "observations")
    if not found:
        do = "look again; if it is the same, compare cables, ids and places one by one"
        return WiringVerdict((_unclear(saw, "no few changes to the rig file explain all of it", do),))
    if len(found) > 1:
        several = " or ".join(_words(rig, item) for item in found[:3])
        do = "palpate check --press --move, and answer for every tip: that tells them apart"
        return WiringVerdict((_unclear(saw, f"either {several}", do),))
    (best,) = found
    causes = list(_causes(rig, best))
    why = "; ".join(words for _, _, words, _ in causes)
    do = _WRITE if seen.moves else _WRITE_PRESSED
    findings = tuple(
        wrong(cause, device, f"{words}: {saw}", means, do) for cause, device, words, means in causes
    )
    felt = Counter(press.asked for press in seen.presses if press.arrays)
    is_proof = not findings and all(felt[item.name] > 1 for item in told)
    return WiringVerdict(findings, tuple(wiring_changes(rig, best, seen.turns, why)), is_proof)


def _unclear(saw: str, means: str, do: str) -> FindingOut:
    return wrong(Cause.WIRING_UNCLEAR, NamedDevice("wiring"), saw, means, do)


def _oddities(seen: Seen) -> Iterator[FindingOut]:
    """What no other wiring would explain: a press that no array or several felt, a move of no tip."""
    asked = list(dict.fromkeys(press.asked for press in seen.presses if press.stood))
    for name in asked:
        presses = [press for press in seen.presses if press.asked == name]
        several = next((press.arrays for press in presses if len(press.arrays) > 1), ())
        if several:
            saw = f"a press on the tip at the place of finger {name} was felt by arrays {join_words(several)}"
            yield _unclear(
                saw,
                "one of them was touched, too, or arrays disturb each other",
                "press again, with one finger",
            )
        elif not any(press.arrays for press in presses):
            saw = f"no array felt a press on the tip at the place of finger {name}"
            do = "see in palpate watch whether that tip shows anything, and press harder"
            yield _unclear(
                saw, "its array is not one of this rig's, or its skin does not reach the taxels", do
            )
    for move in seen.moves:
        if move.base_mm is None:
            saw = f"no tip moved when joint {move.joint + 1} of finger {move.finger} turned"
            do = "see that the horn is fast on its servo, and look again"
            yield _unclear(saw, "the servo turned, and what it drives did not", do)


def _differences(told: Sequence[FingerWiring], seen: Seen) -> Iterator[str]:
    """What was seen and is not as the rig file says."""
    bases = [item.base_mm for item in told]
    by_name = {item.name: item for item in told}
    for press in seen.presses:
        if not press.stood and press.side is Side.FRONT:
            yield f"no finger stands at the place of {press.asked}"
        elif press.arrays and press.arrays[0] != press.asked and press.side is Side.FRONT:
            yield f"the press on {press.asked} was felt by the array of {press.arrays[0]}"
        elif press.arrays == (press.asked,) and not press_explains(*2 * (by_name[press.asked],), press):
            yield f"the press on {press.asked}, {_SIDES[press.side]}, was felt {_press_words(press, told)}"
    for move in seen.moves:
        at = None if move.base_mm is None else standing_at(bases, move.base_mm)
        if move.way is None or at is None or at != list(by_name).index(move.finger):
            other = "an unknown place" if at is None else told[at].name
            yield f"servo {by_name[move.finger].ids[move.joint]} ({move.finger}) moved the tip of {other}"
        elif move.way.value != (move.joint, 1):
            servo = f"servo {by_name[move.finger].ids[move.joint]} ({move.finger})"
            yield f"{servo} moved its tip {move.way.name.lower()}"


def _press_words(press: TipPress, told: Sequence[FingerWiring]) -> str:
    """Where a press was felt on a tip, seen from its base, if its array is mounted as the file says."""
    if press.angle_deg is None:
        return "nowhere"
    mounted = next(item for item in told if item.name == press.asked)
    angle = math.remainder(press.angle_deg + mounted.array_deg, 360)
    where = "towards its base" if abs(angle) > 135 else "on its left" if angle > 45 else "on its right"
    where = "away from its base" if abs(angle) <= 45 else where
    return f"{where} ({angle:+.0f}°)" + {True: ", low", False: ", high", None: ""}[press.low]


_SIDES = {Side.FRONT: "away from its base", Side.LEFT: "on its left", Side.RIGHT: "on its right"}
_Cause = tuple[Cause, NamedDevice, str, str]


def _words(rig: RigFile, found: Candidate) -> str:
    return " and ".join(words for _, _, words, _ in _causes(rig, found)) or "all is as the rig file says"


def _causes(rig: RigFile, found: Candidate) -> Iterator[_Cause]:
    """Each change with its cause, its device, what is wrong in words, and what that means."""
    file = NamedDevice("the rig file")
    if found.frame is not MeasuredFrame.RIGHT:
        axis = "y" if found.frame is MeasuredFrame.Y_MIRRORED else "x"
        words = f"the frame was measured mirrored, with its {axis} axis the other way round"
        yield Cause.FRAME_MIRRORED, file, words, "every pose would be found mirrored"
    if found.moved_places:
        words = _places_in_words(found)
        yield Cause.PLACES_SWAPPED, file, words, "every pose would be found turned or mirrored"
    exchanged = found.differing(lambda item: item.port)
    if exchanged:
        device = NamedDevice(join_words([f"array {name}" for name in exchanged]), arrays=tuple(exchanged))
        words = f"the arrays of {join_words(exchanged)} are on each other's ports"
        yield Cause.ARRAYS_SWAPPED, device, words, _TOUCHES
    exchanged = found.differing(lambda item: item.ids)
    if exchanged:
        ids = [(name, dxl_id) for name in exchanged for dxl_id in _by_file(found, name).ids]
        device = name_together(join_words([str(i) for _, i in ids]), [name_servo(n, i) for n, i in ids])
        words = f"servos of {join_words(exchanged)} have each other's ids"
        yield (
            Cause.SERVOS_SWAPPED,
            NamedDevice(f"servos {device.name}", device.servos),
            words,
            "another joint moves than is meant to",
        )
    for name, joint in found.reversed_joints:
        table, servo = tuple(_spec(rig, name).servos.items())[joint]
        device = name_servo(f"{name} {table}", _as_found(found, name).ids[joint])
        words = f"{table}.{servo.ratio_key} of finger {name} has the other sign"
        yield (
            Cause.DIRECTION_WRONG,
            device,
            words,
            "its servo is mounted the other way round than the file says",
        )
    for name in found.differing(mounting):
        words = f"the array of {name} {_mounting_in_words(found, name)}"
        yield (
            Cause.ARRAY_MOUNTING,
            NamedDevice(f"array {name}", arrays=(name,)),
            words,
            "contacts would be taken for ones elsewhere on the tip",
        )


def _by_file(found: Candidate, name: str) -> FingerWiring:
    return next(item for item in found.base if item.name == name)


def _as_found(found: Candidate, name: str) -> FingerWiring:
    return next(item for item in found.true if item.name == name)


def _spec(rig: RigFile, name: str) -> FingerConfig:
    return next(item for item in rig.fingers if item.name == name)


def _places_in_words(found: Candidate) -> str:
    """How fingers stand at each other's places: by how many the ring is assigned round, or which ones."""
    bases = [item.base_mm for item in found.told]
    middle = [sum(base[k] for base in bases) / len(bases) for k in (0, 1)]
    angles = [math.atan2(base[1] - middle[1], base[0] - middle[0]) for base in bases]
    ring = sorted(range(len(bases)), key=angles.__getitem__)
    steps = {(ring.index(place) - ring.index(k)) % len(ring) for k, place in enumerate(found.places)}
    moved = found.moved_places
    if len(steps) == 1 and len(ring) > 2:
        (step,) = steps
        way = "counter-clockwise" if 2 * step <= len(ring) else "clockwise"
        places = quantity(min(step, len(ring) - step), "place", "places")
        return f"the ring is assigned {places} round: each finger stands {places} further {way}"
    if len(moved) > 2:
        return f"fingers {join_words(moved)} stand at each other's places"
    return f"fingers {join_words(moved)} stand at each other's places (a mirrored frame may look the same)"


def _mounting_in_words(found: Candidate, name: str) -> str:
    told, true = _by_file(found, name), _as_found(found, name)
    turn = round(math.remainder(true.array_deg - told.array_deg, 360))
    mirrored, inverted = told.mirrored != true.mirrored, told.inverted != true.inverted
    parts = [f"is turned by {turn:+d}° about the tip"] if turn else []
    parts += (
        ["is upside down"] if mirrored and inverted else ["counts its columns mirrored"] if mirrored else []
    )
    parts += ["counts its rows from the top"] if inverted and not mirrored else []
    return " and ".join(parts)


def wiring_changes(
    rig: RigFile, found: Candidate, turns: Mapping[int, float], why: str
) -> Iterator[WiringChangeOut]:
    """Changes that make the rig file say what was found. `turns`: where servos stood, as the file counts."""
    mirrored = found.frame is not MeasuredFrame.RIGHT and found.with_joints
    for k, (told, true) in enumerate(zip(found.told, found.true, strict=True)):
        spec = rig.fingers[k]
        for path, value in _finger_changes(rig, spec, told, true, mirrored=mirrored):
            before = _value(spec, path)
            if before != value:
                key = f"fingers[{k}].{path}"
                yield WiringChangeOut(file_key=key, finger=spec.name, to=value, why=why, **{"from": before})
        if isinstance(spec, SlideFingerConfig) and told.signs[1] != true.signs[1] and true.ids[1] in turns:
            zero = spec.slide.range_mm[0] + _RETRACTED_MM + spec.slide.mm_per_turn * turns[true.ids[1]]
            yield WiringChangeOut(
                file_key=f"fingers[{k}].slide.zero_mm",
                finger=spec.name,
                to=round(zero, 1),
                why="as if the slide stood retracted then: measure it anew, or calibrate",
                **{"from": spec.slide.zero_mm},
            )
    yield from _frame_changes(rig, found.frame, why, turns_too=mirrored)


def _finger_changes(
    rig: RigFile, spec: FingerConfig, told: FingerWiring, true: FingerWiring, *, mirrored: bool
) -> Iterator[tuple[str, object]]:
    """Places in a finger's table and their values, also such as stay as they are.

    Angles and lengths that stay are left out: what is written is rounded.
    """
    if told.base_mm != true.base_mm:
        yield "base_mm", tuple(round(value, 6) for value in true.base_mm)
    if told.heading_deg != true.heading_deg:
        yield "heading_deg", round(true.heading_deg, 6)
    owner = next(item for item in rig.fingers if item.array.port == true.port)
    yield "array.port", true.port
    yield "array.baudrate_bps", owner.array.baudrate_bps
    if math.remainder(told.array_deg - true.array_deg, 360):
        yield "array.heading_deg", round(math.remainder(true.array_deg, 360), 6)
    if mounting(told)[1:] != mounting(true)[1:]:
        corner = f"{'upper' if true.inverted else 'lower'}-{'right' if true.mirrored else 'left'}"
        yield "array.first_texel", corner
    models = {servo.dxl_id: servo.model for servo in rig.servos}
    for joint, (table, servo) in enumerate(spec.servos.items()):
        yield f"{table}.dxl_id", true.ids[joint]
        yield f"{table}.model", models[true.ids[joint]]
        reversed_ = told.signs[joint] != true.signs[joint]
        if mirrored and table != "slide":
            lo, hi = _value(spec, f"{table}.range_deg")
            yield f"{table}.range_deg", (-hi + 0.0, -lo + 0.0)
            reversed_ = reversed_ != (table == "elbow")  # an elbow's range has its sign, too
        yield f"{table}.{servo.ratio_key}", servo.ratio * (-1 if reversed_ else 1)


def _frame_changes(
    rig: RigFile, frame: MeasuredFrame, why: str, *, turns_too: bool
) -> Iterator[WiringChangeOut]:
    """Changes of what stands in a mirrored frame besides fingers: the stage, obstacles."""
    if frame is MeasuredFrame.RIGHT:
        return
    across, up = frame.value

    def change(key: str, before: object, value: object) -> WiringChangeOut:
        return WiringChangeOut(file_key=key, to=value, why=why, **{"from": before})

    if rig.stage is not None:
        x, y = rig.stage.centre_mm
        yield change("stage.centre_mm", (x, y), (across * x + 0.0, up * y + 0.0))
        if turns_too:
            lo, hi = rig.stage.range_deg
            yield change("stage.gear_ratio", rig.stage.gear_ratio, -rig.stage.gear_ratio)
            yield change("stage.range_deg", (lo, hi), (-hi + 0.0, -lo + 0.0))
    for k, obstacle in enumerate(rig.obstacles):
        outline = [(across * x + 0.0, up * y + 0.0) for x, y in obstacle.outline_mm]
        yield change(f"obstacles[{k}].outline_mm", obstacle.outline_mm, outline[::-1])


def _value(spec: FingerConfig, path: str) -> Any:
    value: Any = spec
    for key in path.split("."):
        value = getattr(value, key)
    return value
