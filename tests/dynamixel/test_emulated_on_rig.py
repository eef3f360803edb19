"""The servos that a rig file's `[emulation]` table turns into: their models and their baud rate."""

from pathlib import Path

import pytest
from firm_rig import firm_rig

from palpate.config import load_rig
from palpate.config.rig_tables import BUS_BAUDRATES
from palpate.drivers.dynamixel import Bus
from palpate.drivers.dynamixel.x_series import MODEL_NAMES
from palpate.drivers.transport.ports import open_port
from palpate.rig.emulated.devices import emulate, on_mock_wires


def pinged(rig_text: str, folder: Path) -> set[int]:
    """Model numbers of all servos of a rig."""
    path = folder / "rig.toml"
    path.write_text(rig_text)
    rig = load_rig(path)
    mock = on_mock_wires(emulate(rig, None, seed=1))
    bus = Bus(open_port(mock.urls[rig.bus.port], rig.bus.baudrate_bps), mock.clock, rig.bus.baudrate_bps)
    numbers = {bus.ping(s.dxl_id).model_number for finger in rig.fingers for s in finger.servos.values()}
    bus.close()
    return numbers


@pytest.mark.parametrize("number", MODEL_NAMES)
def test_the_rig_file_names_the_model(number: int, tmp_path: Path) -> None:
    text = firm_rig().read_text()
    assert pinged(text.replace("XM430-W350", MODEL_NAMES[number]), tmp_path) == {number}


@pytest.mark.parametrize("rate", BUS_BAUDRATES)
def test_servos_are_set_to_the_buss_rate(rate: int, tmp_path: Path) -> None:
    text = firm_rig().read_text()
    assert "baudrate_bps = 1000000" in text
    assert pinged(text.replace("baudrate_bps = 1000000", f"baudrate_bps = {rate}"), tmp_path) == {1020}
