"""Information on one session: its summary, and the devices that its rig file names."""

from pathlib import Path

from palpate.base.errors import InputError
from palpate.config import FingerConfig, RigFile, load_rig
from palpate.config.sessions_result import PortOfSessionOut, SessionInfoOut, VersionsOut
from palpate.rig.session.summary import summary_of

__all__ = ["session_info"]


def session_info(folder: Path) -> SessionInfoOut:
    """All that there is to say of a session; InputError if its log cannot be read."""
    summary = summary_of(folder)
    return SessionInfoOut.of(
        summary, devices=_devices(folder / "rig.toml"), versions=VersionsOut(palpate=summary.palpate)
    )


def _devices(path: Path) -> tuple[PortOfSessionOut, ...]:
    try:
        rig = load_rig(path)
    except InputError:  # of an older version, or changed since: the log has the run all the same
        return ()
    bus = PortOfSessionOut(port=rig.bus.port, devices=tuple(_servos(rig)))
    return (bus, *(PortOfSessionOut(port=item.array.port, devices=(_array(item),)) for item in rig.fingers))


def _servos(rig: RigFile) -> list[str]:
    found = [
        f"{servo.model}, id {servo.dxl_id}: {finger.name} {joint}"
        for finger in rig.fingers
        for joint, servo in finger.servos.items()
    ]
    return found if rig.stage is None else [*found, f"{rig.stage.model}, id {rig.stage.dxl_id}: stage"]


def _array(finger: FingerConfig) -> str:
    return f"array of {finger.name}, protocol {finger.array.protocol}"
