"""`palpate setup`, `init`, `calibrate` and `home`: a rig's first day."""

import io
import json
import re
import sys
from collections.abc import Callable
from importlib.resources import as_file
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from rich.console import Console

import palpate
from palpate.base.errors import DeviceError, InputError
from palpate.calibration.measurements import ReferenceDisc, ReferencePlate
from palpate.cli.calibration_dialogue import ConsoleTable
from palpate.cli.motor_dialogue import set_up_motors
from palpate.config import load_rig, shipped_rig
from palpate.config.commissioning_results import HomeOut
from palpate.config.loading import SHIPPED_RIGS
from palpate.config.schema import schema_text
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.testing import served
from support.benches.rigs import firm_rig
from support.campaign.sampling import sample
from support.commands.command import Here, run, violations
from support.commands.repository import EXAMPLES
from support.devices.servo_wire import MotorWire, Person

# ----------------------------------------------------------------------------------------------------
# `palpate setup-motors`: factory-new servos out of a bag, one at a time, and what people do instead.

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


def test_one_that_has_its_id_is_mended_among_others(bench: Callable[[list[EmulatedServo]], Bench]) -> None:
    """What another program left in a servo of a rig that is together: no plug is pulled for it."""
    b = bench([EmulatedServo(dxl_id) for dxl_id in IDS])
    servo = b.servos[1]
    left = {"Homing Offset": 40, "PWM Limit": 100, "Startup Configuration": 1, "Max Voltage Limit": 115}
    for item, value in left.items():
        servo._unit.table.set(item, value)
    code, out = b.run([(b.plug(*range(6)), ""), (None, "y")], 12)
    assert code == 0, b.err
    assert {change["item"] for change in out["servos"][0]["written"]} >= left.keys()
    usual = {"Homing Offset": 0, "PWM Limit": 885, "Startup Configuration": 0, "Max Voltage Limit": 160}
    assert remembers(servo, *left) == usual


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
        (["--rig", "bench.toml", "--id", "13"], "the rig file has no servo with id 13; it has 11, 12, 21"),
        (["--rig", "bench.toml", "--yes"], "there is no terminal to ask on"),
    ],
)
def test_what_people_get_wrong_is_one_line(args: list[str], said: str, tmp_path: Path, here: Here) -> None:
    text = firm_rig().read_text(encoding="utf-8")
    (tmp_path / "bench.toml").write_text(text)
    done = here("setup-motors", *args)
    assert (done.code, done.out) == (2, "")
    (line,) = done.err.splitlines()
    assert said in line


# ----------------------------------------------------------------------------------------------------
# `palpate init`: a rig file for devices that answer, which loads and which `check` accepts.

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.realtime
@pytest.mark.slow
def test_what_answers_is_in_the_file_and_what_does_not_is_named(tmp_path: Path) -> None:
    with served(tmp_path, "--rig", firm_rig(), "--seed", "7") as (_, told):
        ports = told["ports"]
        bus, *arrays = ports.values()
        words = [word for place in arrays for word in ("--array", place)]
        asked = ("init", "--port", bus, "--baud", 1000000, "--max-id", 40, *words, "--out", "mine.toml")
        ended = run(*asked, cwd=tmp_path)
        assert (ended.code, ended.err) == (0, "")
        assert ended.out.startswith("mine.toml: 3 fingers, ")
        rig = load_rig(tmp_path / "mine.toml")
        shipped = load_rig(firm_rig())
        for finger, other, place in zip(rig.fingers, shipped.fingers, arrays, strict=True):
            assert finger.array.port == place
            for servo, its in zip(finger.servos.values(), other.servos.values(), strict=True):
                assert (servo.dxl_id, servo.model) == (its.dxl_id, its.model)
        assert "answered: 8 × 20 taxels" in (tmp_path / "mine.toml").read_text(encoding="utf-8")
        schema = json.loads((tmp_path / "rig.schema.json").read_text(encoding="utf-8"))
        assert schema["properties"]["format"]["const"] == "palpate/rig@1"
        checked = run("check", "--rig", "mine.toml", "--json", cwd=tmp_path)
        assert checked.json["format"] == "palpate/check@1"
        assert "no answer" not in checked.out
        again = run(*asked, cwd=tmp_path)
        assert (again.code, again.err.count("\n")) == (2, 1)
        assert "mine.toml is there already" in again.err

        asked = ("init", "--port", bus, "--baud", 1000000, "--out", "other.toml", "--max-id")
        few = run(*asked, 5, cwd=tmp_path)
        assert (few.code, few.out, few.err.count("\n")) == (2, "", 1)
        assert "0 servos answered; a finger has two: check power, cables and ids" in few.err
        assert not (tmp_path / "other.toml").exists()

        silent = run(*asked, 40, "--array", tmp_path / "nowhere", cwd=tmp_path)
        assert silent.code == 0
        assert "nowhere" in silent.err
    text = (tmp_path / "other.toml").read_text(encoding="utf-8")
    assert "CHANGE: did not answer" in text
    assert text.count("CHANGE: palpate find-port says which it is") == 2
    load_rig(tmp_path / "other.toml")


