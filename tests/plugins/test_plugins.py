"""Plug-ins of arrays and servos, and their page."""

import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from palpate.base.extensions import SERVO_MODELS, TACTILE_ARRAYS
from palpate.plugins import MotorConstants, ServoSpecification, TableItem, table_of
from palpate.testing import ArrayConformance, ServoConformance, rig_with_arrays
from support.benches.rigs import firm_rig
from support.commands.command import Here
from support.commands.repository import EXAMPLES, ROOT, install

# ----------------------------------------------------------------------------------------------------
# Arrays of other distributions: found by entry point; exit code 2 and one clear line where they fail.

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


def test_a_rig_whose_arrays_come_by_plug_in_passes_its_check(folder: Path, here: Here) -> None:
    install(folder, "palpate-line-array", TACTILE_ARRAYS, {"lines": "line_array:LINES"})
    rig = rig_with_arrays(folder, "lines", {"counts_per_n": 2000.0}, rate_hz=100.0)
    done = here("check", "--rig", rig, "--json")
    assert done.code == 0, done.err
    assert {(array["protocol"], array["firmware"]) for array in done.json["arrays"]} == {("lines", "lines 1")}


@pytest.mark.slow
def test_the_example_identifies_a_part_on_the_emulated_bench(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    install(folder, "palpate-line-array", TACTILE_ARRAYS, {"lines": "line_array:LINES"})
    runpy.run_path(str(EXAMPLE / "identify.py"))
    assert "<Answer identified: " in capsys.readouterr().out


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_plug_in_is_one_line_that_names_its_distribution(
    name: str, folder: Path, here: Here
) -> None:
    target, reason = BROKEN[name]
    (folder / "raising_plugin.py").write_text("1 / 0\n", encoding="utf-8")
    (folder / "half_plugin.py").write_text(
        "from palpate.config import ArrayConfig\nclass ARRAY:\n    config = ArrayConfig\n", encoding="utf-8"
    )
    install(folder, "some-arrays", TACTILE_ARRAYS, {name: target})
    done = here("check", "--rig", rig_with_arrays(folder, name, {}))
    sys.modules.pop("half_plugin", None)
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    for words in (f'"{name}"', "some-arrays 1.0", reason, "update or uninstall"):
        assert words in done.err


def test_two_distributions_that_add_one_name_are_both_named(folder: Path, here: Here) -> None:
    for distribution in ("some-arrays", "other-arrays"):
        install(folder, distribution, TACTILE_ARRAYS, {"lines": "line_array:LINES"})
    done = here("check", "--rig", rig_with_arrays(folder, "lines", {}))
    assert done.code == 2
    assert all(words in done.err for words in ("some-arrays 1.0", "other-arrays 1.0", "uninstall one"))


def test_plug_ins_are_not_looked_at_where_only_built_in_devices_are_named(folder: Path, here: Here) -> None:
    install(folder, "some-arrays", TACTILE_ARRAYS, {"palpate": "no_such_module:ARRAY"})
    assert here("check", "--rig", rig_with_arrays(folder, "palpate", {})).code == 0


# ----------------------------------------------------------------------------------------------------
# Servo models: built-in ones pass the suite of plug-ins; others are found by entry point.

HERE = Path(__file__).resolve().parent
NUMBER = 64_999  # no model has it


def items(firmware: int) -> list[TableItem]:
    """An XC330-M288's table under another model number."""
    return [
        replace(item, default=NUMBER) if item.name == "Model Number" else item
        for item in table_of(1240, firmware)
    ]


INVENTED = ServoSpecification(
    name="XZ330-M999",
    number=NUMBER,
    items=items,
    firmware=52,
    extended_firmware=46,
    nominal_v=5.0,
    brown_out_v=2.5,
    current_unit_a=1e-3,
    motor=MotorConstants(0.8, 1.6, 9.0, 1.0e-3, 0.01),
)


class TestXM430(ServoConformance):
    model = "XM430-W350"


class TestXL330(ServoConformance):
    model = "XL330-M288"


class TestXC330(ServoConformance):
    model = "XC330-M288"


@pytest.fixture
def servo_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(HERE)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def rig_with(model: str) -> Path:
    file = Path("rig.toml")
    file.write_text(firm_rig().read_text(encoding="utf-8").replace("XM430-W350", model), encoding="utf-8")
    return file


class TestInvented(ServoConformance):
    model = "XZ330-M999"

    @pytest.fixture(autouse=True)
    def _installed(self, servo_folder: Path) -> None:
        install(servo_folder, "some-servos", SERVO_MODELS, {self.model: "test_plugins:INVENTED"})


def test_a_rig_whose_servos_come_by_plug_in_passes_its_check(servo_folder: Path, here: Here) -> None:
    install(servo_folder, "some-servos", SERVO_MODELS, {"XZ330-M999": "test_plugins:INVENTED"})
    done = here("check", "--rig", rig_with("XZ330-M999"), "--json")
    assert done.code == 0, done.err
    assert "XZ330-M999" in done.out


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (None, ['"XM430-W350"', "install", SERVO_MODELS]),
        ("no_such_module:SERVO", ["some-servos 1.0", "no_such_module", "uninstall"]),
        ("pathlib:Path", ["some-servos 1.0", "not a ServoSpecification", "uninstall"]),
    ],
)
def test_unknown_and_broken_models_are_one_line(
    target: str | None, words: list[str], servo_folder: Path, here: Here
) -> None:
    if target is not None:
        install(servo_folder, "some-servos", SERVO_MODELS, {"XZ330-M999": target})
    done = here("check", "--rig", rig_with("XZ330-M999"))
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    for word in ('"XZ330-M999"', *words):
        assert word in done.err


# ----------------------------------------------------------------------------------------------------
# docs/adding-a-device.md: its links lead somewhere, and its programs are those of the example.

PAGE = ROOT / "docs" / "adding-a-device.md"
TEXT = PAGE.read_text(encoding="utf-8")


def lines_of(text: str) -> str:
    """Its lines without indentation and blank lines: a formatter may have changed them on the page."""
    return "\n".join(line.strip() for line in text.splitlines() if line.strip())


def test_programs_on_the_page_are_those_of_the_example() -> None:
    example = EXAMPLES / "array_plugin"
    files = [path.read_text(encoding="utf-8") for path in (*example.rglob("*.py"), *example.glob("*.toml"))]
    blocks = re.findall(r"```(?:python|toml)\n(.*?)```", TEXT, re.DOTALL)
    assert len(blocks) >= 3
    for block in blocks:
        assert any(lines_of(block) in lines_of(text) for text in files), block


def test_links_and_names_on_the_page_lead_somewhere() -> None:
    for name in re.findall(r"`((?:drivers|config|docs|rig|tests|examples|plugins|testing)/[\w/.-]+)`", TEXT):
        assert (ROOT / name).exists(), name
    for link in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (PAGE.parent / link).exists(), link
