"""The recogniser without its compiled kernel, for a while: the kernel has to match what numpy computes."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from palpate.recognizer.compiled import KERNEL

__all__ = ["needs_kernel", "without_kernel"]

needs_kernel = pytest.mark.skipif(KERNEL is None, reason="the compiled kernel is not built, or is off")


@contextmanager
def without_kernel(*modules: str) -> Iterator[None]:
    """These modules of the recogniser compute with numpy alone; all of them if none is named.

    Then catalogues are not to be shared with the outside: what they keep for the kernel would be missing.
    """
    found = {
        name.removeprefix("palpate.recognizer."): module
        for name, module in list(sys.modules.items())
        if name.startswith("palpate.recognizer.") and hasattr(module, "KERNEL")
    }
    users = [found[name] for name in modules or found]
    before = [module.KERNEL for module in users]
    try:
        for module in users:
            module.KERNEL = None
        yield
    finally:
        for module, kernel in zip(users, before, strict=True):
            module.KERNEL = kernel
