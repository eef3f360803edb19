"""A new rig file: pads, and servos that it is not written for: nothing would bound what they press with."""

import tomllib

import pytest
from contact_sweep import describe

from palpate.base.errors import InputError
from palpate.config import RigFile
from palpate.config.commissioning_results import ScannedServoOut
from palpate.drivers.tactile.description import Shape
from palpate.rig.arrays import pad_problem
from palpate.rig.commissioning.new_rig_file import DescribedArray, rig_text


def found(dxl_id: int, model: str | None, number: int) -> ScannedServoOut:
    return ScannedServoOut(
        baudrate_bps=1_000_000,
        id=dxl_id,
        model=model,
        model_number=number,
        firmware=46,
        crowded=False,
        owner=None,
    )


@pytest.mark.parametrize(
    ("model", "number", "words"),
    [
        ("XL430-W250", 1060, 'id 12 is "XL430-W250", which does not report its current'),
        ("2XC430-W250", 1160, "does not report its current"),
        (None, 9999, "id 12 is of a model that palpate does not know"),
    ],
)
def test_servos_that_cannot_be_used_are_named(model: str | None, number: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        rig_text("new", "/dev/ttyUSB0", [found(11, "XM430-W350", 1020), found(12, model, number)], [])


def test_any_other_pair_makes_a_finger() -> None:
    text = rig_text("new", "/dev/ttyUSB0", [found(11, "XM430-W350", 1020), found(12, "XH430-W210", 1010)], [])
    assert 'model = "XH430-W210"' in text


def test_tips_of_flat_arrays_are_pads() -> None:
    flat = DescribedArray("/dev/a", describe(Shape.FLAT, 4, 20, 0.5, 4.0, counts_per_n=2000.0))
    servos = [found(number, "XM430-W350", 1020) for number in (1, 2, 3, 4)]
    text = rig_text("mine", "/dev/b", servos, [flat, "/dev/c"])
    pad, other = RigFile.model_validate(tomllib.loads(text)).fingers
    assert (pad.tip.shape, pad.tip.width_mm, pad.array.pitch_mm) == ("pad", 10.0, 0.5)
    assert pad_problem(pad, flat.description) is None
    assert other.tip.shape == "cylinder"
    assert "answered: 4 × 20 taxels, flat" in text
    assert "palpate calibrate" not in text
    assert "--hold" not in text
    without = rig_text("mine", "/dev/b", servos, ["/dev/a"])
    assert "palpate calibrate" in without
    assert "--hold" in without
