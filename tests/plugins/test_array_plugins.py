"""Arrays of other distributions: found by entry point; exit code 2 and one clear line where they fail."""

import sys
from pathlib import Path

import pytest
from command import run_here
from plugin_folder import install
from repository import EXAMPLES

from palpate.base.extensions import TACTILE_ARRAYS
from palpate.testing import ArrayConformance, rig_with_arrays

EXAMPLE = EXAMPLES / "array_plugin"
BROKEN = {
    "absent": ("no_such_module:ARRAY", "no_such_module"),
    "nameless": ("line_array:NOTHING", "NOTHING"),
    "other": ("pathlib:Path", "subclass of ArrayConfig"),
    "raising": ("raising_plugin:ARRAY", "ZeroDivisionError"),
    "half": ("half_plugin:ARRAY", "not an ArrayPlugin"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where distributions can be installed, beside the example's package."""
    monkeypatch.chdir(tmp_path)
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(EXAMPLE)
    monkeypatch.syspath_prepend(site)
    return site


class TestExample(ArrayConformance):
    protocol = "lines"
    keys = {"counts_per_n": 1000.0}

    @pytest.fixture(autouse=True)
    def _installed(self, folder: Path) -> None:
        install(folder, "palpate-line-array", TACTILE_ARRAYS, {"lines": "line_array:LINES"})


def test_a_rig_whose_arrays_come_by_plug_in_passes_its_check(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(folder, "palpate-line-array", TACTILE_ARRAYS, {"lines": "line_array:LINES"})
    rig = rig_with_arrays(folder, "lines", {"counts_per_n": 2000.0}, rate_hz=100.0)
    done = run_here(["check", "--rig", rig, "--json"], monkeypatch, capsys)
    assert done.code == 0, done.err
    assert {(array["protocol"], array["firmware"]) for array in done.json["arrays"]} == {("lines", "lines 1")}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_plug_in_is_one_line_that_names_its_distribution(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    target, reason = BROKEN[name]
    (folder / "raising_plugin.py").write_text("1 / 0\n", encoding="utf-8")
    (folder / "half_plugin.py").write_text(
        "from palpate.config import ArrayConfig\nclass ARRAY:\n    config = ArrayConfig\n", encoding="utf-8"
    )
    install(folder, "some-arrays", TACTILE_ARRAYS, {name: target})
    done = run_here(["check", "--rig", rig_with_arrays(folder, name, {})], monkeypatch, capsys)
    sys.modules.pop("half_plugin", None)
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    for words in (f'"{name}"', "some-arrays 1.0", reason, "update or uninstall"):
        assert words in done.err


def test_two_distributions_that_add_one_name_are_both_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for distribution in ("some-arrays", "other-arrays"):
        install(folder, distribution, TACTILE_ARRAYS, {"lines": "line_array:LINES"})
    done = run_here(["check", "--rig", rig_with_arrays(folder, "lines", {})], monkeypatch, capsys)
    assert done.code == 2
    assert all(words in done.err for words in ("some-arrays 1.0", "other-arrays 1.0", "uninstall one"))


def test_plug_ins_are_not_looked_at_where_only_built_in_devices_are_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(folder, "some-arrays", TACTILE_ARRAYS, {"palpate": "no_such_module:ARRAY"})
    assert run_here(["check", "--rig", rig_with_arrays(folder, "palpate", {})], monkeypatch, capsys).code == 0
