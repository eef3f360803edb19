"""The hardware tests without a checkout; arguments are those of pytest and of the plugin."""

import sys

import pytest

_IMPORTED = "ignore:Module already imported:pytest.PytestAssertRewriteWarning"
"""This module is of the package whose plug-in pytest would rewrite."""
_HOW = (
    "-p",
    "palpate.testing.hardware.plugin",
    "--import-mode=importlib",
    "--tb=short",
    "-ra",
    "-W",
    _IMPORTED,
)

if __name__ == "__main__":
    sys.exit(pytest.main([*_HOW, "--pyargs", "palpate.testing.hardware", *sys.argv[1:]]))
