"""URDF of a rig: the joints of its fingers and stage, and its tips, for ROS and other robot programs.

Links are `W`, `stage` where there is one, and for each finger what its joints carry, `tip-FINGER` the last.
Joints are called as servos are in exports: `FINGER_JOINT`. Lengths are in m, angles in rad. A rig file knows
the sizes of tips and of arms' links; all else is drawn as a thin rod. Efforts and speeds are the rig file's
limits at the tip. There are no masses and no bodies to collide with.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from palpate.base.errors import InputError
from palpate.base.tips import TipShape
from palpate.config import ArmFingerConfig, FingerConfig, RigFile, SlideFingerConfig
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.slide_kinematics import SlideKinematics
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import kinematics_of

_ROOT = "W"
_STAGE = "stage"
_M_PER_MM = 1e-3
_ROD_MM = 4.0
_TIP_HEIGHT_MM = 20.0  # of tips whose length the rig file does not give

_Place = tuple[float, float, float]


@dataclass(frozen=True)
class _Body:
    """A box, cylinder or sphere by its sizes (mm), its middle at a place (mm) of its link."""

    shape: str
    sizes_mm: Mapping[str, tuple[float, ...]]
    at_mm: _Place = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Joint:
    """A joint and the link that it carries, limits in rad or m; `value` of it for its servo's angle (rad)."""

    name: str
    kind: str
    parent: str
    child: str
    at_mm: _Place
    yaw_rad: float = 0.0
    limits: tuple[float, float] = (0.0, 0.0)
    lever_mm: float = 0.0
    value: Callable[[float], float] | None = None
    bodies: tuple[_Body, ...] = ()


def joint_values(rig: RigFile) -> Mapping[str, Callable[[float], float]]:
    """Values of the URDF's joints, rad or m, as functions of their servos' angles (rad)."""
    return {joint.name: joint.value for joint in _joints(rig) if joint.value is not None}


def rig_urdf(rig: RigFile) -> str:
    """The URDF. Raises InputError for a kind of finger that is not built in."""
    robot, radius = Element("robot", name=rig.name), rig.workspace.radius_mm
    table = _Body("cylinder", {"radius": (radius,), "length": (1.0,)}, (0.0, 0.0, -0.5))
    _add_link(robot, _ROOT, (table,))
    for joint in _joints(rig):
        _add_link(robot, joint.child, joint.bodies)
        element = SubElement(robot, "joint", name=joint.name, type=joint.kind)
        SubElement(element, "parent", link=joint.parent)
        SubElement(element, "child", link=joint.child)
        SubElement(element, "origin", xyz=_metres(joint.at_mm), rpy=f"0 0 {joint.yaw_rad:.9g}")
        if joint.kind == "fixed":
            continue
        SubElement(element, "axis", xyz="1 0 0" if joint.kind == "prismatic" else "0 0 1")
        lever = 1.0 if joint.kind == "prismatic" else joint.lever_mm * _M_PER_MM
        effort, speed = rig.closing.max_force_n * lever, rig.closing.approach_speed_mm_s * _M_PER_MM / lever
        numbers = dict(zip(("lower", "upper"), joint.limits, strict=True)) | {
            "effort": effort,
            "velocity": speed,
        }
        SubElement(element, "limit", {name: f"{value:.9g}" for name, value in numbers.items()})
    indent(robot)
    return tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _joints(rig: RigFile) -> Iterator[_Joint]:
    """Joints from the root on: those of the stage and of each finger."""
    parent, (x, y), stage = _ROOT, (0.0, 0.0), Stage.of(rig)
    if rig.stage is not None:
        parent, (x, y) = _STAGE, stage.centre_mm
        far = max(math.dist(finger.base_mm, stage.centre_mm) for finger in rig.fingers)
        yield _Joint(
            _STAGE,
            "revolute",
            _ROOT,
            _STAGE,
            (x, y, 0.0),
            limits=stage.range_rad,
            lever_mm=far,
            value=lambda servo_rad: stage.turn(servo_rad).angle_rad,
        )
    for finger in rig.fingers:
        base = finger.base_mm[0] - x, finger.base_mm[1] - y
        yield from _finger_joints(finger, parent, base)


