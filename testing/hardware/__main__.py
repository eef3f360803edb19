"""The hardware tests without a checkout; arguments are those of pytest and of the plugin."""

import sys

import pytest

sys.exit(
    pytest.main(
        [
            "-p",
            "palpate.testing.hardware.plugin",
            "--import-mode=importlib",
            "--tb=short",
            "-ra",
            "--pyargs",
            "palpate.testing.hardware",
            *sys.argv[1:],
        ]
    )
)
