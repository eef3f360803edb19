"""What `check` passes, runs: files drawn over the whole schema (`benchmarks/bench_rig_files.py`: 2,000)."""

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from support.campaign.rig_files import Table, changed_files, fate, rig_files, shipped_files

FEW = settings(max_examples=2, suppress_health_check=list(HealthCheck), phases=[Phase.generate])
SOME = settings(FEW, max_examples=8)


@FEW
@given(rig_files())
def test_a_drawn_file_is_refused_in_one_line_or_run_to_an_end(table: Table) -> None:
    assert fate(table).kind


@pytest.mark.campaign
@SOME
@given(rig_files())
def test_so_is_each_of_some_more(table: Table) -> None:
    assert fate(table).kind


@FEW
@given(changed_files(shipped_files()))
def test_so_is_a_shipped_file_with_one_number_changed(table: Table) -> None:
    assert fate(table).kind


@pytest.mark.campaign
@SOME
@given(changed_files(shipped_files()))
def test_so_are_some_more_with_one_number_changed(table: Table) -> None:
    assert fate(table).kind
