"""Parametrised cases of which `make test` runs a sample and `make campaign` the rest."""

from collections.abc import Iterable
from typing import Any

import pytest


def sample(cases: Iterable[Any], kept: Iterable[Any]) -> list[Any]:
    """All cases, in order; those that are not among `kept` are marked as part of the campaign."""
    every, held = list(cases), list(kept)
    assert all(item in every for item in held)
    return [case if case in held else _left_to_campaign(case) for case in every]


def _left_to_campaign(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.campaign)
