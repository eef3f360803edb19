"""A palpate rig as a robot of LeRobot: `--robot.type=palpate`."""

from lerobot_robot_palpate.config_palpate import PalpateConfig
from lerobot_robot_palpate.robot import Palpate

__all__ = ["Palpate", "PalpateConfig"]
