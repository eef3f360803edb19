"""A block on a block, on MuJoCo's table, pushed by springs that act as fingers do: by how much does it lean?

The mechanics are MuJoCo's: contact of boxes and a plane, an elliptic friction cone, inertia of the solids.
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from palpate.base.geometry import Polygon, Section, State

_MM = 1e-3
_STEP_S = 0.25e-3
_STIFFNESS_N_MM, _SHEAR_SHARE = 3.6, 0.7
_LONGEST_S, _FALLEN_RAD = 1.5, 0.3
_MOST_N = 2.8  # a finger stops by then
_MODEL = """
<mujoco>
  <option timestep="{step}" cone="elliptic" impratio="100" noslip_iterations="4" integrator="implicitfast"/>
  <default><geom friction="{friction} 0 0" condim="3" solref="0.004 1" density="{density}"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="part"><freejoint/>{boxes}</body>
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class Block:
    """An upright box: centre (x, y), size (x, y) and heights from, to; mm."""

    centre: tuple[float, float]
    size: tuple[float, float]
    z: tuple[float, float]

    @property
    def volume_mm3(self) -> float:
        return self.size[0] * self.size[1] * (self.z[1] - self.z[0])

    @property
    def polygon(self) -> Polygon:
        (x, y), (a, b) = self.centre, self.size
        corners = [(x + s * a / 2, y + t * b / 2) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        return Polygon(np.array(corners))


@dataclass(frozen=True)
class Push:
    """A finger against the side of a block: across `axis` 0 or 1, on the side of `sign`.

    `aside` mm of its middle. `friction` of the tip; it begins `delay_s` after the first one.
    """

    axis: int
    sign: int
    aside: float
    height: float
    friction: float
    speed: float
    delay_s: float


def state_of(blocks: tuple[Block, ...]) -> State:
    """The blocks as sections."""
    return State("standing", tuple(Section(block.z, (block.polygon,)) for block in blocks))


def worst_lean_rad(blocks: tuple[Block, ...], mass_kg: float, friction: float, pushes: list[Push]) -> float:
    """Largest lean while fingers run into the part, go on for 2 mm at most, and go back."""
    model = mujoco.MjModel.from_xml_string(
        _MODEL.format(
            step=_STEP_S,
            friction=friction,
            density=mass_kg / (sum(block.volume_mm3 for block in blocks) * _MM**3),
            boxes="".join(map(_box, blocks)),
        )
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 400)
    fingers = [_Finger(push, blocks, 2.0) for push in pushes]
    worst = 0.0
    for step in range(round(_LONGEST_S / _STEP_S)):
        if all(finger.is_done for finger in fingers) or worst > _FALLEN_RAD:
            break
        wrench = np.zeros(6)
        for finger in fingers:
            wrench += finger.wrench(data, step * _STEP_S)
        data.xfrc_applied[1] = wrench
        mujoco.mj_step(model, data)
        worst = max(worst, math.acos(min(1.0, float(data.xmat[1][8]))))
    return worst


class _Finger:
    """Goes on at its speed until it presses too hard or has gone far enough; then back."""

    def __init__(self, push: Push, blocks: tuple[Block, ...], travel_mm: float) -> None:
        block = next(block for block in blocks if block.z[0] <= push.height <= block.z[1])
        self._push, self._travel_mm = push, travel_mm
        self._normal = np.zeros(3)
        self._normal[push.axis] = push.sign
        face = np.array([*block.centre, push.height])
        face[push.axis] += push.sign * block.size[push.axis] / 2
        self._face = face * _MM  # a point of the side, in the part's frame
        self._at = face * _MM
        self._at[1 - push.axis] += push.aside * _MM
        self._gone, self._back, self._shear = 0.0, False, np.zeros(3)
        self.is_done = False

    def wrench(self, data: mujoco.MjData, now_s: float) -> np.ndarray:
        """Force and moment about the centre of mass that the finger's skin puts on the part, (6,)."""
        turned = data.xmat[1].reshape(3, 3)
        normal, face = turned @ self._normal, data.xpos[1] + turned @ self._face
        tip = self._at - self._normal * self._gone * _MM
        # From the tip along the finger's axis to the side's plane.
        depth_mm = float(normal @ (face - tip)) / float(normal @ self._normal) / _MM
        press = max(depth_mm, 0.0) * _STIFFNESS_N_MM
        where = tip + self._normal * depth_mm * _MM
        speed = data.qvel[:3] + np.cross(turned @ data.qvel[3:], where - data.xpos[1])
        force = -press * normal + self._friction(press, speed + self._heading(now_s) * self._normal, normal)
        self._move(press, now_s)
        return np.concatenate([force, np.cross(where - data.xipos[1], force)])

    def _friction(self, press_n: float, passing: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Shear of the skin by a side that passes it, until it slips."""
        shear = self._shear + passing * _STEP_S
        shear -= normal * float(normal @ shear)
        most = self._push.friction * press_n / (_SHEAR_SHARE * _STIFFNESS_N_MM / _MM)
        self._shear = shear * min(1.0, most / max(float(np.linalg.norm(shear)), 1e-12))
        return -self._shear * (_SHEAR_SHARE * _STIFFNESS_N_MM / _MM)

    def _heading(self, now_s: float) -> float:
        """Speed of the tip towards the part, m/s."""
        if now_s < self._push.delay_s or self.is_done:
            return 0.0
        return (-1 if self._back else 1) * self._push.speed * _MM

    def _move(self, press_n: float, now_s: float) -> None:
        self._gone += self._heading(now_s) / _MM * _STEP_S
        self._back |= press_n > _MOST_N or self._gone >= self._travel_mm
        self.is_done |= self._back and press_n == 0.0


def _box(block: Block) -> str:
    low, high = block.z
    centre = np.array([*block.centre, (low + high) / 2]) * _MM
    half = np.array([*block.size, high - low]) / 2 * _MM
    return f'<geom type="box" pos="{_words(centre)}" size="{_words(half)}"/>'


def _words(values: np.ndarray) -> str:
    return " ".join(map(str, values.tolist()))


def drawn_stack(rng: np.random.Generator) -> tuple[Block, ...]:
    """A block, or one that carries a smaller or larger one aside of its middle."""
    a, b = rng.uniform(8, 70, 2).tolist()
    height = float(rng.uniform(8, 60))
    lower = Block((0.0, 0.0), (a, b), (0.0, height))
    if rng.uniform() < 0.5:
        return (lower,)
    size = (a * float(rng.uniform(0.3, 1.5)), b * float(rng.uniform(0.3, 1.5)))
    aside = (a * float(rng.uniform(-0.3, 0.3)), b * float(rng.uniform(-0.3, 0.3)))
    return (lower, Block(aside, size, (height, height + float(rng.uniform(5, 50)))))


def drawn_pushes(rng: np.random.Generator, blocks: tuple[Block, ...], height: float) -> list[Push]:
    """One to three fingers at a height, against different sides."""
    block = next(block for block in blocks if block.z[0] <= height <= block.z[1])
    sides = rng.permutation(4)[: rng.integers(1, 4)]
    pushes = []
    for side in sides.tolist():
        axis, sign = side % 2, 1 - 2 * (side // 2)
        half = block.size[1 - axis] / 2
        pushes.append(
            Push(
                axis,
                sign,
                float(rng.uniform(-0.9, 0.9)) * half,
                height,
                float(rng.uniform(0.0, 0.7)),
                float(rng.uniform(5, 20)),
                float(rng.uniform(0, 0.1)) if pushes else 0.0,
            )
        )
    return pushes
