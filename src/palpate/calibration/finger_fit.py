"""Bundle adjustment of all fingers in one frame, from touches of references in unknown poses.

Every touch gives one equation: the tip's centre is as far from the reference's surface as the tip's radius
less its dent. The estimate is the most probable one under the rig file's bounds as wide priors, found by
robust least squares (Huber's and Cauchy's losses; Triggs et al., Bundle Adjustment, 2000, sections 4 and 9
for outliers and free networks).

The force of a touch bends what carries the tip and may push its aim. A contact at the bearing b from the
direction of travel pushes the tip with N along its normal, sideways with N sin b less what friction takes
off. It slips at friction times N; where it sticks, a third is left or more, as the skin is softer along the
surface.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import rotation_matrix, wrap_angle
from palpate.calibration.finger_model import RADIUS, FingerModel
from palpate.calibration.measurements import Reference, TouchMeasurement
from palpate.calibration.rig_models import nominal_model
from palpate.config import FingerConfig

_OUTLIER_SIGMAS = 4.5  # standard deviations
_PLATE_STARTS = 12  # orientations from which a plate's is looked for
_MAX_OUTLIER_ROUNDS = 6
_MAX_EVALUATIONS = 1000  # right fits take 100 at most; more go on along a valley of a wrong one


@dataclass(frozen=True, eq=False)
class ReferencePlacement:
    """A reference as it lay: about where, in W."""

    reference: Reference
    about_mm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class TouchArrays:
    """n touches as arrays: whose, of which placing, servo angles and ways (n, 2), dent (mm) and noise.

    `ways`: from which side of their play joints came (`FingerModel`). `sigma_mm` (n,): what a touch's
    distance is expected to be off by. `used` (n,): those that are fitted.
    """

    finger: Ints
    placing: Ints
    servos_rad: Floats
    ways: Floats
    dent_mm: Floats
    sigma_mm: Floats
    used: Bools

    def with_used(self, used: Bools) -> "TouchArrays":
        """The same, with others fitted."""
        return replace(self, used=used)


@dataclass(frozen=True, eq=False)
class FingerFit:
    """Values (fingers, k) and poses (placings, 3: x, y, θ) that explain touches best.

    `covariance` is that of all fingers' values in their order, then all poses, if noise is as declared.
    `residual_mm` (n,): how much further than the tip's radius each touch was from the surface; `normal`
    (n, 2): the surface's outward normal there, in W; `room_mm` (n,): from there to the face's end;
    `centre_mm` (n, 2): the tips'. `outlier` (n,): touches that were left out. `chi_square` of the fitted
    ones, with `freedom` degrees.
    """

    values: Floats
    poses: Floats
    covariance: Floats
    residual_mm: Floats
    normal: Floats
    room_mm: Floats
    centre_mm: Floats
    outlier: Bools
    chi_square: float
    freedom: int


def fit_fingers(
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touches: TouchArrays,
    start: tuple[Floats, Floats] | None = None,
) -> FingerFit:
    """Fit everything at once; `start`: values and poses to begin with, poses of the first placings at least.

    Touches that are more than 4.5 standard deviations off are left out and marked, one placing after the
    other as long as half of it stays.
    """
    problem = _Problem(models, placings, touches)
    values = np.array([model.prior for model in models]) if start is None else start[0]
    poses = _first_poses(problem, values, np.empty((0, 3)) if start is None else start[1])
    outlier = np.zeros(len(touches.finger), dtype=bool)
    x = problem.packed(values, poses)
    x = problem.solved(x, touches.used, robust=True)
    for _ in range(_MAX_OUTLIER_ROUNDS):
        used = touches.used & ~outlier
        x = problem.solved(x, used, robust=False)
        off = np.abs(problem.residuals(x)[0]) / problem.deviation(x, used)
        found = touches.used & (off > _OUTLIER_SIGMAS)
        if (found == outlier).all():
            break
        outlier = found
    return problem.result(x, touches.used & ~outlier, outlier)


def predict_residuals(
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touches: TouchArrays,
    values: Floats,
    poses: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Residuals (n,) mm, normals (n, 2), room (n,) mm and derivatives (n, k · fingers + 3 · placings)."""
    problem = _Problem(models, placings, touches)
    return problem.derived(problem.packed(values, poses))


