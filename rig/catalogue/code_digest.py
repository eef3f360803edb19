"""Digest of the code that prepares catalogues, and of the libraries that it computes with.

What other code has prepared may be something else. A number that is raised by hand would be forgotten.
"""

import hashlib
import platform
import sys
from functools import cache
from importlib.resources import files

import numpy
import scipy
import shapely

__all__ = ["code_digest"]

_ROOMS = ("palpate.recognizer", "palpate.geometry")


@cache
def code_digest() -> str:
    """16 hexadecimal digits that change with every line of the recogniser, with libraries and the machine."""
    digest = hashlib.sha256()
    versions = (numpy.__version__, scipy.__version__, shapely.__version__, shapely.geos_version_string)
    digest.update(repr((*versions, sys.version_info[:2], platform.machine())).encode())
    for room in _ROOMS:
        for file in sorted(files(room).iterdir(), key=lambda item: item.name):
            if file.name.endswith(".py"):
                digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
