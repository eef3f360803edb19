"""A plan as a picture."""

from palpate.rig.next_grip import Planned

__all__ = ["plan_picture"]


def plan_picture(planned: Planned, title: str) -> str:
    """SVG."""
    return ""