class _Problem:
    """Residuals of touches and priors, and their derivatives, for one vector of all unknowns."""

    def __init__(
        self, models: Sequence[FingerModel], placings: Sequence[ReferencePlacement], touches: TouchArrays
    ) -> None:
        self.placings, self.touches = placings, touches
        self._models = models
        self._count, self._columns = len(models), len(models[0].prior)
        self._prior = np.array([model.prior for model in models])
        self._whitening = [np.linalg.inv(np.linalg.cholesky(model.covariance)) for model in models]

    def packed(self, values: Floats, poses: Floats) -> Floats:
        """All unknowns in one vector."""
        return np.concatenate([values.ravel(), poses.ravel()])

    def split(self, x: Floats) -> tuple[Floats, Floats]:
        """Values (fingers, k) and poses (placings, 3) again."""
        cut = self._count * self._columns
        return x[:cut].reshape(-1, self._columns), x[cut:].reshape(-1, 3)

    def centres(self, values: Floats) -> Floats:
        """Tip centres (n, 2)."""
        t = self.touches
        result = np.empty((len(t.finger), 2))
        for number, model in enumerate(self._models):
            mine = t.finger == number
            result[mine] = model.centres(values[t.finger[mine]], t.servos_rad[mine], t.ways[mine])
        return result

    def residuals(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Residuals (n,), normals (n, 2) in W, room (n,), centres (n, 2)."""
        values, poses = self.split(x)
        t = self.touches
        centre = self.centres(values)
        distance, room = np.zeros(len(centre)), np.zeros(len(centre))
        normal = np.zeros_like(centre)
        for number, placing in enumerate(self.placings):
            mine = t.placing == number
            turn = rotation_matrix(poses[number, 2])
            found = placing.reference.distance_mm((centre[mine] - poses[number, :2]) @ turn)
            distance[mine], normal[mine], room[mine] = found[0], found[1] @ turn.T, found[2]
        residual = distance - values[t.finger, RADIUS] + t.dent_mm
        return residual, normal, room, centre

    def derived(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Residuals, normals, room, and the derivatives of residuals (n, unknowns)."""
        values, poses = self.split(x)
        t = self.touches
        residual, normal, room, centre = self.residuals(x)
        result = np.zeros((len(residual), len(x)))
        for number, model in enumerate(self._models):
            mine = np.flatnonzero(t.finger == number)
            moved = model.slopes(values[t.finger[mine]], t.servos_rad[mine], t.ways[mine])
            own = slice(number * self._columns, (number + 1) * self._columns)
            result[mine, own] = np.einsum("ni,nik->nk", normal[mine], moved)
            result[mine, own.start + RADIUS] = -1.0
        rows = np.arange(len(residual))
        at = self._count * self._columns + 3 * t.placing
        rel = centre - poses[t.placing, :2]
        turning = np.array([float(p.reference.turns) for p in self.placings])[t.placing]
        result[rows, at], result[rows, at + 1] = -normal[:, 0], -normal[:, 1]
        result[rows, at + 2] = turning * (normal[:, 0] * rel[:, 1] - normal[:, 1] * rel[:, 0])
        return residual, normal, room, result

    def solved(self, x: Floats, used: Bools, *, robust: bool) -> Floats:
        """Unknowns that fit the used touches and the priors best, from `x` on."""
        found = _least_squares(
            lambda u: self._whitened_residuals(u, used),
            x,
            loss="cauchy" if robust else "linear",
            f_scale=3.0 if robust else 1.0,
            max_nfev=_MAX_EVALUATIONS,
            x_scale="jac",
        )
        result: Floats = found.x
        return result

    def _whitened_residuals(self, x: Floats, used: Bools) -> tuple[Floats, Floats]:
        values, poses = self.split(x)
        residual, _, _, slope = self.derived(x)
        weight = 1 / self.touches.sigma_mm[used]
        prior = np.concatenate(
            [root @ off for root, off in zip(self._whitening, values - self._prior, strict=True)]
        )
        own = np.zeros((len(prior), len(x)))
        for k, root in enumerate(self._whitening):
            at = slice(k * self._columns, (k + 1) * self._columns)
            own[at, at] = root
        # A disc's orientation cannot be measured: its own prior keeps it where it is.
        rest = np.array([0.0 if p.reference.turns else 1.0 for p in self.placings])
        still = np.zeros((len(poses), len(x)))
        still[np.arange(len(poses)), len(prior) + 3 * np.arange(len(poses)) + 2] = rest
        return (
            np.concatenate([residual[used] * weight, prior, rest * poses[:, 2]]),
            np.vstack([slope[used] * weight[:, None], own, still]),
        )

    def deviation(self, x: Floats, used: Bools) -> Floats:
        """Expected deviation (n,) of residuals: as declared, or as the used touches show if larger."""
        share = np.abs(self.residuals(x)[0][used]) / self.touches.sigma_mm[used]
        factor = max(1.0, 1.4826 * float(np.median(share))) if used.any() else 1.0
        result: Floats = self.touches.sigma_mm * factor
        return result

    def result(self, x: Floats, used: Bools, outlier: Bools) -> FingerFit:
        """Fit that has been found."""
        values, poses = self.split(x)
        slope = self._whitened_residuals(x, used)[1]
        covariance = np.asarray(np.linalg.pinv(slope.T @ slope, hermitian=True), dtype=np.float64)
        residual, normal, room, centre = self.residuals(x)
        square = float(((residual[used] / self.touches.sigma_mm[used]) ** 2).sum())
        # Fitted touches less the unknowns that they, not the priors, have determined.
        touched = slope[: int(used.sum())]
        bound = float(np.trace(touched @ covariance @ touched.T))
        return FingerFit(
            values,
            poses,
            covariance,
            residual,
            normal,
            room,
            centre,
            outlier,
            square,
            max(int(used.sum()) - math.ceil(bound), 1),
        )


def _least_squares(both: Callable[[Floats], tuple[Floats, Floats]], x: Floats, **options: Any) -> Any:
    """Least squares from `x` on of residuals, which `both` gives together with their derivatives."""
    from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

    @lru_cache(maxsize=1)
    def at(point: bytes) -> tuple[Floats, Floats]:
        return both(np.frombuffer(point))

    def off(u: Floats) -> Floats:
        return at(u.tobytes())[0].copy()  # scipy scales both in place

    def slope(u: Floats) -> Floats:
        return at(u.tobytes())[1].copy()

    return least_squares(off, x, jac=slope, **options)


def _first_poses(problem: _Problem, values: Floats, known: Floats) -> Floats:
    """Poses of all placings: those that are known, and the best of several starts for the others."""
    poses = np.zeros((len(problem.placings), 3))
    poses[: len(known)] = known
    for number in range(len(known), len(poses)):
        poses[number] = _fit_pose(problem, values, number)
    return poses


def _fit_pose(problem: _Problem, values: Floats, number: int) -> Floats:
    """The pose of one placing that suits its touches best, the fingers being where `values` says."""
    placing, touches = problem.placings[number], problem.touches
    mine = touches.used & (touches.placing == number)
    centre = problem.centres(values)[mine]
    wanted = values[touches.finger[mine], RADIUS] - touches.dent_mm[mine]
    sigma = touches.sigma_mm[mine]

    def both(pose: Floats) -> tuple[Floats, Floats]:
        turn, rel = rotation_matrix(float(pose[2])), centre - pose[:2]
        distance, inside, _ = placing.reference.distance_mm(rel @ turn)
        normal = inside @ turn.T
        turning = normal[:, 0] * rel[:, 1] - normal[:, 1] * rel[:, 0]
        return (distance - wanted) / sigma, np.column_stack([-normal, turning]) / sigma[:, None]

    count = _PLATE_STARTS if placing.reference.turns else 1
    turns = 2 * math.pi / placing.reference.repeats / count * np.arange(count)
    found = [
        _least_squares(both, np.array([*placing.about_mm, turn]), loss="soft_l1", x_scale=[1.0, 1.0, 0.02])
        for turn in turns
    ]
    best: Floats = min(found, key=lambda item: float(item.cost)).x
    return best


_MIN_SHEAR_STIFFNESS_SHARE = 2 / 3  # of the skin's stiffnesses along and across a surface, at least


@dataclass(frozen=True, eq=False)
class TouchLoads:
    """Loads of n touches, all (n,).

    `side`: +1 for a contact to the left of the way, -1 to the right: the tip is pushed to the other side.
    `give_mm` ± `give_sigma_mm`: how far the tip has given way along the normal; all of a finger's are wrong
    alike. `sheared_rad` ± `sheared_sigma_rad`: how much nearer to the way the contact was felt than it was.
    `towards_rad`: direction of the contact, from where the finger faces. `pushes` (n, 2): whether the force
    may have pushed a joint through its play.
    """

    side: Floats
    give_mm: Floats
    give_sigma_mm: Floats
    sheared_rad: Floats
    sheared_sigma_rad: Floats
    towards_rad: Floats
    pushes: Bools


def touch_loads(touched: Sequence[TouchMeasurement], specs: Sequence[FingerConfig]) -> TouchLoads:
    """Loads of touches by the rig file's bounds, taken for uniform; arrays' headings may be ill known."""
    by_name = {spec.name: spec for spec in specs}
    own = [by_name[item.finger] for item in touched]
    towards = np.array(
        [
            item.angle_rad + math.radians(spec.array.heading_deg)
            for item, spec in zip(touched, own, strict=True)
        ]
    )
    bearing = np.array([item.facing_rad for item in touched]) + towards
    bearing = np.where(np.abs(bearing) > math.pi, wrap_angle(bearing), bearing)
    force = np.array([item.force_n for item in touched])
    deflection = np.array([spec.bounds.deflection_mm_per_n for spec in own])
    friction = np.array([spec.tip.max_friction for spec in own])
    radius = np.array([spec.tip.radius_mm for spec in own])
    dent = force / np.array([spec.tip.stiffness_n_per_mm for spec in own])
    side, sine = np.sign(bearing), np.abs(np.sin(bearing))
    # A slide gives way across its travel; an arm, whose joints both turn, in any direction.
    kinds = {spec.name: nominal_model(spec) for spec in specs}
    models = [kinds[item.finger] for item in touched]
    arms = np.array([model.gives_all_round for model in models], dtype=bool)
    give = deflection * force * np.where(arms, 1.0, sine**2)
    # Compliance from 0 to what is declared, and of the sideways push from the least that friction leaves.
    tangent = np.tan(np.minimum(np.abs(bearing), 1.5))
    least = np.maximum(1 - _MIN_SHEAR_STIFFNESS_SHARE, 1 - friction / np.maximum(tangent, 1e-9))
    least = np.where(arms, 1.0, least)
    mean = (1 + least) / 4
    sigma = np.sqrt((1 + least + least**2) / 9 - mean**2)
    # It slips at friction times the force; skin is sheared no further than the tip has gone along the face.
    sheared = np.minimum(friction / _MIN_SHEAR_STIFFNESS_SHARE, tangent) * dent / radius
    return TouchLoads(
        side=side,
        give_mm=give * mean,
        give_sigma_mm=give * sigma,
        sheared_rad=sheared / 2,
        sheared_sigma_rad=sheared / math.sqrt(12),
        towards_rad=towards,
        pushes=np.array([model.pushable for model in models]),
    )
