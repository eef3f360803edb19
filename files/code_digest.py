"""Digest of the code, and of the libraries, that something which is kept was computed with.

Other code may compute something else. A version that is raised by hand would be forgotten.
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


@cache
def code_digest(*packages: str) -> str:
    """16 hexadecimal digits that change with every line of some packages, with libraries and the machine."""
    digest = hashlib.sha256()
    versions = (numpy.__version__, scipy.__version__, shapely.__version__, shapely.geos_version_string)
    digest.update(repr((*versions, sys.version, platform.machine())).encode())
    for package in packages:
        for file in sorted(files(package).iterdir(), key=lambda item: item.name):
            if file.name.endswith(".py"):
                digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
