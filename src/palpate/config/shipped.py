"""What ships inside the package: the emulated bench and the six object models. Works without any file."""

from importlib.resources import files
from importlib.resources.abc import Traversable

__all__ = ["SHIPPED_RIGS", "shipped_objects", "shipped_references", "shipped_rig"]

SHIPPED_RIGS = ("bench", "xm430-bench", "xl330-bench")
"""Rigs that ship with palpate; the first is used where no other is given."""


def shipped_rig(name: str = SHIPPED_RIGS[0]) -> Traversable:
    """Give one of `SHIPPED_RIGS`, else the emulated bench with three fingers; for `load_rig`."""
    return files("palpate.config").joinpath("rigs", f"{name}.toml")


def shipped_objects() -> Traversable:
    """Give the object models tr-1, tr-2, tr-3, grip, gator and hand; for `load_objects`."""
    return files("palpate.config").joinpath("objects", "memo.json")


def shipped_references() -> Traversable:
    """Give the references that calibration expects unless told otherwise; for `load_references`."""
    return files("palpate.config").joinpath("references", "standard.toml")
