"""`palpate schema`: what is printed is what is shipped, and editors find it."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Ended, run_here
from repository import PACKAGE

from palpate.config.schema import FORMATS

Here = Callable[..., Ended]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(list(args), monkeypatch, capsys)


def test_all_names_are_listed(here: Here) -> None:
    assert here("schema").out.split() == sorted(FORMATS)


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_what_is_printed_is_what_is_shipped(here: Here, name: str) -> None:
    shipped = (PACKAGE / "config" / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8")
    ended = here("schema", name)
    assert (ended.code, ended.out) == (0, shipped)


def test_it_is_written_beside_a_rig_file(here: Here, tmp_path: Path) -> None:
    assert here("schema", "rig", "--out", "rig.schema.json").code == 0
    assert json.loads((tmp_path / "rig.schema.json").read_text())["title"]


def test_an_unknown_name_is_refused_with_those_that_there_are(here: Here) -> None:
    ended = here("schema", "rigg")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert 'there is no format "rigg"' in ended.err
    assert "rig, scan" in ended.err
    assert here("schema", "--out", "x.json").code == 2
