"""Pytest plug-in for other projects: the fixture `palpate_rig`, an emulated bench. Loaded by its entry point.

It adds no options and hooks into nothing but the list of markers; palpate is loaded when the fixture is used.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from palpate.jobs.rig import Rig


def pytest_configure(config: pytest.Config) -> None:
    """Tell pytest of the marker."""
    config.addinivalue_line(
        "markers",
        "palpate_rig(seed=0, file=None): of the fixture palpate_rig: what its emulated bench draws, and the "
        "rig file, as seen from the test's folder; None: the bench that comes with palpate",
    )


@pytest.fixture
def palpate_rig(request: pytest.FixtureRequest) -> "Iterator[Rig]":
    """Emulated rig, as `palpate.open_rig` opens it; `@pytest.mark.palpate_rig(seed=7)` chooses its part."""
    from palpate.jobs.rig import open_rig  # noqa: PLC0415  # only tests that use it wait for it

    mark = request.node.get_closest_marker("palpate_rig")
    options = {"seed": 0, "file": None} | ({} if mark is None else dict(mark.kwargs))
    if set(options) > {"seed", "file"} or (mark is not None and mark.args):
        pytest.fail("palpate_rig(seed=..., file=...): the marker has these two, by name")
    file = options["file"]
    with open_rig(None if file is None else request.path.parent / file, seed=options["seed"]) as rig:
        if not rig.emulated:
            pytest.fail(f"{file}: has real ports; the fixture palpate_rig is for emulated rigs")
        yield rig
