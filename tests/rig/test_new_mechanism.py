"""A third kind of finger: one class of kinematics, its table, and one line that registers them."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.calibration.rig_models import nominal_models
from palpate.config import FingerConfig, RigFile, load_rig
from palpate.config.rig_servos import AimConfig
from palpate.rig.catalogue.finger_model import contact_bound_mm
from palpate.rig.contact_peak import unstopped_peak_n
from palpate.rig.emulated.finger_truth import draws_of
from palpate.rig.emulated.hidden_truth import start_postures
from palpate.rig.fingers import resolution_of
from palpate.rig.mechanisms import MECHANISMS, lowest_links, mechanism_of, register
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.reach.approaches import WaitingFingers, reach_of
from palpate.views.rig_drawing import draw_rig
from support.benches.rigs import firm_rig


class ToyConfig(FingerConfig):
    """Keys of a toy, which has two aims and stands on its base."""

    type: Literal["toy"]
    near: AimConfig
    far: AimConfig
    servos = property(lambda self: {"near": self.near, "far": self.far})
    lever_mm = property(lambda _self: 100.0)

    def start_tip_mm(self, _radius_mm: float) -> tuple[float, float]:
        return self.base_mm

    def check_place(self, radius_mm: float, *at: str | int) -> None:
        pass


class Toy(Mechanism):
    """A toy's kinematics and mechanism, of which nothing is worked out yet."""

    def __init__(self, spec: ToyConfig) -> None:
        super().__init__(spec, self)  # type: ignore[arg-type]

    def not_yet(self, *_arguments: Any, **_options: Any) -> NoReturn:
        raise NotImplementedError("not yet")

    ranges_rad = levers = reach = direction_bound_rad = property(not_yet)
    drive = start_problem = start_rad = draw_posture = home = standby = is_waiting = not_yet
    ways_to_standby = paths = test_moves = not_yet
    servos_rad = centre_mm = facing_rad = levers_mm = position_bound_mm = cross_track_bound_mm = not_yet


TABLES = """type = "toy"
near = {{ dxl_id = {near_id}, {aim} }}
far = {{ dxl_id = 202, {aim} }}
"""
AIM = 'model = "XM430-W350", gear_ratio = 5.0, range_deg = [-35, 35], backlash_deg = 0.02, zero_deg = 180'


@pytest.fixture
def toys(tmp_path: Path) -> Iterator[Callable[..., RigFile]]:
    """The firm rig, its second finger a toy; arguments change values of its tables."""
    field = RigFile.model_fields["fingers"]
    before = field.annotation
    register("toy", ToyConfig, Toy)

    def load(old: str = "", new: str = "", near_id: int = 201) -> RigFile:
        head, first, second, *others = firm_rig().read_text("utf-8").split("[[fingers]]\n")
        keys, *tables = second.split("\n[")
        toy = [keys, TABLES.format(near_id=near_id, aim=AIM).replace(old, new)]
        kept = ["[" + table for table in tables if not table.startswith(("fingers.aim", "fingers.slide"))]
        file = tmp_path / "rig.toml"
        file.write_text("[[fingers]]\n".join([head, first, "\n".join(toy + kept), *others]), "utf-8")
        return load_rig(file)

    yield load
    del MECHANISMS[ToyConfig]
    field.annotation = before
    RigFile.model_rebuild(force=True)


def test_a_rig_file_may_have_it(toys: Callable[..., RigFile]) -> None:
    rig = toys()
    toy = rig.fingers[1]
    assert isinstance(toy, ToyConfig)
    assert isinstance(mechanism_of(toy), Toy)
    assert [(item.joint, item.dxl_id) for item in rig.servos if item.finger == toy.name] == [
        ("near", 201),
        ("far", 202),
    ]
    assert RigFile.model_validate(rig.model_dump(mode="json")) == rig


def test_its_file_is_checked_like_any_other(toys: Callable[..., RigFile]) -> None:
    with pytest.raises(InputError, match=r'type.* "toy"'):
        toys('type = "toy"', 'type = "other"')
    with pytest.raises(InputError, match=r"near.*gear_ratio"):
        toys("gear_ratio = 5.0", "gear_ratio = 0.0")
    with pytest.raises(InputError, match="12 is the id"):
        toys(near_id=12)


@pytest.mark.parametrize(
    "ask",
    [
        reach_of,
        WaitingFingers.of,
        resolution_of,
        contact_bound_mm,
        lambda rig: start_postures(rig, None, 0.0, np.random.default_rng(0)),
        unstopped_peak_n,
        draw_rig,
    ],
)
def test_the_rig_asks_its_methods(toys: Callable[..., RigFile], ask: Callable[[RigFile], object]) -> None:
    with pytest.raises(NotImplementedError, match="not yet"):
        ask(toys())


def test_what_it_does_not_say_is_what_most_fingers_have(toys: Callable[..., RigFile]) -> None:
    rig = toys()
    assert lowest_links(rig)[0] == np.inf
    assert mechanism_of(rig.fingers[1]).homing is None


def test_jobs_that_need_more_of_it_refuse_it(toys: Callable[..., RigFile]) -> None:
    rig = toys()
    with pytest.raises(InputError, match="finger f2: palpate does not calibrate"):
        nominal_models(rig.fingers)
    with pytest.raises(InputError, match="finger f2: palpate does not emulate"):
        draws_of(rig.fingers[1], rig.emulation)
