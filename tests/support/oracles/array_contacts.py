"""Contacts whose place on an array is known."""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, PatchFlag, TipCalibration
from support.devices.array_tips import COLS, PITCH, RADIUS, ROWS

# ----------------------------------------------------------------------------------------------------
# Contacts whose truth is known: half-planes pressed into a round tip, the pressure as deep as the dent.
#
# An array of tests/support/devices/array_tips.py feels them.

CELL_STEPS = 27  # half a degree
# Ray directions: the middles of CELL_STEPS slices of each column, then on around the back of the tip.
SLICE = PITCH / CELL_STEPS
RAYS = -10 * PITCH + (np.arange(round(2 * math.pi / SLICE)) + 0.5) * SLICE


@dataclass(frozen=True)
class HalfPlane:
    """The points x with x . (cos angle, sin angle) >= distance: an edge met in direction `angle`."""

    angle: float
    distance: float


def entry(planes: list[HalfPlane]) -> np.ndarray:
    """Distance along RAYS at which the intersection of half-planes is entered; inf where it is missed."""
    near, far = np.zeros(RAYS.size), np.full(RAYS.size, np.inf)
    for plane in planes:
        c = np.cos(RAYS - plane.angle)
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = plane.distance / c
        near = np.where(c > 1e-9, np.maximum(near, hit), near)
        far = np.where(c < -1e-9, np.minimum(far, hit), far)
        if plane.distance > 0:
            far = np.where(c <= 1e-9, -1.0, far)
    return np.where(near < far, near, np.inf)


def tipped(angle: float, at: float, distance: float, turn: float) -> HalfPlane:
    """Face through the surface point in direction `at` at `distance`, its inward normal turned by `turn`."""
    return HalfPlane(angle + turn, distance * math.cos(at - angle - turn))


@dataclass(frozen=True)
class Truth:
    kind: str
    normals: tuple[float, ...]
    depth_mm: float
    force_n: float
    top_mm: float
    taxels_n: np.ndarray


def contact(rng: np.random.Generator, kind: str, middle: float, depth: float, force: float | None) -> Truth:
    """A contact at direction `middle` with penetration `depth` of the deepest edge."""
    c = RADIUS - depth
    normals = [middle]
    if kind == "flat":
        rho = entry([HalfPlane(middle, c)])
    elif kind == "vertex":
        turn = math.pi - math.radians(rng.uniform(30, 150))
        right = rng.uniform(0, turn)
        rho = entry([tipped(middle, middle, c, -(turn - right)), tipped(middle, middle, c, right)])
        # A face met in direction middle + right recedes on the side below, and the other way round.
    elif kind == "end":
        planes = [HalfPlane(middle, c)]
        for side in (1, -1)[: rng.integers(1, 3)]:
            at = rng.uniform(0, math.radians(30))
            drop = math.pi - math.radians(rng.uniform(30, 150))
            planes.append(tipped(middle, middle + side * at, c / math.cos(at), -side * drop))
        rho = entry(planes)
    else:
        # A "dell" is a notch so shallow that both its edges may dent the tip in one stretch.
        between = rng.uniform(60, 150) if kind == "notch" else rng.uniform(150, 178)
        other = middle + math.pi - math.radians(between)
        second = RADIUS - depth * rng.uniform(0.02, 1.0)
        normals.append(other)
        rho = np.minimum(entry([HalfPlane(middle, c)]), entry([HalfPlane(other, second)]))
    pressure = np.maximum(0.0, RADIUS - rho)
    cells = pressure[: COLS * CELL_STEPS].reshape(COLS, CELL_STEPS).sum(axis=1)
    if force is None:  # a foundation of constant modulus, as stiff as the linear one at half a millimetre
        flat = np.maximum(0.0, RADIUS - entry([HalfPlane(0.0, RADIUS - 0.5)])).sum()
        force = 1.5 * rng.uniform(0.8, 1.2) * float(pressure.sum()) / float(flat)
    top = rng.uniform(6.0, 12.0)
    bottom = np.arange(ROWS) * 2.0
    rows = np.clip(top - bottom, 0.0, 2.0)
    taxels = force * np.outer(rows / rows.sum(), cells / pressure.sum())
    return Truth(kind, tuple(normals), depth, force, top, taxels)


def draw(rng: np.random.Generator, kind: str) -> Truth:
    middle = rng.uniform(-math.radians(100), math.radians(100))
    if kind in ("notch", "dell"):
        middle = rng.uniform(-math.radians(110), math.radians(0))
    if rng.random() < 0.5:
        force = math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
        return contact(rng, kind, middle, force / (3.0 * rng.uniform(0.8, 1.2)), force)
    while True:
        truth = contact(rng, kind, middle, rng.uniform(0.08, 1.2), None)
        if 0.3 <= truth.force_n <= 3.0:
            return truth


