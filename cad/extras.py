"""Packages that only some file formats need: imported when such a file is read, named if they are missing."""

import importlib
from typing import Any

from palpate.errors import InputError

__all__ = ["needed"]


def needed(module: str, extra: str, purpose: str) -> Any:
    """Import a module of an extra of this distribution; InputError says what to install if it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{purpose} needs {module}: pip install 'palpate[{extra}]'") from None