@pytest.mark.parametrize("grips", sample([1, 12], [1]))
@pytest.mark.parametrize("bench", sample(SHIPPED_RIGS[1:], SHIPPED_RIGS[2:]))
def test_a_shipped_bench_is_copied_and_can_be_run(bench: str, grips: int, tmp_path: Path, here: Here) -> None:
    ended = here("init", "--bench", bench, "--out", "mine.toml")
    assert (ended.code, ended.err) == (0, "")
    rig = palpate.open_rig(tmp_path / "mine.toml", seed=2)
    assert rig.file == load_rig(shipped_rig(bench))
    answer = rig.with_(search={"max_grips": grips}).identify()
    truth = answer.result.truth
    assert truth is not None
    assert answer.result.grips <= grips
    if grips > 1:
        assert (answer.verdict.value, answer.object) == ("identified", truth.object)
    assert truth.inside_bounds
    again = here("init", "--bench", bench, "--out", "mine.toml")
    assert (again.code, again.err) == (
        2,
        "error: mine.toml is there already: choose another with --out, or remove it\n",
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "give --port, whose servos are asked, or --bench"),
        (("--bench", "bench", "--port", "/dev/null"), "give --port, whose servos are asked, or --bench"),
        (("--bench", "bank"), "palpate ships bench, xm430-bench, xl330-bench"),
        (("--bench", "bench", "--array", "/dev/null"), "a copied rig has its own"),
    ],
)
def test_port_and_bench_exclude_each_other(
    words: tuple[str, ...], told: str, tmp_path: Path, here: Here
) -> None:
    ended = here("init", *words, "--out", "mine.toml")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert told in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bench", SHIPPED_RIGS[1:])
def test_the_drawing_in_the_docs_is_that_of_the_file(bench: str, tmp_path: Path, here: Here) -> None:
    with as_file(shipped_rig(bench)) as file:
        ended = here("check", "--rig", file, "--picture", "rig.svg")
    assert ended.code == 0
    drawn = (tmp_path / "rig.svg").read_text(encoding="utf-8")
    assert (DOCS / "images" / f"{bench}.svg").read_text(encoding="utf-8").strip() == drawn.strip()
    ElementTree.fromstring(drawn)


# ----------------------------------------------------------------------------------------------------
# `palpate calibrate`: what is asked, refused and foretold before anything moves.

FRESH = EXAMPLES / "fresh-rig.toml"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "my-rig.toml"
    path.write_text(FRESH.read_text(encoding="utf-8"), encoding="utf-8")
    return path


def test_a_dry_run_says_what_would_be_done_and_does_nothing(rig: Path, here: Here) -> None:
    ended = here("calibrate", "--rig", rig, "--dry-run")
    assert ended.code == 0
    assert ended.out == ""
    for words in ("actuators", "tactile", "fingers", "6 placings", "my-rig.calibration.toml"):
        assert words in ended.err
    assert sorted(path.name for path in rig.parent.iterdir()) == ["my-rig.toml"]


