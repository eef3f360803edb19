"""Kinds of wheels that `make wheel` builds; without PALPATE_WHEEL it is built as pyproject.toml says."""

import os
from typing import Any

from setuptools import Distribution, setup

KIND = os.environ.get("PALPATE_WHEEL", "")
"""pure: without the compiled kernel, for any system. stable: with it, for this and all newer Pythons."""
OLDEST = 3, 11


class WheelDistribution(Distribution):
    """A distribution whose kernel is left out, or keeps to Python's stable ABI."""

    def has_ext_modules(self) -> bool:
        """Return whether anything is compiled."""
        return KIND != "pure" and bool(super().has_ext_modules())

    def parse_config_files(self, *args: Any, **options: Any) -> None:
        """Read pyproject.toml, and add what the stable ABI needs."""
        super().parse_config_files(*args, **options)
        if KIND == "stable":
            for module in self.ext_modules:
                module.py_limited_api = True
                module.define_macros.append(("Py_LIMITED_API", f"0x{OLDEST[0]:02X}{OLDEST[1]:02X}0000"))
                module.extra_compile_args.append("-Werror=implicit-function-declaration")
            wheel = self.get_option_dict("bdist_wheel")
            wheel["py_limited_api"] = (__file__, f"cp{OLDEST[0]}{OLDEST[1]}")


setup(distclass=WheelDistribution)
