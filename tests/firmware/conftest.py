"""The programs of `firmware/`, built once."""

from pathlib import Path

import pytest

from support.devices.firmware import build_firmware


@pytest.fixture(scope="session")
def built() -> Path:
    """Folder with the host programs, the bench and the fuzzer."""
    return build_firmware()
