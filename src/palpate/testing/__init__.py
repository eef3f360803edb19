"""Test kit for plug-ins: conformance suites, emulated devices in virtual time, a served rig.

Needs pytest: `pip install palpate[testing]`. `docs/adding-a-device.md` says how it is used; palpate's own
tests use it too.
"""

try:
    import pytest
except ImportError:
    raise ImportError("palpate.testing needs pytest: install the extra `testing`") from None

pytest.register_assert_rewrite("palpate.testing.conformance")

from palpate.drivers.transport import VirtualClock  # noqa: E402 - asserts are rewritten first
from palpate.testing.conformance import (  # noqa: E402
    ArrayBench,
    ArrayConformance,
    FreeRunningConformance,
    RigConformance,
    ServoConformance,
    rig_with_arrays,
    served,
)
from palpate.testing.stream_fuzz import FuzzTally, StreamDecoder, fuzz  # noqa: E402

__all__ = [
    "ArrayBench",
    "ArrayConformance",
    "FreeRunningConformance",
    "FuzzTally",
    "RigConformance",
    "ServoConformance",
    "StreamDecoder",
    "VirtualClock",
    "fuzz",
    "rig_with_arrays",
    "served",
]