def _finger_joints(finger: FingerConfig, parent: str, base_mm: tuple[float, float]) -> Iterator[_Joint]:
    match finger, kinematics_of(finger):
        case SlideFingerConfig(), SlideKinematics() as kinematics:
            yield from _slide_joints(finger, kinematics, parent, base_mm)
        case ArmFingerConfig(), ArmKinematics() as kinematics:
            yield from _arm_joints(finger, kinematics, parent, base_mm)
        case _:
            raise InputError(f"finger {finger.name}: there is no URDF for fingers of its type")


def _slide_joints(
    finger: SlideFingerConfig, slide: SlideKinematics, parent: str, base_mm: tuple[float, float]
) -> Iterator[_Joint]:
    name, (near, far) = finger.name, finger.slide.range_mm
    lo, hi = map(math.radians, finger.aim.range_deg)
    carrier, at_mm = f"{name}-slide", (*base_mm, finger.height_mm)
    yield _Joint(
        *(f"{name}_aim", "revolute", parent, carrier, at_mm, slide.heading_rad, (lo, hi), far),
        value=lambda servo_rad: slide.facing_rad((servo_rad, 0.0)) - slide.heading_rad,
    )
    limits = near * _M_PER_MM, far * _M_PER_MM
    rod = _Body("box", {"size": (far, _ROD_MM, _ROD_MM)}, (-far / 2, 0.0, 0.0))
    yield _Joint(
        *(f"{name}_slide", "prismatic", carrier, f"tip-{name}", (0.0, 0.0, 0.0), 0.0, limits),
        value=lambda servo_rad: _M_PER_MM * slide.distance_mm(servo_rad),
        bodies=(_tip_body(finger), rod),
    )


def _arm_joints(
    finger: ArmFingerConfig, arm: ArmKinematics, parent: str, base_mm: tuple[float, float]
) -> Iterator[_Joint]:
    name, top = finger.name, finger.links.links_height_mm
    links = [f"{name}-upper", f"{name}-fore"]
    places = [(*base_mm, top), (arm.upper_mm, 0.0, 0.0), (arm.fore_mm, 0.0, finger.height_mm - top)]
    for k, (key, joint, length) in enumerate(
        [("shoulder", arm.shoulder, arm.upper_mm), ("elbow", arm.elbow, arm.fore_mm)]
    ):
        limits, yaw = (joint.lo_rad, joint.hi_rad), 0.0 if k else arm.heading_rad
        lever = arm.fore_mm if k else arm.upper_mm + arm.fore_mm
        size = (length, arm.link_width_mm, _ROD_MM)
        yield _Joint(
            *(
                f"{name}_{key}",
                "revolute",
                links[0] if k else parent,
                links[k],
                places[k],
                yaw,
                limits,
                lever,
            ),
            value=joint.angle_rad,
            bodies=(_Body("box", {"size": size}, (length / 2, 0.0, _ROD_MM / 2)),),
        )
    yield _Joint(f"{name}_tip", "fixed", links[1], f"tip-{name}", places[2], bodies=(_tip_body(finger),))


def _tip_body(finger: FingerConfig) -> _Body:
    tip = finger.tip
    tall = tip.length_mm or _TIP_HEIGHT_MM
    match tip.shape:
        case TipShape.BALL:
            return _Body("sphere", {"radius": (tip.radius_mm,)})
        case TipShape.PAD:
            return _Body("box", {"size": (_ROD_MM, 2 * tip.radius_mm, tall)}, (-_ROD_MM / 2, 0.0, 0.0))
        case TipShape.CYLINDER:
            return _Body("cylinder", {"radius": (tip.radius_mm,), "length": (tall,)})


def _add_link(robot: Element, name: str, bodies: tuple[_Body, ...]) -> None:
    link = SubElement(robot, "link", name=name)
    for body in bodies:
        visual = SubElement(link, "visual")
        SubElement(visual, "origin", xyz=_metres(body.at_mm), rpy="0 0 0")
        sizes = {key: _metres(sizes) for key, sizes in body.sizes_mm.items()}
        SubElement(SubElement(visual, "geometry"), body.shape, sizes)


def _metres(values_mm: tuple[float, ...]) -> str:
    return " ".join(f"{value * _M_PER_MM:.9g}" for value in values_mm)
