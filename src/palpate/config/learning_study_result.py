"""Result of `palpate objects study-learning`, format `palpate/learning-study@1`."""

from typing import Literal

from palpate.config.fields import Out, Rounded


class LearningStepOut(Out):
    """Tolerance (mm) that was reached with so many touches, after so much of the rig's time."""

    touches: int
    rig_seconds: Rounded
    tolerance: Rounded


class LearningRunOut(Out):
    """One simulated learning of a part: what lay there, what it took, and how finely it is known.

    `tolerance` (mm): of the model at the end, null if there is none. `touches`: those that met the part.
    `inside_bounds`: the true outline lies between the bounds, and within the tolerance of the model.
    `falling`: each tolerance that was finer than all before it.
    """

    number: int
    object: str
    state: str
    grips: int
    touches: int
    rig_seconds: Rounded
    tolerance: Rounded | None
    goal_met: bool
    inside_bounds: bool
    falling: tuple[LearningStepOut, ...]


class ToleranceCostOut(Out):
    """Cost of a tolerance (mm): `runs` that reached it; touches and seconds of these until then, the median.

    Null where none reached it.
    """

    tolerance: Rounded
    runs: int
    touches: Rounded | None
    rig_seconds: Rounded | None


class LearningStudyOut(Out):
    """Findings of a study of learning. `goal`: the tolerance (mm) that was asked for.

    `height` (mm): of the parts, as it is given to `learn`. `max_seconds`: rig time after which a run ends.
    `placed_within` (mm): parts' centres of area lie within it round the middle of the workspace. `outside`:
    runs whose truth is not inside the bounds. `seconds`: taken now.
    """

    format: Literal["palpate/learning-study@1"] = "palpate/learning-study@1"
    units: Literal["mm"] = "mm"
    objects: str
    rig: str
    height: Rounded
    goal: Rounded
    max_seconds: Rounded
    placed_within: Rounded
    seed: int
    outside: int
    costs: tuple[ToleranceCostOut, ...]
    runs: tuple[LearningRunOut, ...]
    seconds: Rounded
