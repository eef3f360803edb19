"""The rig of tests that are not about parts which slide: quick touches, and an emulated part that stands."""

from pathlib import Path

from repository import EXAMPLES

__all__ = ["firm_rig"]


def firm_rig() -> Path:
    """Its rig file."""
    return EXAMPLES / "firm-rig.toml"
