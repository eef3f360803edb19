"""URDF of rigs, read by parsers of others, whose kinematics must put tips where palpate's own do."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.config import load_rig
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import kinematics_of
from palpate.views.exports.urdf import joint_values, rig_urdf
from support.commands.command import Here
from support.commands.repository import PACKAGE, ROOT

RIGS = [PACKAGE / "config/rigs/bench.toml"] + [
    ROOT / "examples" / f"{name}.toml" for name in ("two-link-rig", "pad-rig", "ball-rig", "fresh-stage")
]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_a_foreign_parser_puts_tips_where_the_rig_has_them(path: Path, tmp_path: Path) -> None:
    """Of joint values that are drawn within their limits; without cameras, meshes or masses."""
    yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
    rig, stage = load_rig(path), Stage.of(load_rig(path))
    (tmp_path / "rig.urdf").write_text(rig_urdf(rig), encoding="utf-8")
    robot: Any = yourdfpy.URDF.load(str(tmp_path / "rig.urdf"))
    assert robot.validate()
    assert robot.base_link == "W"
    values, draw = joint_values(rig), np.random.default_rng(0)
    assert list(robot.actuated_joint_names) == [servo.name for servo in rig.servos]
    for _ in range(20):
        servos = {servo.name: draw.uniform(-math.pi, math.pi) for servo in rig.servos}
        robot.update_cfg({name: values[name](angle) for name, angle in servos.items()})
        turn = stage.turn(servos.get("stage", stage.servo_rad(0.0)))
        for finger in rig.fingers:
            angles = tuple(servos[f"{finger.name}_{joint}"] for joint in finger.servos)
            expected = turn.point_mm(kinematics_of(finger).centre_mm(angles))
            found = robot.get_transform(f"tip-{finger.name}", "W")[:3, 3] * 1e3
            assert found == pytest.approx((*expected, finger.height_mm), abs=1e-4)


def test_limits_are_those_of_the_rig_file(tmp_path: Path, here: Here) -> None:
    from xml.etree.ElementTree import parse

    rig = load_rig(RIGS[0])
    ended = here("export", RIGS[0], "--urdf", "rig.urdf")
    assert (ended.code, ended.out) == (0, "")
    joints = {joint.get("name"): joint for joint in parse(tmp_path / "rig.urdf").getroot().iter("joint")}
    for finger in rig.fingers:
        limit = joints[f"{finger.name}_slide"].find("limit")
        assert limit is not None
        assert [float(limit.get(key, "")) * 1e3 for key in ("lower", "upper")] == list(finger.slide.range_mm)  # type: ignore[attr-defined]
    assert "say what to write" in here("export", RIGS[0]).err
    assert "is not a session" in here("export", RIGS[0], "--urdf", "rig.urdf", "--csv", "tables").err