# ----------------------------------------------------------------------------------------------------
# Emulated contacts of every kind on tips of every kind, with the truth beside them.
#
# For the bounds of the contact extractor. The pressure is that of an elastic foundation: as deep as the
# object
# reaches into the undeformed tip, worked out here on fine rays, not by the extractor's templates.

KINDS = {"flat": 0.45, "end": 0.2, "vertex": 0.2, "notch": 0.15}
RATE_HZ = 100.0
TARE_FRAMES = 32
CONTACT_N = 0.15
_RAY = math.radians(0.1)
SWEPT_RAYS = np.arange(-math.pi, math.pi, _RAY) + _RAY / 2


@dataclass(frozen=True)
class SweptTruth:
    """What is really so: nearest directions of the edges, centroids (rad or mm, mm) of the whole load and of
    each of its stretches, force on the array."""

    kind: str
    normals: tuple[float, ...]
    centroids: tuple[float, ...]
    height_mm: float
    force_n: float


@dataclass(frozen=True, eq=False)
class Session:
    """Frames of one tip, and the truth: at the last frame of each contact, and `gain` (rows, cols)."""

    description: Description
    calibration: TipCalibration
    counts: np.ndarray
    time_s: np.ndarray
    tare: slice
    touched: np.ndarray
    truths: list[SweptTruth]
    gain: np.ndarray


def describe(
    shape: Shape, rows: int, cols: int, pitch: float, row_pitch_mm: float, **other: float
) -> Description:
    """An array of these taxels, its columns `pitch` (rad or mm) apart about the middle."""
    return Description(
        unique_id=b"sweep, any array",
        firmware="sweep",
        emulated=True,
        shape=shape,
        rows=rows,
        cols=cols,
        bit_depth=12,
        max_rate_hz=500.0,
        full_scale_n=4095 / other["counts_per_n"],
        counts_per_n=other["counts_per_n"],
        tip_radius_mm=other.get("radius_mm", 0.0),
        columns=tuple((j - (cols - 1) / 2) * pitch for j in range(cols)),
        row_heights_mm=tuple((i + 0.5) * row_pitch_mm for i in range(rows)),
    )


def _inside(planes: list[tuple[float, float]]) -> np.ndarray:
    """Distance along RAYS at which the intersection of half-planes x·n(angle) >= distance is entered."""
    near, far = np.zeros(SWEPT_RAYS.size), np.full(SWEPT_RAYS.size, np.inf)
    for angle, distance in planes:
        c = np.cos(SWEPT_RAYS - angle)
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = distance / c
        near = np.where(c > 1e-9, np.maximum(near, hit), near)
        far = np.where(c < -1e-9, np.minimum(far, hit), far)
        if distance > 0:
            far = np.where(c <= 1e-9, -1.0, far)
    return np.where(near < far, near, np.inf)


def _face(at: float, distance: float, angle: float) -> tuple[float, float]:
    """The half-plane with inward normal at `angle` through the point at `distance` in direction `at`."""
    return angle, distance * math.cos(at - angle)


def dents(
    rng: np.random.Generator, kind: str, radius: float, middle: float, depth: float
) -> tuple[np.ndarray, list]:
    """Depth of the dent along RAYS, and the nearest directions."""
    c = radius - depth
    if kind == "flat":
        return np.maximum(0.0, radius - _inside([(middle, c)])), [middle]
    if kind == "vertex":
        turn = math.pi - math.radians(rng.uniform(30, 150))
        part = rng.uniform(0, turn)
        rho = _inside([_face(middle, c, middle - (turn - part)), _face(middle, c, middle + part)])
        return np.maximum(0.0, radius - rho), [middle]
    if kind == "end":
        planes = [(middle, c)]
        for side in (1, -1)[: rng.integers(1, 3)]:
            at = rng.uniform(0, math.radians(30))
            drop = math.pi - math.radians(rng.uniform(30, 150))
            planes.append(_face(middle + side * at, c / math.cos(at), middle + side * (at - drop - at)))
        return np.maximum(0.0, radius - _inside(planes)), [middle]
    other = middle + rng.choice((-1, 1)) * math.radians(rng.uniform(5, 110))
    second = radius - depth * rng.uniform(0.05, 1.0)
    rho = np.minimum(_inside([(middle, c)]), _inside([(other, second)]))
    return np.maximum(0.0, radius - rho), [middle, other]


