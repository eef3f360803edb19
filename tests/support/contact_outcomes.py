"""What the extractor made of the contacts of an emulated session, beside the truth.

For the sweep in the tests and for `benchmarks/bench_contacts.py`. Half ranges are in units of the array's own
limit: half a pitch, which is half a pitch over the radius as an angle.
"""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from contact_sweep import TARE_FRAMES, Session, Truth

from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, PatchFlag

QUANTITIES = ("normal", "centroid", "height", "force")
_RELEASE_FRAMES = 5  # of a contact at most: before its last frame it is touched, too


@dataclass(frozen=True)
class Outcome:
    """One contact. `patch` is None if it was missed; `outside` (one of QUANTITIES each) how far outside, in
    rad, mm or N, and `judged` those that the truth has a value for; `gain_spread`: the largest one."""

    seed: int
    index: int
    truth: Truth
    patch: ContactPatch | None
    judged: frozenset[str]
    outside: dict[str, float]
    normal_half: float
    centroid_half: float
    gain_spread: float


@dataclass(frozen=True)
class Processed:
    """A whole session through `process`. `false`: patches in frames in which nothing touched."""

    outcomes: list[Outcome]
    false: int
    quiet: int
    frames: int
    seconds: float


def frames_of(session: Session, indices: Iterable[int]) -> list[TactileFrame]:
    """Frames of a session as a driver gives them."""
    return [
        TactileFrame(int(i), float(session.time_s[i]), float(session.time_s[i]), session.counts[i])
        for i in indices
    ]


def tared(session: Session) -> ContactExtractor:
    """An extractor for the session's tip, tared."""
    extractor = ContactExtractor(session.description, session.calibration)
    extractor.tare(frames_of(session, range(TARE_FRAMES)))
    return extractor


def processed(session: Session, seed: int) -> Processed:
    """Every contact of a session by `process`, and the processor time that it took, templates included."""
    extractor = tared(session)
    begin = time.process_time()
    patches = extractor.process(session.counts[TARE_FRAMES:], session.time_s[TARE_FRAMES:])
    seconds = time.process_time() - begin
    quiet = np.ones(len(session.counts), dtype=bool)
    for last in session.touched:
        quiet[max(last - _RELEASE_FRAMES, 0) : last + 1] = False
    quiet = quiet[TARE_FRAMES:]
    outcomes = [
        outcome(session, seed, k, patches.patch(int(last) - TARE_FRAMES))
        for k, last in enumerate(session.touched)
    ]
    return Processed(outcomes, int((patches.touched & quiet).sum()), int(quiet.sum()), len(patches), seconds)


def extracted(session: Session, seed: int, which: Sequence[int]) -> list[Outcome]:
    """Contacts `which`, ascending, by `extract`, the frames before each having been followed."""
    extractor, at, found = tared(session), TARE_FRAMES, []
    for k in which:
        last = int(session.touched[k])
        extractor.follow(frames_of(session, range(at, last)))
        at = last
        found.append(outcome(session, seed, k, extractor.extract(frames_of(session, [last])[0])))
    return found


def outcome(session: Session, seed: int, index: int, patch: ContactPatch | None) -> Outcome:
    """One contact against its truth."""
    truth, spread = session.truths[index], float(np.max(session.calibration.gain_spread))
    if patch is None:
        return Outcome(seed, index, truth, None, frozenset(), {}, math.inf, math.inf, spread)
    cylinder = session.description.shape is Shape.CYLINDER
    limit = (session.description.columns[1] - session.description.columns[0]) / 2
    beyond = {
        "normal": min(_turn(patch.angle_rad - n) for n in truth.normals) - patch.angle_half_range_rad,
        "height": abs(patch.height_mm - truth.height_mm) - patch.height_bound_mm,
    }
    if cylinder:
        half = patch.centroid_bound_rad
        beyond["centroid"] = min(_turn(patch.centroid_rad - c) for c in truth.centroids) - half
    else:
        half = patch.position_bound_mm[0]
        beyond["centroid"] = abs(patch.position_mm[0] - truth.centroids[0]) - half
    # Two stretches of load may be one patch or two: then the truth is not one force.
    if len(truth.centroids) <= 2 and PatchFlag.SEVERAL_PATCHES not in patch.flags:
        beyond["force"] = abs(patch.force_n - truth.force_n) - patch.force_bound_n
    outside = {name: excess for name, excess in beyond.items() if not excess <= 1e-9}
    normal_half = patch.angle_half_range_rad / limit if cylinder else math.nan
    return Outcome(seed, index, truth, patch, frozenset(beyond), outside, normal_half, half / limit, spread)


def _turn(angle: float) -> float:
    """How far a turn is from none, rad."""
    return abs((angle + math.pi) % (2 * math.pi) - math.pi)
