"""Known heights: refuses objects whose sections are not known where fingers touch.

An object that was imported near some heights only has nothing at others, as far as its sections say. A finger
there would take it for free space, so such a pair is refused before anything is recognised or moved.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from palpate.config.objects_checks import heights_in_words
from palpate.errors import InputError
from palpate.geometry import ObjectModel
from palpate.recognizer import Contact

__all__ = ["FingerAtHeight", "HasHeight", "check_known", "fingers_of"]


class HasHeight(Protocol):
    """A finger: how it is called, and its tip's height above the support plane."""

    @property
    def name(self) -> str:
        """As in messages."""
        ...

    @property
    def height_mm(self) -> float:
        """Of the tip's middle."""
        ...


@dataclass(frozen=True)
class FingerAtHeight:
    """A finger of which only contacts are known."""

    name: str
    height_mm: float


def fingers_of(contacts: Iterable[Contact]) -> list[FingerAtHeight]:
    """The fingers that made contacts, once for each of their heights."""
    return list(dict.fromkeys(FingerAtHeight(item.name, item.finger.height_mm) for item in contacts))


def check_known(objects: Iterable[ObjectModel], fingers: Sequence[HasHeight]) -> None:
    """Raise InputError for the first state whose sections are not known at the height of some finger."""
    for model in objects:
        for state in model.states:
            finger = next((item for item in fingers if not state.known_at(item.height_mm)), None)
            if finger is None:
                continue
            wanted = ",".join(f"{height:g}" for height in sorted({item.height_mm for item in fingers}))
            raise InputError(
                f'object "{model.name}", state "{state.name}" is known at heights '
                f"{heights_in_words(state.heights_mm or ())} only; finger {finger.name} is at "
                f"{finger.height_mm:g} mm: import it again for heights {wanted}"
            )
