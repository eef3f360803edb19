"""Fixtures of the hardware tests. A device of the rig file that does not answer is an error in them."""

from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version
from typing import NoReturn

import pytest

from palpate.base.errors import DeviceError
from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel import Ping
from palpate.rig.bench import connect, set_up
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.diagnostics.servo_bus import RigServo, list_servos
from palpate.rig.motion.hand import Hand
from palpate.testing.hardware.bench import (
    AirPaths,
    ArrayRecording,
    ArrayUnderTest,
    Note,
    ServoUnderTest,
    air_paths,
    ping_all,
    record_arrays,
)
from palpate.testing.hardware.plugin import RIG, ask_to_move


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test for each servo and each array of the rig file."""
    rig = metafunc.config.stash.get(RIG, None)
    if "wanted_servo" in metafunc.fixturenames:
        servos = () if rig is None else list_servos(rig.rig)
        names = [f"{servo.dxl_id}-{servo.owner.replace(' ', '-')}" for servo in servos]
        metafunc.parametrize("wanted_servo", servos or [None], ids=names or ["no rig"])
    if "wanted_array" in metafunc.fixturenames:
        fingers = () if rig is None else rig.rig.fingers
        metafunc.parametrize(
            "wanted_array", fingers or [None], ids=[finger.name for finger in fingers] or ["no rig"]
        )


@pytest.fixture
def note(request: pytest.FixtureRequest) -> Note:
    """Notes a figure: a property of the test in JUnit files of either family, and a line at the end."""

    def add(name: str, value: object) -> None:
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        request.node.user_properties.append((name, shown))

    return add


@pytest.fixture(scope="session")
def on_bench(
    pytestconfig: pytest.Config, record_testsuite_property: Callable[[str, object], None]
) -> RigOnBench:
    """The rig under test, with its calibration."""
    found = pytestconfig.stash[RIG]
    rig = found.rig
    record_testsuite_property("palpate", version("palpate"))
    record_testsuite_property("rig", rig.name)
    record_testsuite_property("bus", f"{rig.bus.port} at {rig.bus.baudrate_bps} baud")
    record_testsuite_property("sample_rate_hz", rig.closing.sample_rate_hz)
    record_testsuite_property("calibrated", found.calibration is not None)
    return found


@pytest.fixture(scope="session")
def rig(on_bench: RigOnBench) -> RigFile:
    """The rig under test as runs know it."""
    return on_bench.rig


@pytest.fixture(autouse=True)
def permission(request: pytest.FixtureRequest) -> None:
    """What moves is said and asked for before anything of the test happens."""
    marker = request.node.get_closest_marker("moves")
    if marker is not None:
        ask_to_move(request.config, request.node.name, marker.args[0])


@pytest.fixture(scope="session")
def pings(rig: RigFile) -> Mapping[int, Ping | DeviceError]:
    """Answers of all servos, by id."""
    return ping_all(rig)


@pytest.fixture
def servo(wanted_servo: RigServo, pings: Mapping[int, Ping | DeviceError], note: Note) -> ServoUnderTest:
    """A servo that answers; an error if it does not."""
    note("servo", f"{wanted_servo.dxl_id} ({wanted_servo.owner})")
    note("model", wanted_servo.model)
    ping = pings[wanted_servo.dxl_id]
    if isinstance(ping, DeviceError):
        _missing(ping)
    note("firmware", ping.firmware)
    return ServoUnderTest(wanted_servo, ping)


@pytest.fixture
def all_servos(pings: Mapping[int, Ping | DeviceError]) -> None:
    """An error if a servo does not answer."""
    for ping in pings.values():
        if isinstance(ping, DeviceError):
            _missing(ping)


@pytest.fixture(scope="session")
def recordings(rig: RigFile) -> Mapping[str, ArrayRecording | DeviceError]:
    """Streams of all arrays at once, by finger."""
    return record_arrays(rig)


@pytest.fixture
def array(
    wanted_array: FingerConfig, recordings: Mapping[str, ArrayRecording | DeviceError], note: Note
) -> ArrayUnderTest:
    """An array that answers and sends frames; an error if it does not."""
    note("array", f"{wanted_array.name} on {wanted_array.array.port}")
    note("protocol", wanted_array.array.protocol)
    found = recordings[wanted_array.name]
    if isinstance(found, DeviceError):
        _missing(found)
    described = found.description
    note("array_firmware", described.firmware)
    note("unique_id", described.unique_id.hex())
    note("geometry", f"{described.rows} x {described.cols} {described.shape.name.lower()}")
    note("emulated", described.emulated)
    if len(found.frames) < 2:
        _missing(f"tactile array {wanted_array.name} sends no frames; power it off and on")
    return ArrayUnderTest(wanted_array, found)


@pytest.fixture
def resting_hand(rig: RigFile) -> Iterator[Hand]:
    """The hand, connected, torque off; an error if a device is missing. Torque is off at the end."""
    try:
        connected = connect(set_up(rig, None, 0))
    except DeviceError as error:
        _missing(error)
    with connected:
        yield connected


@pytest.fixture
def hand(resting_hand: Hand) -> Hand:
    """The hand, torque on where everything stands; an error if fingers stand where they must not start."""
    try:
        resting_hand.prepare()
    except DeviceError as error:
        _missing(error)
    return resting_hand


@pytest.fixture(scope="session")
def ways(rig: RigFile) -> AirPaths:
    """Ways of all fingers in from where they wait."""
    return air_paths(rig)


def _missing(reason: object) -> NoReturn:
    """An error of the test's set-up, in one line."""
    pytest.fail(str(reason), pytrace=False)
