"""Packages that only some file formats need: imported when such a file is read, named if they are missing."""

import importlib
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palpate.errors import InputError

__all__ = ["MissingPackageError", "install_command", "needed", "readable"]


class MissingPackageError(InputError):
    """A package of an extra is not installed: nothing is said of the file."""


def needed(module: str, extra: str, purpose: str) -> Any:
    """Import a module of an extra of this distribution.

    Raises MissingPackageError, which says what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingPackageError(f"{purpose} needs {module}: {install_command(extra)}") from None


def install_command(extra: str) -> str:
    """What installs an extra where this interpreter finds palpate."""
    python = Path(sys.executable)
    here = Path.cwd()
    shown = python.relative_to(here) if python.is_relative_to(here) else python
    return f"{shlex.quote(str(shown))} -m pip install 'palpate[{extra}]'"


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """While another package reads a file: whatever it raises about a damaged one becomes an InputError."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as problem:
        detail = " ".join(str(problem).split()) or type(problem).__name__
        raise InputError(
            f"{path}: is no readable {kind} file ({detail:.200}); save it as {kind} anew"
        ) from None
