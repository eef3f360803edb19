"""What a new rig file is not written for: servos of which palpate could not bound what they press with."""

import pytest

from palpate.config.scan_result import ScannedServoOut
from palpate.errors import InputError
from palpate.rig.commissioning.new_rig import rig_text


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
