"""MuJoCo part: a free rigid body on feet, simulated by an independent physics engine.

Needs the extra `physics`. The skin's forces are handed to MuJoCo as external forces at the tips' heights, so
that the part can tip as well as slide; the table's contact is MuJoCo's own. Its default contact creeps under
load below friction by up to some mm/s: an elliptic friction cone with a high `impratio` and the noslip solver
end that (MuJoCo documentation, Computation, "Contact"). Its sliding contacts press a body up, the more the
faster they slide: load goes to the feet that slide fastest, and hard feet hop, which turns it. Feet that
yield by some 0.1 mm do so little. They differ in length by as much as gives each its load.
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators.part import (
    GRAVITY_M_S2,
    Displacement,
    Displacements,
    FrictionSupport,
    TipForces,
)

_STEP_S = 0.25e-3
_FOOT_RADIUS_M = 1e-3  # radius of a foot: feet are small spheres
_M_PER_MM = 1e-3
_STILL_M_S = 1e-5
_SETTLE_STEPS = 2000
_LEVELLING_ROUNDS = 4
_SAME_MM = 1e-7
_FALLEN_TILT_RAD = 0.05

_MODEL = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -{gravity}" cone="elliptic" impratio="100" noslip_iterations="4"
    integrator="implicitfast"/>
  <default><geom condim="3" friction="{friction} 0 0" solref="0.01 1" solimp="0.1 0.1 0.0001"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="part" pos="0 0 {height}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia}"/>
      {feet}
    </body>
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class MassDistribution:
    """Centre of mass of a part, and its size for its inertia."""

    centre_mm: tuple[float, float]
    height_mm: float
    extent_mm: tuple[float, float, float]


class MujocoPart:
    """A rigid body on feet, with loads as the support says, which balance about its centre of mass."""

    def __init__(self, support: FrictionSupport, body: MassDistribution) -> None:
        self._centre = np.array(body.centre_mm)
        self._height_mm = body.height_mm
        self._model = mujoco.MjModel.from_xml_string(_xml(support, body))
        self._data = mujoco.MjData(self._model)
        self._stand()
        for _ in range(_LEVELLING_ROUNDS):
            stood = self._model.geom_pos.copy()
            self._level(support)
            self._stand()
            if (
                self.tilt_rad > _FALLEN_TILT_RAD
            ):  # feet that bear next to nothing were made too short for the rest
                self._model.geom_pos[:] = stood
                self._stand()
                break
        self._rest = self._pose()
        self._awake = False
        self.displacements: Displacements = (Displacement(self._centre, np.zeros(2), 0.0),)

    def step(self, tip_forces: TipForces, touched: bool, dt_s: float) -> None:
        """Let the engine run for `dt_s`; a part that nothing touches and that stands still sleeps."""
        if not touched and not self._awake:
            return
        for _ in range(round(dt_s / _STEP_S)):
            self._push(tip_forces)
            mujoco.mj_step(self._model, self._data)
        moved = self._current_displacement()
        self._awake = float(np.abs(self._data.qvel).max()) > _STILL_M_S
        (now,) = self.displacements
        if max(*np.abs(moved.shift_mm - now.shift_mm), abs(moved.turn_rad - now.turn_rad)) > _SAME_MM:
            self.displacements = (moved,)

    @property
    def at_rest(self) -> bool:
        """True if it sleeps until a tip touches it."""
        return not self._awake

    @property
    def tilt_rad(self) -> float:
        """Lean of the part since it was put."""
        mujoco.mj_kinematics(self._model, self._data)
        return math.acos(min(1.0, float(self._data.xmat[1][8])))

    def _stand(self) -> None:
        """Put the part on its feet, and let it come to rest."""
        mujoco.mj_resetData(self._model, self._data)
        mujoco.mj_step(self._model, self._data, _SETTLE_STEPS)

    def _level(self, support: FrictionSupport) -> None:
        """Let feet that bear too little be longer: each is pressed in by about as much as it bears."""
        load, dent = np.zeros(len(support.share)), np.zeros(len(support.share))
        force = np.zeros(6)
        for number in range(self._data.ncon):
            contact = self._data.contact[number]
            mujoco.mj_contactForce(self._model, self._data, number, force)
            load[max(contact.geom) - 1], dent[max(contact.geom) - 1] = force[0], -contact.dist
        wanted = support.share * support.mass_kg * GRAVITY_M_S2
        longer = dent.sum() / load.sum() * (wanted - load)
        # A part that leans loads its feet as one on feet that are longer by a linear function of the place.
        place = np.column_stack([np.ones(len(longer)), support.feet_mm])
        longer -= place @ np.linalg.lstsq(place, longer)[0]
        self._model.geom_pos[1:, 2] -= longer

    def _push(self, tip_forces: TipForces) -> None:
        """Hand the tips' forces to the engine, with their moments about the centre of mass."""
        moved = self._current_displacement()
        middle = moved.place(self._centre)
        total = np.zeros(6)
        for force in tip_forces((moved,))[0]:
            arm = np.array([*(force.point_mm - middle), force.height_mm - self._height_mm]) * _M_PER_MM
            push = np.array([*force.force_n, 0.0])
            total[:3] += push
            total[3:] += np.cross(arm, push)
        self._data.xfrc_applied[1] = total

    def _current_displacement(self) -> Displacement:
        x, y, turn = self._pose() - self._rest
        return Displacement(self._centre, np.array([x, y]), math.remainder(turn, 2 * math.pi))

    def _pose(self) -> Floats:
        """Position of the centre of mass (mm) and turn about the vertical (rad), (3,)."""
        x, y, _, w, _, _, z = self._data.qpos
        return np.array([x / _M_PER_MM, y / _M_PER_MM, 2 * math.atan2(z, w)])


def _xml(support: FrictionSupport, body: MassDistribution) -> str:
    height = body.height_mm * _M_PER_MM
    feet = []
    for x, y in (support.feet_mm - np.array(body.centre_mm)) * _M_PER_MM:
        feet.append(f'<geom type="sphere" size="{_FOOT_RADIUS_M}" pos="{x} {y} {_FOOT_RADIUS_M - height}"/>')
    a, b, c = (np.array(body.extent_mm) * _M_PER_MM) ** 2
    inertia = np.array([b + c, a + c, a + b]) * support.mass_kg / 12
    return _MODEL.format(
        step=_STEP_S,
        gravity=GRAVITY_M_S2,
        friction=support.friction,
        height=height,
        mass=support.mass_kg,
        inertia=" ".join(map(str, inertia)),
        feet="\n      ".join(feet),
    )
