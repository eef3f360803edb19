"""Where an emulated part really was in a run, and that as an event of the session log.

An engine moves the part; a replay has none. So the log keeps what is compared with the answer.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

from pydantic import BaseModel, ValidationError

from palpate.base.errors import InputError
from palpate.config.fields import Number
from palpate.recognizer import Configuration
from palpate.rig.emulated.part_truth import PartTruth
from palpate.rig.emulated.scene import Placement
from palpate.rig.session.log_reader import SessionFile

__all__ = ["EVENT", "Truth", "recorded_truth"]

EVENT = "truth"


@dataclass(frozen=True, eq=False)
class Truth:
    """What lay on an emulated table, in the frame of the answers.

    `placement`: how it lay when the fingers had left. `at_measurement`: where it was when each grip's
    contacts were measured, None if that was not noted.
    """

    placement: Placement
    at_measurement: Sequence[Configuration] | None = None

    def values(self, part: PartTruth | None) -> dict[str, object]:
        """Values of the event; `part`: how the part moves, None if nothing moves it."""
        return {
            "object": self.placement.model.name,
            "state": self.placement.state.name,
            "configuration": self.placement.configuration,
            "at_measurement": self.at_measurement,
            "part": part and asdict(part) | {"slip_n": part.slip_n},
        }


class _ConfigurationText(BaseModel):
    x_mm: Number
    y_mm: Number
    theta_rad: Number

    def value(self) -> Configuration:
        return Configuration(self.x_mm, self.y_mm, self.theta_rad)


class _TruthText(BaseModel):
    configuration: _ConfigurationText
    at_measurement: list[_ConfigurationText]


def recorded_truth(file: SessionFile, placement: Placement) -> Truth | None:
    """The truth that a session's log holds; None if it was recorded before logs held it.

    `placement`: what lay on the table and where it was put. Raises InputError for an event that palpate does
    not write.
    """
    events = file.told(EVENT)
    if not events:
        return None
    try:
        text = _TruthText.model_validate(events[-1])
    except ValidationError:
        raise InputError(
            f'{file.path}: the event "{EVENT}" must have a configuration and the list at_measurement'
        ) from None
    at = text.configuration
    placement = replace(placement, x_mm=at.x_mm, y_mm=at.y_mm, theta_rad=at.theta_rad)
    return Truth(placement, [item.value() for item in text.at_measurement])
