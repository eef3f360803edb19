"""What is told of serial ports, from folders as Linux has them."""

import os
from pathlib import Path

from serial.tools.list_ports_common import ListPortInfo

from palpate.drivers.transport.ports import describe_ports, serial_ports


def info(device: Path, **known: object) -> ListPortInfo:
    found = ListPortInfo(str(device))
    for name, value in known.items():
        setattr(found, name, value)
    return found


def test_an_adapter_with_everything_that_linux_tells(tmp_path: Path) -> None:
    device, other = tmp_path / "dev" / "ttyUSB7", tmp_path / "dev" / "ttyS0"
    by_id = tmp_path / "by-id" / "usb-FTDI_USB__-__Serial_Converter_FT3WHRKK-if00-port0"
    timer = tmp_path / "tty" / "ttyUSB7" / "device" / "latency_timer"
    process = tmp_path / "proc" / "4711"
    for folder in (device.parent, by_id.parent, timer.parent, process / "fd"):
        folder.mkdir(parents=True)
    device.touch()
    other.touch()
    by_id.symlink_to(device)
    timer.write_text("16\n")
    (process / "comm").write_text("screen\n")
    (process / "fd" / "3").symlink_to(device)
    (tmp_path / "proc" / "self").mkdir()
    usb = {
        "vid": 0x0403,
        "pid": 0x6014,
        "serial_number": "FT3WHRKK",
        "description": "USB <-> Serial Converter",
    }
    plain, adapter = describe_ports(
        [info(device, **usb), info(other)], by_id.parent, tmp_path / "tty", tmp_path / "proc"
    )
    assert adapter.name == str(by_id)
    assert adapter.kind == "FTDI FT232H, as in ROBOTIS U2D2"
    assert (adapter.usb_ids, adapter.serial_number) == ((0x0403, 0x6014), "FT3WHRKK")
    assert adapter.latency_timer_s == 0.016
    assert adapter.used_by == "screen (process 4711)"
    assert plain.name == str(other)
    assert (plain.kind, plain.usb_ids, plain.by_id, plain.latency_timer_s, plain.used_by) == (None,) * 5


def test_folders_that_are_not_there(tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    device.touch()
    gone = tmp_path / "gone"
    (port,) = describe_ports([info(device)], gone, gone, gone)
    assert port.name == str(device)
    assert port.permitted


def test_a_port_that_is_gone_again_is_not_permitted(tmp_path: Path) -> None:
    (port,) = describe_ports([info(tmp_path / "ttyUSB0")], tmp_path, tmp_path, tmp_path)
    assert not port.permitted


def test_this_computers_ports_can_be_listed() -> None:
    names = [port.device for port in serial_ports()]
    assert names == sorted(names)
    assert all(os.path.exists(name) for name in names)
