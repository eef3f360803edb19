"""`palpate setup-motors`: factory-new servos out of a bag, one at a time, and what people do instead."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command import run_here
from firm_rig import firm_rig
from json_schema import violations
from motor_wire import MotorWire, Person
from repository import EXAMPLES

from palpate.base.errors import DeviceError, InputError
from palpate.cli.motor_dialogue import set_up_motors
from palpate.config import load_rig, shipped_rig
from palpate.config.schema import schema_text
from palpate.drivers.emulators.servo import EmulatedServo

RIG = load_rig(shipped_rig())
FACTORY_CODE = 1  # 57,600
IDS = (11, 12, 21, 22, 31, 32)

Deeds = list[tuple[Callable[[], object] | None, str]]


def remembers(servo: EmulatedServo, *items: str) -> dict[str, int]:
    return {item: servo._unit.table.get(item) for item in items}


def factory_new(count: int) -> list[EmulatedServo]:
    return [EmulatedServo(1, baud_rate_code=FACTORY_CODE) for _ in range(count)]


class Bench:
    """Runs the command on a wire of servos with somebody at the keyboard."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], servos: list[EmulatedServo]
    ) -> None:
        self.servos = servos
        self.wire = MotorWire(servos)
        self.wire.plug()
        self.err = ""
        self._monkeypatch = monkeypatch
        self._capsys = capsys

    def run(self, deeds: Deeds, *dxl_ids: int, yes: bool = False) -> tuple[int, dict[str, Any]]:
        self._monkeypatch.setattr(sys, "stdin", Person(deeds))
        self._capsys.readouterr()
        code = set_up_motors(RIG, self.wire.place(RIG), dxl_ids, yes=yes, json=True)
        return code, self.told()

    def told(self) -> dict[str, Any]:
        said = self._capsys.readouterr()
        self.err = said.err
        out = json.loads(said.out)
        assert isinstance(out, dict)
        return out

    def plug(self, *indexes: int) -> Callable[[], None]:
        return lambda: self.wire.plug(*(self.servos[index] for index in indexes))


@pytest.fixture
def bench(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[list[EmulatedServo]], Bench]:
    return lambda servos: Bench(monkeypatch, capsys, servos)


