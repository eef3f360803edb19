"""Optional packages (extras): imported when first used, and named in the error if they are missing."""

import importlib
import json
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from palpate.base.errors import InputError, MissingPackageError


def import_extra(module: str, extra: str, purpose: str) -> Any:
    """Import a module of an extra of this distribution.

    Raises MissingPackageError, which says what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingPackageError(f"{purpose} needs {module}: {install_command(extra)}") from None


def install_command(extra: str) -> str:
    """Command that installs an extra where this interpreter finds palpate, be it from its checkout."""
    checkout = _checkout()
    what = "palpate" if checkout is None else _from_here(checkout)
    how = "" if checkout is None else "-e "
    return f"{shlex.quote(_from_here(Path(sys.executable)))} -m pip install {how}'{what}[{extra}]'"


def _checkout() -> Path | None:
    """Folder from which palpate is installed as it stands there; None for a wheel (PEP 610)."""
    try:
        told = json.loads(distribution("palpate").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        return None
    editable = told.get("dir_info", {}).get("editable", False)
    return Path(url2pathname(urlsplit(told["url"]).path)) if editable else None


def _from_here(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


@contextmanager
def input_errors(path: Path, kind: str) -> Iterator[None]:
    """While another package reads a file: whatever it raises about a damaged one becomes an InputError."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as problem:
        detail = " ".join(str(problem).split())
        told = f" ({detail:.200})" if detail else ""
        raise InputError(f"{path}: is no readable {kind} file{told}; save it as {kind} anew") from None
