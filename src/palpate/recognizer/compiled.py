"""Compiled kernel: C code for the innermost loops, where it could be built; numpy does the same without it.

`KERNEL` is None where there was no C compiler, or where the environment variable `PALPATE_KERNEL` is `off`.
See docs/adr/0038-a-compiled-kernel.md.
"""

import os
from importlib import import_module
from types import ModuleType

__all__ = ["KERNEL"]


def _kernel() -> ModuleType | None:
    if os.environ.get("PALPATE_KERNEL") == "off":
        return None
    try:
        return import_module("palpate.recognizer._kernel")
    except ImportError:
        return None


KERNEL = _kernel()
"""The compiled module, or None."""
