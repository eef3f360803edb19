"""Question: which of these objects was touched, and where does it lie? The same for every peer.

Plain values, and files of them, so that a peer needs neither palpate nor its environment.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["Answer", "Model", "Peer", "Problem", "Solve", "Touch", "angle_between", "read", "write"]


@dataclass(frozen=True)
class Model:
    """An object's outline: vertices in mm, counter-clockwise."""

    name: str
    outline: tuple[tuple[float, float], ...]

    @property
    def points(self) -> np.ndarray:
        """Vertices (n, 2) in mm."""
        return np.array(self.outline)


@dataclass(frozen=True)
class Touch:
    """A round tip went straight from `start_mm` and was stopped at `centre_mm` by the object.

    The true centre is within `bound_mm` of what is stated, all along the way. The outward normal of the
    object at the contact is in `normal_rad`, counter-clockwise from the first to the second.
    """

    start_mm: tuple[float, float]
    centre_mm: tuple[float, float]
    radius_mm: float
    bound_mm: float
    normal_rad: tuple[float, float]

    @property
    def centre(self) -> np.ndarray:
        """The stated centre (2,)."""
        return np.array(self.centre_mm)

    @property
    def middle_rad(self) -> float:
        """Middle of the range of normals."""
        return (self.normal_rad[0] + self.normal_rad[1]) / 2

    @property
    def half_rad(self) -> float:
        """Half of the range of normals."""
        return (self.normal_rad[1] - self.normal_rad[0]) / 2


@dataclass(frozen=True)
class Problem:
    """A catalogue and several questions about it."""

    models: tuple[Model, ...]
    questions: tuple[tuple[Touch, ...], ...]


@dataclass(frozen=True)
class Answer:
    """An object and its pose x ↦ R(θ) x + (x, y).

    `box`: what is said to hold all poses like this one, as (lo, hi) of x, y and θ; None from a peer that
    says nothing of the kind.
    """

    name: str
    pose: tuple[float, float, float]
    box: tuple[tuple[float, float], ...] | None = None


Solve = Callable[[Sequence[Touch]], list[Answer]]


@dataclass(frozen=True)
class Peer:
    """A way to answer. `prepare` does what can be done before any contact; its time is not counted.

    `distributions`: what it is made of, whose versions the tables state.
    """

    prepare: Callable[[Sequence[Model]], Solve]
    distributions: tuple[str, ...]


def angle_between(turn: Any) -> Any:
    """An angle, or an array of them, in (−π, π]."""
    return math.pi - (math.pi - turn) % (2 * math.pi)


def write(problem: Problem, path: Path) -> None:
    """Write a problem as JSON."""
    path.write_text(json.dumps(asdict(problem)))


def read(path: Path) -> Problem:
    """Read a problem that `write` wrote."""
    found = json.loads(path.read_text())
    models = tuple(Model(item["name"], tuple(map(tuple, item["outline"]))) for item in found["models"])
    questions = tuple(
        tuple(
            Touch(
                start_mm=tuple(item["start_mm"]),
                centre_mm=tuple(item["centre_mm"]),
                radius_mm=item["radius_mm"],
                bound_mm=item["bound_mm"],
                normal_rad=tuple(item["normal_rad"]),
            )
            for item in touches
        )
        for touches in found["questions"]
    )
    return Problem(models, questions)
