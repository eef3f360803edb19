"""Digest of the code, and of the libraries, that something which is kept was computed with.

Other code may compute something else. A version that is raised by hand would be forgotten.
"""

import hashlib
import platform
import sys
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable

import numpy
import scipy
import shapely

__all__ = ["code_digest", "source_digest"]


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


@cache
def source_digest(*packages: str, compiled: bool) -> str:
    """16 hexadecimal digits that change with every line of packages and those within them, nothing else.

    `compiled`: also with what has been compiled for them.
    """
    digest, suffixes = hashlib.sha256(), (".py", ".so") if compiled else (".py",)
    for package in packages:
        for place, file in _files(files(package), package):
            if place.endswith(suffixes):
                digest.update(place.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _files(folder: Traversable, place: str) -> Iterator[tuple[str, Traversable]]:
    for item in sorted(folder.iterdir(), key=lambda item: item.name):
        inside = f"{place}/{item.name}"
        if item.is_dir():
            yield from _files(item, inside)
        else:
            yield inside, item
