"""Robot of LeRobot that is a connected palpate rig: an action is a touch, an observation what is known."""

import math
from contextlib import ExitStack
from functools import cached_property
from typing import Any

from lerobot.robots import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import palpate
from lerobot_robot_palpate.config_palpate import PalpateConfig

_OF_FINGER = ("touched", "x_mm", "y_mm", "normal_lo_rad", "normal_hi_rad")
_OF_PART = ("x_mm", "y_mm", "theta_rad", "x_half_mm", "y_half_mm", "theta_half_rad")


class Palpate(Robot):  # type: ignore[misc]  # lerobot has no types
    """A palpate rig, emulated or real. Torque is on from `connect` to `disconnect`.

    Actions: `finger` (index) and `direction_rad` (in which its tip goes, in W); the finger's approach whose
    direction is nearest is made, as far as it goes or until it touches, and returned. A touch takes seconds.

    Observations, numbers all: of each finger's last touch, `NAME.touched` (0 or 1), where the tip's centre
    stopped, `NAME.x_mm` and `NAME.y_mm`, and the range of the surface's normal there (0 to 2π: unknown); of
    the heaviest hypothesis its index in the catalogue, `part.object` (−1: none yet), its pose and half the
    widths of its bounds; `part.left`: how many are left; `part.done`: palpate would touch no more.

    After `part.done` the next action begins with nothing known: on an emulated rig with the next part, on a
    real one with what lies there, which may be changed in between.
    """

    config_class = PalpateConfig
    name = "palpate"

    def __init__(self, config: PalpateConfig) -> None:
        """Open the rig file; no port is opened yet."""
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = {}  # lerobot's record command counts them
        self._rig = palpate.open_rig(config.rig, seed=config.seed)
        self._objects = palpate.load_objects(config.objects)
        self._names = [finger.name for finger in self._rig.file.fingers]
        self._connection = ExitStack()
        self._ready: palpate.ReadyRig | None = None
        self._known: palpate.RigRecognition
        self._is_done = False

    @cached_property
    def observation_features(self) -> dict[str, type]:
        """Names of the observations, a float each."""
        return dict.fromkeys([*self._nothing()], float)

    @property
    def action_features(self) -> dict[str, type]:
        """Names of the actions, a float each."""
        return {"finger": float, "direction_rad": float}

    @property
    def is_connected(self) -> bool:
        """True if torque is on."""
        return self._ready is not None

    @property
    def is_calibrated(self) -> bool:
        """True: a calibration is optional, and `palpate calibrate` makes it."""
        return True

    def calibrate(self) -> None:
        """Do nothing: `palpate calibrate` calibrates."""

    def configure(self) -> None:
        """Do nothing: the rig file configures."""

    def connect(self, calibrate: bool = True) -> None:  # noqa: ARG002  # lerobot's signature
        """Connect; torque goes on, and on an emulated rig the next part lies on the table."""
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        connected = self._rig.connect(self._objects, unconfirmed=self.config.unconfirmed)
        self._ready = self._connection.enter_context(connected)
        self._begin(self._ready)

    def disconnect(self) -> None:
        """Switch torque off and disconnect."""
        self._connected()
        self._ready = None
        self._connection.close()

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Touch; return the action that was carried out."""
        ready = self._connected()
        if self._is_done and self._rig.emulated:
            self.disconnect()
            self.connect()
            ready = self._connected()
        elif self._is_done:
            self._begin(ready)
        finger, direction = round(float(action["finger"])), float(action["direction_rad"])
        finger = min(max(finger, 0), len(self._names) - 1)
        ways = [item for item in ready.approaches if item.finger_index == finger]
        way = min(ways, key=lambda item: -math.cos(item.direction_rad - direction))
        self._known = self._known.extend(ready.touch(way))
        self._observed = self._observe(ready)
        return {"finger": float(finger), "direction_rad": way.direction_rad}

    def get_observation(self) -> dict[str, Any]:
        """Return what is known."""
        self._connected()
        return dict(self._observed)

    def planned_action(self) -> dict[str, Any] | None:
        """Return the touch that palpate's planner would make first; None if it would make none."""
        planned = self._connected().plan(self._known)
        if not planned:
            return None
        return {"finger": float(planned[0].finger_index), "direction_rad": planned[0].direction_rad}

    def _connected(self) -> palpate.ReadyRig:
        if self._ready is None:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first")
        return self._ready

    def _begin(self, ready: palpate.ReadyRig) -> None:
        self._known = ready.recognise(self._objects)
        self._observed, self._is_done = self._nothing(), False

    def _nothing(self) -> dict[str, float]:
        """Observation before the first touch."""
        fingers = {f"{name}.{key}": 0.0 for name in self._names for key in _OF_FINGER}
        part = {"part.object": -1.0} | {f"part.{key}": 0.0 for key in (*_OF_PART, "left", "done")}
        return fingers | part

    def _observe(self, ready: palpate.ReadyRig) -> dict[str, float]:
        known, found = self._known, self._nothing()
        for touch in (touch for grip in known.grips for touch in grip.touches):
            contact, name = touch.contact, self._names[touch.finger_index]
            normal = (
                (0.0, math.tau) if contact.normal is None else (contact.normal.lo_rad, contact.normal.hi_rad)
            )
            values = (float(contact.touched), *contact.end_mm, *normal)
            found |= {f"{name}.{key}": value for key, value in zip(_OF_FINGER, values, strict=True)}
        is_found = len(known.hypotheses) == 1 and known.goal_met
        self._is_done = is_found or not ready.plan(known)
        found |= {"part.left": float(len(known.hypotheses)), "part.done": float(self._is_done)}
        if known.hypotheses:
            first = known.hypotheses[0]
            at, bounds = first.configuration, first.bounds
            half = ((hi - lo) / 2 for lo, hi in (bounds.x_mm, bounds.y_mm, bounds.theta_rad))
            pose = (at.x_mm, at.y_mm, at.theta_rad, *half)
            names = [model.name for model in self._objects.objects]
            found["part.object"] = float(names.index(first.state.object_name))
            found |= {f"part.{key}": value for key, value in zip(_OF_PART, pose, strict=True)}
        return found
