"""Contacts without errors of position, as tests state them."""

from palpate.base.geometry import Floats
from palpate.recognizer import Contact, Finger, NormalRange

__all__ = ["exact_contact"]


def exact_contact(
    name: str, radius_mm: float, start_mm: Floats, end_mm: Floats, normal_rad: float, half_rad: float
) -> Contact:
    """A touch at the end (2,) of a straight way, 10 mm up, with a normal to within `half_rad`."""
    return Contact(
        name,
        Finger(radius_mm, 10.0),
        True,
        (float(start_mm[0]), float(start_mm[1])),
        (float(end_mm[0]), float(end_mm[1])),
        0.0,
        NormalRange(normal_rad - half_rad, normal_rad + half_rad),
    )
