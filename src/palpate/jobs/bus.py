"""Servo buses from Python: which servos answer, their restart, and torque off for all of them.

By itself, so that `palpate stop` loads nothing that it does not need.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from palpate.base.errors import InputError
from palpate.config.commissioning_results import RebootOut, ScanOut, StopOut
from palpate.drivers.dynamixel import ALL_IDS
from palpate.jobs.files import PathLike, check_arguments
from palpate.rig.diagnostics.servo_bus import check_dxl_ids, find_endpoint, reboot_all, scan_bus, stop_all

_USUAL_BAUDRATE = 1_000_000


@check_arguments
def scan(
    *,
    port: str | None = None,
    rig: PathLike | None = None,
    baudrates: Sequence[int] = (),
    ids: Sequence[int] = ALL_IDS,
    progress: Callable[[int, int | None], None] = lambda *_: None,
) -> ScanOut:
    """Scan a bus for servos at every baud rate and id; moves nothing.

    The bus of a `port` by name, or of a rig file; without either that of the shipped emulated bench.
    `progress` is called with a baud rate (bit/s) and an id. Raises DeviceError if the port cannot be opened.
    """
    return scan_bus(find_endpoint(None if rig is None else Path(rig), port), baudrates, ids, progress)


@check_arguments
def reboot(*, rig: PathLike, ids: Sequence[int] = ()) -> RebootOut:
    """Restart servos of a rig, all or those of the `ids`: torque goes off, latched errors and turns are lost.

    `well` in the result says whether all are back without an error. Raises InputError for an id that is not
    the rig file's, DeviceError if the port cannot be opened, as while another program uses it.
    """
    endpoint = find_endpoint(Path(rig), None)
    assert endpoint.rig is not None
    check_dxl_ids(endpoint.rig, ids)
    return reboot_all(endpoint, endpoint.rig, ids)


@check_arguments
def stop(*, port: str | None = None, rig: PathLike | None = None, baudrate: int | None = None) -> StopOut:
    """Stop: torque off on every servo of a bus, now, also beside a program that is using the port.

    `confirmed` in the result says whether every servo has confirmed it. Raises InputError unless one of
    `port` and `rig` is given, DeviceError if the port cannot be opened at all.
    """
    if rig is None and port is None:
        raise InputError("say which servos to stop: give a rig file, or a port")
    if baudrate is not None and baudrate <= 0:
        raise InputError(f"baud rate {baudrate}: it must be positive, such as {_USUAL_BAUDRATE}")
    endpoint = find_endpoint(None if rig is None else Path(rig), port)
    return stop_all(endpoint, baudrate or endpoint.baudrate or _USUAL_BAUDRATE)
