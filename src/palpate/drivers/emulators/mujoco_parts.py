"""MuJoCo parts: free rigid bodies on feet, simulated by an independent physics engine.

Needs the extra `physics`. The skin's forces are handed to MuJoCo as external forces at the tips' heights, so
that the part can tip as well as slide; the table's contact is MuJoCo's own. Its default contact creeps under
load below friction by up to some mm/s: an elliptic friction cone with a high `impratio` and the noslip solver
end that (MuJoCo documentation, Computation, "Contact"). Its sliding contacts press a body up, the more the
faster they slide: load goes to the feet that slide fastest, and hard feet hop, which turns it. Feet that
yield by some 0.1 mm do so little. They differ in length by as much as gives each its load.

Several parts are bodies of one world, and collide: each is made of upright convex prisms, which meet those of
other parts only. A lone part has none.
"""

import math
from collections.abc import Iterable, Sequence
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
    integrator="implicitfast">
    <flag multiccd="enable"/>
  </option>
  <default>
    <geom condim="3" solref="0.01 1" solimp="0.1 0.1 0.0001"/>
    <default class="foot"><geom type="sphere" size="{foot}" conaffinity="0"/></default>
    <default class="prism">
      <geom type="mesh" contype="2" conaffinity="2" solref="0.002 1" solimp="0.9 0.99 0.0005"/>
    </default>
  </default>
  <asset>
    {meshes}
  </asset>
  <worldbody>
    <geom type="plane" size="1 1 1" friction="0 0 0"/>
    {bodies}
  </worldbody>
</mujoco>
"""
_BODY = """
    <body pos="{place}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia}"/>
      {geoms}
    </body>
"""
_PRISMS_MEET = 2  # their bit of contype and conaffinity; feet and the table have another one


@dataclass(frozen=True)
class MassDistribution:
    """Centre of mass of a part, and its size for its inertia."""

    centre_mm: tuple[float, float]
    height_mm: float
    extent_mm: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Prism:
    """Upright convex prism: corners (n, 2) mm in W as the part is put, and from which height to which."""

    corners_mm: Floats
    z_mm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class MujocoBody:
    """Part as MuJoCo has it, with loads of its feet that balance about its centre of mass."""

    support: FrictionSupport
    mass: MassDistribution
    prisms: Sequence[Prism] = ()

    @property
    def centre_mm(self) -> Floats:
        """Centre of mass (2,) in W as the part is put."""
        return np.array(self.mass.centre_mm)


class MujocoParts:
    """Rigid bodies on feet, in one world."""

    def __init__(self, bodies: Sequence[MujocoBody]) -> None:
        self._bodies = tuple(bodies)
        self._model = mujoco.MjModel.from_xml_string(_xml(self._bodies))
        self._data = mujoco.MjData(self._model)
        is_foot = self._model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
        self._feet = [
            np.flatnonzero(is_foot & (self._model.geom_bodyid == number + 1)) for number in range(len(bodies))
        ]
        self._let_prisms_meet(0)  # while they settle
        self._stand()
        self._level_all()
        self._let_prisms_meet(_PRISMS_MEET)
        self._rest = [self._pose(number) for number in range(len(bodies))]
        self._awake = False
        self.displacements: Displacements = tuple(
            Displacement(body.centre_mm, np.zeros(2), 0.0) for body in self._bodies
        )

    def step(self, tip_forces: TipForces, touched: bool, dt_s: float) -> None:
        """Let the engine run for `dt_s`; parts that nothing touches and that stand still sleep."""
        if not touched and not self._awake:
            return
        for _ in range(round(dt_s / _STEP_S)):
            self._push(tip_forces)
            mujoco.mj_step(self._model, self._data)
        self._awake = float(np.abs(self._data.qvel).max()) > _STILL_M_S
        found = tuple(
            now if _is_same(now, moved) else moved
            for now, moved in zip(self.displacements, self._current_displacements(), strict=True)
        )
        if any(now is not before for now, before in zip(found, self.displacements, strict=True)):
            self.displacements = found

    @property
    def at_rest(self) -> bool:
        """True if all sleep until a tip touches one."""
        return not self._awake

    def tilt_rad(self, number: int = 0) -> float:
        """Lean of a part since it was put."""
        mujoco.mj_kinematics(self._model, self._data)
        return math.acos(min(1.0, float(self._data.xmat[1 + number][8])))

    def _let_prisms_meet(self, bits: int) -> None:
        is_prism = self._model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
        self._model.geom_contype[is_prism] = self._model.geom_conaffinity[is_prism] = bits

    def _stand(self) -> None:
        """Put the parts on their feet, and let them come to rest."""
        mujoco.mj_resetData(self._model, self._data)
        mujoco.mj_step(self._model, self._data, _SETTLE_STEPS)

    def _level_all(self) -> None:
        """Let feet have such lengths that they bear what they should."""
        left = list(range(len(self._bodies)))
        for _ in range(_LEVELLING_ROUNDS):
            if not left:
                break
            stood = self._model.geom_pos.copy()
            self._level(left)
            self._stand()
            # Feet that bear next to nothing may have been made too short for the rest.
            fallen = [number for number in left if self.tilt_rad(number) > _FALLEN_TILT_RAD]
            for number in fallen:
                self._model.geom_pos[self._feet[number]] = stood[self._feet[number]]
                left.remove(number)
            if fallen:
                self._stand()

    def _level(self, numbers: Iterable[int]) -> None:
        """Let feet that bear too little be longer: each is pressed in by about as much as it bears."""
        load, dent = np.zeros(self._model.ngeom), np.zeros(self._model.ngeom)
        force = np.zeros(6)
        for number in range(self._data.ncon):
            contact = self._data.contact[number]
            mujoco.mj_contactForce(self._model, self._data, number, force)
            load[max(contact.geom)], dent[max(contact.geom)] = force[0], -contact.dist
        for number in numbers:
            support, feet = self._bodies[number].support, self._feet[number]
            wanted = support.share * support.mass_kg * GRAVITY_M_S2
            longer = dent[feet].sum() / load[feet].sum() * (wanted - load[feet])
            # A part that leans loads its feet as one on feet that are longer by a linear function of the
            # place.
            place = np.column_stack([np.ones(len(longer)), support.feet_mm])
            longer -= place @ np.linalg.lstsq(place, longer)[0]
            self._model.geom_pos[feet, 2] -= longer

    def _push(self, tip_forces: TipForces) -> None:
        """Hand the tips' forces to the engine, with their moments about the centres of mass."""
        moved = self._current_displacements()
        for number, (forces, displacement) in enumerate(zip(tip_forces(moved), moved, strict=True)):
            body = self._bodies[number]
            middle = displacement.place(body.centre_mm)
            total = np.zeros(6)
            for force in forces:
                aside, above = force.point_mm - middle, force.height_mm - body.mass.height_mm
                arm = np.array([*aside, above]) * _M_PER_MM
                push = np.array([*force.force_n, 0.0])
                total[:3] += push
                total[3:] += np.cross(arm, push)
            self._data.xfrc_applied[1 + number] = total

    def _current_displacements(self) -> Displacements:
        found = []
        for number, body in enumerate(self._bodies):
            x, y, turn = self._pose(number) - self._rest[number]
            found.append(Displacement(body.centre_mm, np.array([x, y]), math.remainder(turn, 2 * math.pi)))
        return tuple(found)

    def _pose(self, number: int) -> Floats:
        """Position of a part's centre of mass (mm) and its turn about the vertical (rad), (3,)."""
        x, y, _, w, _, _, z = self._data.qpos[7 * number : 7 * number + 7]
        return np.array([x / _M_PER_MM, y / _M_PER_MM, 2 * math.atan2(z, w)])


