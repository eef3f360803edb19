"""States that are sectioned in processes of their own."""

import signal
import time
from collections.abc import Iterator
from multiprocessing import active_children
from types import FrameType

import numpy as np
import pytest
from solids import ELL, prism

from palpate.cad.values import Solid
from palpate.rig.catalogue import import_states as module
from palpate.rig.catalogue.import_states import Shares, import_states

SHARES = Shares(0.5, 0.1, None, 0.01, as_is=False)


@pytest.fixture
def interrupted_soon() -> Iterator[None]:
    """As if somebody pressed Ctrl-C three seconds from now."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 3.0)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("interrupted_soon")
def test_interrupted_it_does_not_wait_for_states_that_were_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(*_: object) -> object:
        time.sleep(600)
        return None

    monkeypatch.setattr(module, "sections_of", endless)
    mesh = prism(ELL, 20)
    solid = Solid("angle", np.asarray(mesh.vertices), np.asarray(mesh.faces))
    others = set(active_children())
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        import_states(solid, SHARES, lambda _: None)
    assert time.monotonic() - began < 300
    assert set(active_children()) <= others