def test_nothing_moves_unless_somebody_says_yes(
    rig: Path, monkeypatch: pytest.MonkeyPatch, here: Here
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    ended = here("calibrate", "--rig", rig, "tactile")
    assert ended.code == 2
    assert "say --yes if they may" in ended.err
    assert sorted(path.name for path in rig.parent.iterdir()) == ["my-rig.toml"]


@pytest.mark.parametrize(
    ("rig_file", "change", "message"),
    [
        ("fresh-arms.toml", None, "links of finger a1 pass at 30 mm: use lower references"),
        ("fresh-rig.toml", ("height_mm = 10.0", "height_mm = 45.0"), "references must stand higher"),
    ],
)
def test_what_cannot_be_calibrated_is_refused_before_anything_moves(
    tmp_path: Path, rig_file: str, change: tuple[str, str] | None, message: str, here: Here
) -> None:
    text = (EXAMPLES / rig_file).read_text(encoding="utf-8")
    path = tmp_path / "rig.toml"
    path.write_text(text if change is None else text.replace(*change), encoding="utf-8")
    ended = here("calibrate", "--rig", path, "--yes")
    assert ended.code == 2
    assert message in " ".join(ended.err.split())


def test_a_record_that_cannot_be_read_is_not_overwritten(rig: Path, here: Here) -> None:
    record = rig.with_name("my-rig.calibration.run.json")
    record.write_text('{"format": "palpate/calibration-run@1"', encoding="utf-8")
    ended = here("calibrate", "--rig", rig, "--yes")
    assert ended.code == 2
    assert "restart to begin anew" in " ".join(ended.err.split())
    assert record.read_text(encoding="utf-8").endswith('run@1"')


def test_a_rig_that_is_not_known_well_is_not_identified_with(rig: Path, here: Here) -> None:
    ended = here("identify", "--rig", rig, "--sessions", rig.parent / "s")
    assert ended.code == 2
    said = " ".join(ended.err.split())
    assert re.search(
        r"may be off by 1\d\.\d mm, more than radius_mm \(5 mm\), \d\.\d mm of it .*encoder_deg", said
    )
    assert "palpate calibrate --rig" in said


def test_a_person_is_asked_once_to_clear_the_table_and_for_every_placing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n\n"))
    out = io.StringIO()
    table = ConsoleTable(Console(file=out, width=200))
    table.clear()
    table.clear()
    table.put(ReferenceDisc("disc", 25.0), (0.0, 0.0))
    table.put(ReferencePlate("plate", [[0, 0], [40, 0], [40, 40], [0, 40]]), (30.0, -12.0))
    said = out.getvalue()
    assert said.count("Clear the table") == 1
    assert "Put the disc in the middle; alone" in said
    assert "Put the plate near x 30, y -12 mm, turned as you like" in said
    with pytest.raises(InputError, match="standard input has ended"):
        table.clear()


# ----------------------------------------------------------------------------------------------------
# `palpate home`: what it says, and what it refuses before anything moves.

BENCH = shipped_rig("xm430-bench")


def test_slides_that_stand_anywhere_are_homed(here: Here, tmp_path: Path) -> None:
    rig = tmp_path / "anywhere.toml"
    text = BENCH.read_text(encoding="utf-8")
    rig.write_text(text.replace("noise_counts = 2.0", 'noise_counts = 2.0\nstart = "anywhere"'), "utf-8")
    ended = here("home", "--rig", rig, "--yes", "--seed", 1, "--json")
    assert ended.code == 0
    HomeOut.model_validate_json(ended.out)
    slides = json.loads(ended.out)["slides"]
    assert [(slide["finger"], slide["dxl_id"]) for slide in slides] == [("f1", 12), ("f2", 22), ("f3", 32)]
    assert any(slide["turns"] < 0 for slide in slides)
    assert "f3: slide (servo 32) is homed; its count is" in ended.err


def test_a_rig_without_stops_has_nothing_to_home_against(here: Here) -> None:
    ended = here("home", "--rig", shipped_rig(), "--yes")
    assert (ended.code, ended.out) == (2, "")
    assert "has no slide with stops_mm" in ended.err


def test_nothing_moves_where_nobody_can_be_asked(here: Here) -> None:
    ended = here("home", "--rig", BENCH)
    assert ended.code == 2
    assert "say --yes if they may" in ended.err