def _is_same(now: Displacement, moved: Displacement) -> bool:
    turned = abs(moved.turn_rad - now.turn_rad)
    return bool(max(*np.abs(moved.shift_mm - now.shift_mm), turned) <= _SAME_MM)


def _xml(bodies: Sequence[MujocoBody]) -> str:
    """Model with the first part's centre of mass above its origin."""
    meshes: list[str] = []
    texts = [_body_xml(body, (body.centre_mm - bodies[0].centre_mm) * _M_PER_MM, meshes) for body in bodies]
    return _MODEL.format(
        step=_STEP_S,
        gravity=GRAVITY_M_S2,
        foot=_FOOT_RADIUS_M,
        meshes="\n    ".join(meshes),
        bodies="\n".join(texts),
    )


def _body_xml(body: MujocoBody, at_m: Floats, meshes: list[str]) -> str:
    """Body at a place (2,); its prisms' meshes are added to those of others."""
    height, friction = body.mass.height_mm * _M_PER_MM, f'friction="{body.support.friction} 0 0"'
    geoms = [
        f'<geom class="foot" pos="{x} {y} {_FOOT_RADIUS_M - height}" {friction}/>'
        for x, y in (body.support.feet_mm - body.centre_mm) * _M_PER_MM
    ]
    for prism in body.prisms:
        geoms.append(f'<geom class="prism" mesh="{len(meshes)}" {friction}/>')
        corners = (prism.corners_mm - body.centre_mm) * _M_PER_MM
        ends = [z * _M_PER_MM - height for z in prism.z_mm]
        vertices = " ".join(f"{x} {y} {z}" for z in ends for x, y in corners)
        meshes.append(f'<mesh name="{len(meshes)}" vertex="{vertices}"/>')
    a, b, c = (np.array(body.mass.extent_mm) * _M_PER_MM) ** 2
    inertia = np.array([b + c, a + c, a + b]) * body.support.mass_kg / 12
    return _BODY.format(
        place=f"{at_m[0]} {at_m[1]} {height}",
        mass=body.support.mass_kg,
        inertia=" ".join(map(str, inertia)),
        geoms="\n      ".join(geoms),
    )
