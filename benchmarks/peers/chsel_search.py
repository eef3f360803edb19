"""CHSEL: poses from contacts and free space by gradient descent and quality diversity (Zhong, RSS 2023).

Optimised over SE(2), as it documents for parts on a table, with its own defaults: 30 transforms, one
iteration. Tips' centres are points of known signed distance (the tip's radius), the last 30 mm of their ways
are free. It has no place for normals, nor for a bound of an error: what it finds is therefore refined by
least squares (`scipy_restarts`) with both, and accepted if it satisfies the touches. Needs PyTorch.
"""

from collections.abc import Sequence

import chsel
import numpy as np
import pytorch_kinematics as pk
import pytorch_volumetric as pv
import torch
from outline import Outline, distinct
from question import Answer, Model, Peer, Solve, Touch
from scipy_restarts import descended

MM = 1e-3  # CHSEL's defaults are for metres
TRANSFORMS, ITERATIONS = 30, 1
GRID_MM, MARGIN_MM, HALF_HEIGHT_MM = 0.5, 60.0, 10.0
FREE_MM = np.arange(4.0, 34.0, 2.0)


class PlateSDF(pv.ObjectFrameSDF):
    """Signed distance of an upright prism, from a table of its outline's (bilinear, 0.5 mm)."""

    def __init__(self, outline: Outline) -> None:
        self.low = outline.points.min(0) - MARGIN_MM
        self.high = outline.points.max(0) + MARGIN_MM
        x, y = (np.arange(a, b, GRID_MM) for a, b in zip(self.low, self.high, strict=True))
        self.high = np.array([x[-1], y[-1]])
        points = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        touch = Touch((0.0, 0.0), (0.0, 0.0), 0.0, 1.0, (0.0, 1.0))
        poses = np.column_stack([-points, np.zeros(len(points))])
        gaps = np.concatenate([outline.gaps(touch, part)[0] for part in np.array_split(poses, 50)])
        self.table = torch.tensor(gaps.reshape(len(y), len(x)) * MM, dtype=torch.float)[None, None]
        self.box = np.column_stack([outline.points.min(0), outline.points.max(0)])

    def __call__(self, points: torch.Tensor, compute_grad: bool = True) -> tuple:
        with torch.enable_grad():
            at = points.detach()[..., :2].clone().requires_grad_(compute_grad)
            low, high = (torch.tensor(side * MM, dtype=torch.float) for side in (self.low, self.high))
            place = (2 * (at - low) / (high - low) - 1).reshape(1, 1, -1, 2)
            found = torch.nn.functional.grid_sample(
                self.table, place, align_corners=True, padding_mode="border"
            ).reshape(points.shape[:-1])
            if not compute_grad:
                return found.detach(), None
            slope = torch.autograd.grad(found.sum(), at)[0]
        return found.detach(), torch.cat([slope, torch.zeros_like(slope[..., :1])], -1)

    def surface_bounding_box(self, padding: float = 0.0, padding_ratio: float = 0.0) -> torch.Tensor:
        box = np.vstack([self.box, [[-HALF_HEIGHT_MM, HALF_HEIGHT_MM]]]) * MM
        extra = padding + padding_ratio * (box[:, 1] - box[:, 0])
        box = box + np.column_stack([-np.ones(3), np.ones(3)]) * np.reshape(extra, (-1, 1))
        return torch.tensor(box, dtype=torch.float)


def prepare(models: Sequence[Model]) -> Solve:
    torch.set_num_threads(1)
    outlines = [Outline.of(model) for model in models]
    tables = [PlateSDF(outline) for outline in outlines]

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        torch.manual_seed(0)
        np.random.seed(0)  # noqa: NPY002 (CHSEL's own choice of random numbers)
        found: list[Answer] = []
        for outline, table in zip(outlines, tables, strict=True):
            ends = np.array([descended(outline, touches, pose) for pose in registered(table, touches)])
            found += distinct(outline.name, ends[outline.satisfied(touches, ends)])
        return found

    return solve


def registered(table: PlateSDF, touches: Sequence[Touch]) -> np.ndarray:
    """Poses (m, 3) that CHSEL ends with."""
    centres, free = [], []
    for touch in touches:
        back = np.array(touch.start_mm) - touch.centre
        back /= np.hypot(*back)
        centres.append([*touch.centre, 0.0])
        free += [[*(touch.centre + away * back), 0.0] for away in FREE_MM]
    positions = torch.tensor(np.array(centres + free) * MM, dtype=torch.float)
    kinds = torch.tensor(
        [chsel.SemanticsClass.SURFACE.value] * len(centres) + [chsel.SemanticsClass.FREE.value] * len(free)
    )
    registration = chsel.CHSEL(
        table,
        positions=positions,
        semantics=kinds,
        known_sdf_values=torch.tensor([touch.radius_mm * MM for touch in touches]),
        axis_of_rotation=torch.tensor([0.0, 0.0, 1.0]),
        resolution=0.003,
    )
    turn = torch.rand(TRANSFORMS) * 2 * np.pi
    start = torch.eye(4).repeat(TRANSFORMS, 1, 1)
    start[:, :3, :3] = pk.axis_and_angle_to_matrix_33(torch.tensor([0.0, 0.0, 1.0]), turn)
    middle = positions[: len(centres)].mean(0)
    start[:, :3, 3] = -(start[:, :3, :3] @ middle)
    result, _ = registration.register(iterations=ITERATIONS, batch=TRANSFORMS, initial_tsf=start)
    placed = chsel.solution_to_world_to_link_matrix(result).inverse().detach().double().numpy()
    theta = np.arctan2(placed[:, 1, 0], placed[:, 0, 0])
    return np.column_stack([placed[:, 0, 3] / MM, placed[:, 1, 3] / MM, theta])


PEER = Peer(prepare, ("chsel", "torch", "scipy"))
