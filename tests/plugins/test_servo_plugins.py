"""Servo models: built-in ones pass the suite of plug-ins; others are found by entry point."""

from dataclasses import replace
from pathlib import Path

import pytest
from command import run_here
from firm_rig import firm_rig
from plugin_folder import install

from palpate.base.extensions import SERVO_MODELS
from palpate.plugins import MotorConstants, ServoSpecification, TableItem, table_of
from palpate.testing import ServoConformance

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
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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
    def _installed(self, folder: Path) -> None:
        install(folder, "some-servos", SERVO_MODELS, {self.model: "test_servo_plugins:INVENTED"})


def test_a_rig_whose_servos_come_by_plug_in_passes_its_check(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(folder, "some-servos", SERVO_MODELS, {"XZ330-M999": "test_servo_plugins:INVENTED"})
    done = run_here(["check", "--rig", rig_with("XZ330-M999"), "--json"], monkeypatch, capsys)
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
    target: str | None,
    words: list[str],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if target is not None:
        install(folder, "some-servos", SERVO_MODELS, {"XZ330-M999": target})
    done = run_here(["check", "--rig", rig_with("XZ330-M999")], monkeypatch, capsys)
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    for word in ('"XZ330-M999"', *words):
        assert word in done.err