def _stretches(dent: np.ndarray) -> list[float]:
    """Centroid of all dents and of each run of them, rad."""
    # Begun where there is no dent, so that no stretch runs over the end.
    begin = int(np.flatnonzero(dent == 0)[0])
    rays = np.concatenate([SWEPT_RAYS[begin:], SWEPT_RAYS[:begin] + 2 * math.pi])
    dent = np.roll(dent, -begin)
    label = np.cumsum((dent > 0) & (np.roll(dent, 1) == 0)) * (dent > 0)
    runs = [label > 0, *(label == number for number in range(1, int(label.max()) + 1))]
    found = [float(dent[run] @ rays[run] / dent[run].sum()) for run in runs]
    return [(angle + math.pi) % (2 * math.pi) - math.pi for angle in found]


def cylinder_session(seed: int, contacts: int, **fixed: float) -> Session:
    """A session of one cylindrical tip drawn from `seed`; `fixed` sets what shall not be drawn."""
    rng = np.random.default_rng([1983, seed])

    def pick(name: str, value: float) -> float:
        return fixed.get(name, value)

    radius = pick("radius_mm", rng.uniform(3, 15))
    rows, cols = int(pick("rows", rng.integers(4, 13))), int(pick("cols", rng.integers(8, 25)))
    pitch = math.radians(pick("coverage_deg", rng.uniform(120, 300))) / cols
    row_pitch = rng.uniform(1.0, 3.0)
    per_n = rng.uniform(1000, 4000)
    noise, spread = rng.uniform(0.5, 5.0), pick("gain_spread", rng.uniform(0.0, 0.3))
    stiffness, drift = rng.uniform(1.5, 6.0), pick("drift", rng.uniform(0, 2.0))
    description = describe(Shape.CYLINDER, rows, cols, pitch, row_pitch, counts_per_n=per_n, radius_mm=radius)
    places = rng.choice(rows * cols, int(pick("dead", rng.integers(0, 5))), replace=False)
    dead = [divmod(int(p), cols) for p in places]
    taxels = Taxels(
        description,
        seed=seed,
        noise_counts=noise,
        gain_spread=spread,
        offset_counts=250,  # so that no zero wanders below 0, where it would not show
        crosstalk=rng.uniform(0.05, 0.10),
        drift_counts_per_s=drift,
        dead=dead,
    )
    calibration = TipCalibration(
        gain=np.ones((rows, cols)),
        gain_spread=spread,
        noise_counts=noise,
        contact_force_n=CONTACT_N,
        stiffness_n_per_mm=stiffness,
        stiffness_bound=0.2,
        drift_counts_per_s=drift,
    )
    half = cols * pitch / 2
    slots = np.floor((SWEPT_RAYS + half) / pitch).astype(int)
    on = (slots >= 0) & (slots < cols)
    loads, truths = [], []
    while len(truths) < contacts:
        kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
        reach = min(half, math.radians(115))
        middle = rng.uniform(-reach, reach)
        force = math.exp(rng.uniform(math.log(0.3), math.log(5.0)))
        depth = force / (stiffness * rng.uniform(0.8, 1.2))
        if not 0.003 * radius < depth < 0.27 * radius:
            continue
        dent, normals = dents(rng, kind, radius, middle, depth)
        share = dent / dent.sum()
        columns = np.bincount(slots[on], share[on], minlength=cols) * force
        bearing = int(rng.integers(2, rows + 1))
        if columns.sum() < 2 * CONTACT_N or columns.max() / bearing > 0.5 * description.full_scale_n:
            continue
        loads.append(np.outer(np.arange(rows) < bearing, columns) / bearing)
        height = bearing * row_pitch / 2
        truths.append(SweptTruth(kind, tuple(normals), tuple(_stretches(dent)), height, float(columns.sum())))
    return _session(rng, description, calibration, taxels, loads, truths)


