"""Environment in which a policy chooses touches of an unknown part until palpate has identified it."""

import math
from contextlib import ExitStack
from os import PathLike
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

import palpate

Observation = dict[str, Any]

HYPOTHESES = 8
"""Hypotheses in an observation, the heaviest."""

_LIMIT = 1e4  # of every number in an observation
_CONTACT_NUMBERS = 9
_HYPOTHESIS_NUMBERS = 9
_ANSWERS = ("identified", "indistinguishable")
_IDENTIFIED_REWARD = 10.0
_TOUCH_REWARD = -1.0


class TouchEnv(gymnasium.Env[Observation, np.int64]):
    """Touches on palpate's emulated bench: an action is one of `approaches`, an observation what is known.

    An episode's part and its place are drawn from the seed of `reset`, or are the `scene` of its options. It
    is terminated when one hypothesis is left whose bounds are as narrow as the rig file's goals
    (`info["verdict"]` is "identified"), or when palpate's planner knows no further grip ("indistinguishable",
    or "unknown" where nothing fits); truncated after `max_touches`. The reward is −1 for each touch, and +10
    for an answer. `identify` makes some touches more, to tell whether the part is of the catalogue at all.

    Observations, mm and rad in W, rows of zeros where there is nothing:
    `contacts` (max_touches, 9), in order: 1, touched (0 or 1), index of the finger, start x and y, end x
    and y, normal from and to (0 and 2π where nothing is known of it).
    `hypotheses` (8, 9), the heaviest first: weight, index of the object, index of its state, x, y, θ, and
    half the widths of their bounds.
    `left` (1,): how many hypotheses are left.

    `info` has the `verdict`, and in `planned` the actions of the grip that palpate's planner would make now.
    """

    def __init__(
        self,
        rig: "str | PathLike[str] | None" = None,
        objects: "str | PathLike[str] | None" = None,
        max_touches: int = 30,
    ) -> None:
        """Open a rig file, by default the shipped one, with a catalogue, by default the shipped one."""
        self.objects = palpate.load_objects(objects)
        self._file, self._max_touches = rig, max_touches
        self._connection = ExitStack()
        self._numbers = {
            (model.name, state.name): (float(i), float(j))
            for i, model in enumerate(self.objects.objects)
            for j, state in enumerate(model.states)
        }
        self.approaches = palpate.GripPlanner(self._opened(0).file).approaches
        self._actions = {_line(item): number for number, item in enumerate(self.approaches)}
        self.action_space = spaces.Discrete(len(self.approaches))
        shapes = {
            "contacts": (max_touches, _CONTACT_NUMBERS),
            "hypotheses": (HYPOTHESES, _HYPOTHESIS_NUMBERS),
            "left": (1,),
        }
        self.observation_space = spaces.Dict(
            {name: spaces.Box(-_LIMIT, _LIMIT, shape, np.float32) for name, shape in shapes.items()}
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put a part on the table; `options={"scene": FILE}` says which and where."""
        super().reset(seed=seed)
        self.close()
        rig = self._opened(int(self.np_random.integers(2**31)))
        scene = (options or {}).get("scene")
        self._rig = self._connection.enter_context(rig.connect(self.objects, scene=scene))
        self._known = self._rig.recognise(self.objects)
        return self._observation(), self._info()

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Touch along an approach: reward, and whether the episode is over. InputError for another action."""
        if not self.action_space.contains(action):
            raise palpate.InputError(f"action is {action!r}; it must be a number of {self.action_space}")
        self._known = self._known.extend(self._rig.touch(self.approaches[action]))
        info = self._info()
        answered = info["verdict"] in _ANSWERS
        terminated = answered or not info["planned"]
        reward = _TOUCH_REWARD + (_IDENTIFIED_REWARD if answered else 0.0)
        truncated = not terminated and len(self._known.grips) >= self._max_touches
        return self._observation(), reward, terminated, truncated, info

    def close(self) -> None:
        """Disconnect the rig."""
        self._connection.close()

    @property
    def recognition(self) -> palpate.RigRecognition:
        """All that is known, with every hypothesis and its bounds."""
        return self._known

    def _opened(self, seed: int) -> palpate.Rig:
        rig = palpate.open_rig(self._file, seed=seed)
        if not rig.emulated:
            raise palpate.InputError(f"{self._file}: has real ports; this environment is for emulated rigs")
        return rig.with_(search={"max_grips": self._max_touches + 1})

    def _info(self) -> dict[str, Any]:
        planned = self._rig.plan(self._known)
        is_found = len(self._known.hypotheses) == 1 and self._known.goal_met
        return {
            "verdict": "identified" if is_found else str(self._known.verdict),
            "planned": [self._actions[_line(item)] for item in planned],
        }

    def _observation(self) -> Observation:
        contacts = [_contact(touch) for grip in self._known.grips for touch in grip.touches]
        hypotheses = [self._hypothesis(item) for item in self._known.hypotheses[:HYPOTHESES]]
        left = float(len(self._known.hypotheses))
        return {
            "contacts": _rows(contacts[-self._max_touches :], (self._max_touches, _CONTACT_NUMBERS)),
            "hypotheses": _rows(hypotheses, (HYPOTHESES, _HYPOTHESIS_NUMBERS)),
            "left": np.minimum(np.array([left], np.float32), np.float32(_LIMIT)),
        }

    def _hypothesis(self, item: Any) -> tuple[float, ...]:
        at, bounds = item.configuration, item.bounds
        widths = [(hi - lo) / 2 for lo, hi in (bounds.x_mm, bounds.y_mm, bounds.theta_rad)]
        numbers = self._numbers[item.state.object_name, item.state.state.name]
        return item.weight, *numbers, at.x_mm, at.y_mm, at.theta_rad, *widths


def _contact(touch: Any) -> tuple[float, ...]:
    contact, normal = touch.contact, touch.contact.normal
    normals = (0.0, math.tau) if normal is None else (normal.lo_rad, normal.hi_rad)
    start_and_end = (*contact.start_mm, *contact.end_mm)
    return 1.0, float(contact.touched), float(touch.finger_index), *start_and_end, *normals


def _line(item: palpate.FingerApproach) -> tuple[object, ...]:
    """The line of an approach, which a plan may shorten."""
    return item.finger_index, item.stage_rad, item.start_mm, item.direction_rad


def _rows(rows: list[tuple[float, ...]], shape: tuple[int, int]) -> NDArray[np.float32]:
    found = np.zeros(shape, np.float32)
    if rows:
        found[: len(rows)] = np.clip(rows, -_LIMIT, _LIMIT)
    return found
