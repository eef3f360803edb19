"""Do decisive grips decide? Every one is carried out for every hypothesis, at samples of its region.

Shared by tests/recognizer/test_plans.py and benchmarks/check_plans.py. A trial depends on (seed, index)
only. The grip's outcomes come from shapely, with errors as large as they may be; what they leave is the
recogniser's answer. A grip that is called decisive must leave one class, whatever happened.
"""

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from palpate.base.geometry import ObjectModel
from palpate.config import load_rig
from palpate.recognizer import (
    Catalogue,
    Contact,
    Grip,
    Hypothesis,
    Recognition,
    plan_grip,
    recognise,
    twins,
    used_approaches,
)
from palpate.rig.conversion import goals_of
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.exploration import exploring_grip
from palpate.rig.reach.approaches import Reach, reach_of
from support.benches.rigs import firm_rig
from support.oracles.plans import SimulatedTouches, as_predicted
from support.oracles.shapely_touches import Placed, outlines, place_within, placed_as, turned

_MOST_HYPOTHESES = 40


@dataclass(frozen=True, eq=False)
class Trial:
    """A first grip, what it left, and the grip that was planned next."""

    index: int
    placed: Placed
    recognition: Recognition
    grip: Grip


@dataclass(frozen=True)
class Finding:
    """What carrying out a decisive grip came to.

    `undecided`: outcomes after which more than one class was left; `unforeseen`: touches outside of their
    predictions.
    """

    index: int
    hypotheses: int
    outcomes: int
    undecided: int
    unforeseen: int


@cache
def reach() -> Reach:
    """Of the shipped rig."""
    return reach_of(load_rig(firm_rig()))


@cache
def models_of(path: Path) -> dict[str, ObjectModel]:
    """By name."""
    return {model.name: model for model in outlines(path)}


@cache
def catalogue_of(path: Path) -> Catalogue:
    """Built once in each process."""
    return Catalogue(list(models_of(path).values()))


def first_contacts(
    placed: Placed, rng: np.random.Generator, half_range: float = math.radians(10.0)
) -> list[Contact]:
    """What the first grip of a search feels: every finger goes to the table's middle."""
    touches = SimulatedTouches(reach(), placed, rng, half_range)(exploring_grip(reach(), []))
    return [touch.contact for touch in touches]


def drawn(path: Path, seed: int, index: int) -> Trial | None:
    """Trial `index`; None if its first grip leaves one hypothesis, none or many, or no plan is decisive."""
    rng = np.random.default_rng((seed, index))
    models = list(models_of(path).values())
    placed = place_within(models[int(rng.integers(len(models)))], rng)
    rig = load_rig(firm_rig())
    contacts = first_contacts(placed, rng)
    if not any(contact.touched for contact in contacts):
        return None
    found = recognise(catalogue_of(path), contacts)
    if not 2 <= len(found.hypotheses) <= _MOST_HYPOTHESES:
        return None
    grip = plan_grip(
        found, reach(), resolution_of(rig), goals_of(rig), used_approaches(contacts, reach().approaches)
    )
    return Trial(index, placed, found, grip) if grip is not None and grip.decisive else None


def checked(path: Path, trial: Trial, seed: int, samples: int) -> Finding:
    """Carry the grip out for every hypothesis, at its own configuration and at `samples` of its region."""
    rng = np.random.default_rng((seed, trial.index, 1))
    found, grip = trial.recognition, trial.grip
    rig = load_rig(firm_rig())
    same = twins(found, reach(), resolution_of(rig))
    outcomes = undecided = unforeseen = 0
    for number, hypothesis in enumerate(found.hypotheses):
        model = models_of(path)[hypothesis.state.object_name]
        for sample, pose in enumerate(poses_in(found, hypothesis, model, rng, samples)):
            touches = SimulatedTouches(
                reach(), pose, rng, resolution_of(rig).normal_half_rad, share=1.0, at_bound=sample % 2 == 0
            )(grip.limited_approaches)
            left = found.extend([touch.contact for touch in touches]).hypotheses
            classes = {k for item in left for k, old in enumerate(found.hypotheses) if came_from(item, old)}
            outcomes += 1
            undecided += not all(same[number, k] for k in classes)
            for row, touch in enumerate(touches):
                unforeseen += not as_predicted(touch.contact, grip.predictions.of(row, number), 1e-6)
    return Finding(trial.index, len(found.hypotheses), outcomes, undecided, unforeseen)


def poses_in(
    recognition: Recognition, item: Hypothesis, model: ObjectModel, rng: np.random.Generator, count: int
) -> list[Placed]:
    """The hypothesis's configuration, and others in its cells: corners and mixtures of corners."""
    poses = [replace(placed_as(item), model=model)]
    for row in rng.integers(0, len(item.cells), count):
        corners = item.cells.polygon[row]
        position = rng.dirichlet(np.full(len(corners), 0.3)) @ corners
        theta = rng.choice([item.cells.lo[row], item.cells.hi[row], item.cells.middle[row]])
        x, y = recognition.anchor_mm + turned(position - item.state.origin_mm, theta)
        poses.append(Placed(model, float(x), float(y), float(theta)))
    return poses


def came_from(item: Hypothesis, old: Hypothesis) -> bool:
    """Whether some of what is left of a search lies in the region of an earlier hypothesis."""
    if item.state_index != old.state_index:
        return False
    order = old.state.symmetry_order
    turn = 2 * math.pi / order
    off = (item.configuration.theta_rad - sum(old.bounds.theta_rad) / 2 + turn / 2) % turn - turn / 2
    if abs(off) > old.bounds.orientation_half_rad + 1e-6:
        return False
    if order > 1:
        return True
    return all(
        lo - 1e-6 <= value <= hi + 1e-6
        for value, (lo, hi) in (
            (item.configuration.x_mm, old.bounds.x_mm),
            (item.configuration.y_mm, old.bounds.y_mm),
        )
    )
