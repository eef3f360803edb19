"""Notices for the operator of a script: Python's warnings, which every caller can silence or collect."""

import warnings

__all__ = ["RigWarning", "warning"]


class RigWarning(UserWarning):
    """Something about a run that the operator should know and that does not stop it."""


def warning(text: str) -> None:
    """Warn with `text`."""
    warnings.warn(text, RigWarning, stacklevel=2)