def test_six_servos_from_a_bag(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    """All leave the factory with id 1 at 57,600 baud."""
    b = bench(factory_new(6))
    deeds: Deeds = []
    for index in range(6):
        deeds += [(b.plug(index), ""), (None, "y")]
    code, out = b.run(deeds)
    assert code == 0, b.err
    assert violations(out, json.loads(schema_text("setup"))) == []
    assert list(out) == ["format", "rig", "port", "emulated", "baudrate_bps", "servos"]
    assert [servo["outcome"] for servo in out["servos"]] == ["written"] * 6
    assert out["servos"][1] == {
        "id": 12,
        "owner": "f1 slide",
        "model": "XM430-W350",
        "outcome": "written",
        "found": {"id": 1, "baudrate_bps": 57600, "firmware": 45},
        "written": [
            {"item": "Return Delay Time", "found": 250, "wanted": 0},
            {"item": "Operating Mode", "found": 3, "wanted": 5},
            {"item": "Current Limit", "found": 1193, "wanted": 26},
            {"item": "ID", "found": 1, "wanted": 12},
            {"item": "Baud Rate", "found": 1, "wanted": 3},
        ],
        "problem": None,
    }
    for servo, dxl_id in zip(b.servos, IDS, strict=True):
        kept = remembers(servo, "ID", "Baud Rate", "Return Delay Time", "Torque Enable")
        assert kept == {"ID": dxl_id, "Baud Rate": 3, "Return Delay Time": 0, "Torque Enable": 0}
        limits = remembers(servo, "Temperature Limit", "Max Voltage Limit", "Min Voltage Limit")
        assert limits == {"Temperature Limit": 80, "Max Voltage Limit": 160, "Min Voltage Limit": 95}
    assert remembers(b.servos[0], "Min Position Limit", "Max Position Limit") == {
        "Min Position Limit": 57,
        "Max Position Limit": 4039,
    }
    assert "57600 baud  1000000 baud" in b.err


def test_one_that_is_right_already_is_left_alone(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    b = bench(factory_new(1))
    assert b.run([(b.plug(0), ""), (None, "y")], 11)[0] == 0
    code, out = b.run([(b.plug(0), "")], 11)
    assert code == 0
    assert out["servos"][0]["outcome"] == "right already"
    assert out["servos"][0]["written"] == []
    assert "servo 11 is right already, nothing was written" in b.err


def test_nothing_is_written_without_a_yes(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    b = bench(factory_new(1))
    before = b.servos[0]._unit.table
    kept = {item.name: before.get(item.name) for item in before if item.area.value == "EEPROM"}
    for answer in ("n", "", "what"):
        code, out = b.run([(b.plug(0), ""), (None, answer), (None, "n")], 11)
        assert code == 1
        assert out["servos"][0]["outcome"] == "declined"
        assert out["servos"][0]["written"] == []
    assert {name: before.get(name) for name in kept} == kept


def test_yes_asks_only_to_connect(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    b = bench(factory_new(2))
    code, out = b.run([(b.plug(0), ""), (b.plug(1), "")], 31, 32, yes=True)
    assert code == 0, b.err
    assert [servo["id"] for servo in out["servos"]] == [31, 32]
    assert "write this to its EEPROM?" not in b.err


def test_two_servos_are_refused_then_one_is_taken(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    """At different ids, at one id, and at different baud rates."""
    b = bench([*factory_new(2), EmulatedServo(7, start_rad=1.0)])
    b.servos[1].step(0.3, 0.0)  # the clocks of two servos differ
    deeds: Deeds = [
        (b.plug(0, 2), ""),
        (b.plug(0, 1), ""),
        (b.plug(), ""),
        (b.plug(0), ""),
        (None, "y"),
    ]
    code, out = b.run(deeds, 11)
    assert code == 0, b.err
    assert f"2 servos answer on {b.wire.url} (id 1 at 57600 baud, id 7 at 1000000 baud)" in b.err
    assert "more than one servo seems to answer" in b.err
    assert f"no servo answers on {b.wire.url}" in b.err
    assert out["servos"][0]["problem"] is None


def test_the_wrong_model_is_refused(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    b = bench([EmulatedServo(1, model="XL330-M288", baud_rate_code=FACTORY_CODE)])
    code, out = b.run([(b.plug(0), ""), (None, "q")], 11)
    assert code == 3
    assert out["servos"][0]["outcome"] == "not done"
    assert "(id 1) is a XL330-M288, not a XM430-W350" in out["servos"][0]["problem"]
    assert remembers(b.servos[0], "ID", "Baud Rate") == {"ID": 1, "Baud Rate": FACTORY_CODE}


def test_skipping_and_ending(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    b = bench(factory_new(1))
    code, out = b.run([(None, "s"), (None, "q")], 11, 12)
    assert code == 3
    assert [servo["outcome"] for servo in out["servos"]] == ["skipped", "not done"]
    code, out = b.run([(None, "s")], 11)
    assert (code, out["servos"][0]["outcome"]) == (1, "skipped")
    code, out = b.run([], 11)
    assert (code, out["servos"][0]["outcome"]) == (3, "not done"), "stdin is at its end"


class Interrupt(BaseException):
    """As a signal raises it in the command line."""


class Interrupting(MotorWire):
    """Interrupts whoever uses it, some looks at the wire after the first servo's limit was written."""

    left = 0

    def _advance(self, now: float) -> None:
        super()._advance(now)
        if remembers(self.servos[0], "Current Limit") != {"Current Limit": 1193}:
            self.left -= 1
            if self.left < 0:
                raise Interrupt


@pytest.mark.parametrize(
    ("looks", "last"),
    [
        (7, "Return Delay Time"),
        (45, "Current Limit"),
        (100, "Min Position Limit"),
        (140, "Max Position Limit"),
        (158, "ID"),
        (180, "Baud Rate"),
    ],
)
def test_interrupted_in_the_middle_it_says_what_was_written(
    looks: int, last: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And goes on from there the next time."""
    b = Bench(monkeypatch, capsys, factory_new(1))
    b.wire = Interrupting(b.servos)
    b.wire.left = looks
    monkeypatch.setattr(sys, "stdin", Person([(b.plug(0), ""), (None, "y")]))
    with pytest.raises(Interrupt) as raised:
        set_up_motors(RIG, b.wire.place(RIG), [11], yes=False, json=True)
    (servo,) = b.told()["servos"]
    assert servo["outcome"] == "not done"
    assert servo["written"][-1]["item"] == last
    (note,) = raised.value.__notes__
    assert note.startswith("servo 11 (f1 aim) is set up in part, torque off: Return Delay Time 250 → 0")
    for item in servo["written"]:
        assert remembers(b.servos[0], item["item"]) == {item["item"]: item["wanted"]}
    b.wire = MotorWire(b.servos)
    code, _ = b.run([(b.plug(0), ""), (None, "y")], 11)
    assert code == 0, b.err
    assert remembers(b.servos[0], "ID", "Baud Rate") == {"ID": 11, "Baud Rate": 3}


def test_one_that_is_unplugged_while_it_is_written_is_tried_again(
    bench: Callable[[list[EmulatedServo]], Bench],
) -> None:
    b = bench(factory_new(1))

    code, out = b.run([(b.plug(0), ""), (b.plug(), "y"), (b.plug(0), ""), (None, "y")], 11)
    assert code == 0, b.err
    assert "does not answer" in b.err
    assert out["servos"][0]["outcome"] == "written"


def test_a_port_that_is_not_there(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    b = bench(factory_new(1))
    place = b.wire.place(RIG)
    b.wire._hub.close()
    with pytest.raises(DeviceError, match="does not exist"):
        set_up_motors(RIG, place, [], yes=False, json=False)


def test_a_force_that_the_servo_does_not_have(
    bench: Callable[[list[EmulatedServo]], Bench], tmp_path: Path
) -> None:
    text = (EXAMPLES / "real-rig.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(text.replace("max_force_n = 6.0", "max_force_n = 190.0"))
    rig = load_rig(tmp_path / "rig.toml")
    with pytest.raises(InputError, match=r"^right slide: a current of .* max_force_n"):
        set_up_motors(rig, bench(factory_new(1)).wire.place(rig), [], yes=False, json=False)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ([], "--rig"),
        (["--rig", "no-such.toml"], "no-such.toml"),
        (["--rig", "bench.toml", "--id", "13"], "the rig file has no servo with id 13; it has 11, 12, 21"),
        (["--rig", "bench.toml", "--yes"], "there is no terminal to ask on"),
    ],
)
def test_what_people_get_wrong_is_one_line(
    args: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = firm_rig().read_text(encoding="utf-8")
    (tmp_path / "bench.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    done = run_here(["setup-motors", *args], monkeypatch, capsys)
    assert (done.code, done.out) == (2, "")
    (line,) = done.err.splitlines()
    assert said in line