def pad_session(seed: int, contacts: int, **fixed: float) -> Session:
    """A session of one flat pad: round and square-edged blobs of load, anywhere on it."""
    rng = np.random.default_rng([705, seed])
    rows, cols = int(fixed.get("rows", rng.integers(8, 21))), int(fixed.get("cols", rng.integers(8, 21)))
    pitch, row_pitch = rng.uniform(1.0, 4.0), rng.uniform(1.0, 4.0)
    noise, spread = rng.uniform(0.5, 5.0), fixed.get("gain_spread", rng.uniform(0.0, 0.3))
    drift = fixed.get("drift", rng.uniform(0, 2.0))
    description = describe(Shape.FLAT, rows, cols, pitch, row_pitch, counts_per_n=rng.uniform(1000, 4000))
    places = rng.choice(rows * cols, int(fixed.get("dead", rng.integers(0, 4))), replace=False)
    taxels = Taxels(
        description,
        seed=seed,
        noise_counts=noise,
        gain_spread=spread,
        offset_counts=250,  # so that no zero wanders below 0, where it would not show
        crosstalk=rng.uniform(0.05, 0.10),
        drift_counts_per_s=drift,
        dead=[divmod(int(p), cols) for p in places],
    )
    calibration = TipCalibration(
        gain=np.ones((rows, cols)),
        gain_spread=spread,
        noise_counts=noise,
        contact_force_n=CONTACT_N,
        drift_counts_per_s=drift,
    )
    fine, beyond = 8, 4
    x = ((np.arange((cols + 2 * beyond) * fine) + 0.5) / fine - beyond - cols / 2) * pitch
    z = ((np.arange((rows + 2 * beyond) * fine) + 0.5) / fine - beyond) * row_pitch
    loads, truths = [], []
    while len(truths) < contacts:
        cx, cz = rng.uniform(-cols / 2, cols / 2) * pitch, rng.uniform(0, rows) * row_pitch
        a, b = rng.uniform(0.15, 1.5) * pitch, rng.uniform(0.15, 1.5) * row_pitch
        turn, force = rng.uniform(0, math.pi), math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
        u = (x[None, :] - cx) * math.cos(turn) + (z[:, None] - cz) * math.sin(turn)
        v = (z[:, None] - cz) * math.cos(turn) - (x[None, :] - cx) * math.sin(turn)
        kind = str(rng.choice(["ball", "punch", "edge"]))
        inside = np.maximum(0.0, 1 - (u / a) ** 2 - (v / b) ** 2)
        if kind == "punch":
            inside = ((np.abs(u) < a) & (np.abs(v) < b)).astype(float)
        elif kind == "edge":  # pressed in slanting: more load on one side
            inside = inside * (1.2 + np.clip(u / a, -1, 1))
        if inside.sum() == 0:
            continue
        inside *= force / inside.sum()
        cells = inside.reshape(rows + 2 * beyond, fine, cols + 2 * beyond, fine).sum(axis=(1, 3))
        cells = cells[beyond:-beyond, beyond:-beyond]
        if cells.sum() < 2 * CONTACT_N or cells.max() > 0.5 * description.full_scale_n:
            continue
        loads.append(cells)
        at = (float(inside.sum(axis=0) @ x) / force, float(inside.sum(axis=1) @ z) / force)
        truths.append(SweptTruth(kind, (-math.pi / 2,), at[:1], at[1], float(cells.sum())))
    return _session(rng, description, calibration, taxels, loads, truths)


def _session(
    rng: np.random.Generator,
    description: Description,
    calibration: TipCalibration,
    taxels: Taxels,
    loads: list[np.ndarray],
    truths: list[SweptTruth],
) -> Session:
    """Untouched for a while, touched for a moment, and again."""
    quiet = rng.integers(15, 60, len(loads))
    held = rng.integers(1, 6, len(loads))
    last = TARE_FRAMES + np.cumsum(quiet + held) - 1
    force = np.zeros((int(last[-1]) + 1, description.rows, description.cols))
    for load, end, frames in zip(loads, last, held, strict=True):
        force[end - frames + 1 : end + 1] = load
    time_s = rng.uniform(0, 100) + np.arange(len(force)) / RATE_HZ
    return Session(
        description,
        calibration,
        taxels.counts(force, time_s),
        time_s,
        slice(0, TARE_FRAMES),
        last,
        truths,
        taxels.gain,
    )


def calibrated(session: Session, seed: int, within: np.ndarray, bound: float) -> Session:
    """The session with gains known to `bound` for taxels `within` (rows, cols); of the others as before."""
    error = bound * np.random.default_rng([3000, seed]).uniform(-1, 1, within.shape)
    before = session.calibration
    gains = replace(
        before,
        gain=np.where(within, session.gain / (1 + error), before.gain),
        gain_spread=np.where(within, bound, before.gain_spread),
    )
    return replace(session, calibration=gains)


def pressed_session(seed: int, contacts: int, **fixed: float) -> Session:
    """A cylinder whose gains are within ± 40 %, known to ± 3 % within 75° of its middle."""
    session = cylinder_session(seed, contacts, **({"gain_spread": 0.4} | fixed))
    middle = np.abs(session.description.columns) <= math.radians(75)
    return calibrated(session, seed, np.broadcast_to(middle, session.gain.shape), 0.03)


# ----------------------------------------------------------------------------------------------------
# What the extractor made of the contacts of an emulated session, beside the truth.
#
# For the sweep in the tests and for `benchmarks/bench_contacts.py`. Half ranges are in units of the array's
# own
# limit: half a pitch, which is half a pitch over the radius as an angle.

QUANTITIES = ("normal", "centroid", "height", "force")
_RELEASE_FRAMES = 5  # of a contact at most: before its last frame it is touched, too


@dataclass(frozen=True)
class Outcome:
    """One contact. `patch` is None if it was missed; `outside` (one of QUANTITIES each) how far outside, in
    rad, mm or N, and `judged` those that the truth has a value for; `gain_spread`: the largest one."""

    seed: int
    index: int
    truth: SweptTruth
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
