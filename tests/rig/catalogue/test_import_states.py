"""States that are sectioned in processes of their own."""

import signal
import time
from collections.abc import Iterator
from multiprocessing import active_children

import numpy as np
import pytest
import trimesh

from palpate.cad.parts import Solid
from palpate.rig.catalogue.import_states import Shares, import_states

SHARES = Shares(0.02, 0.001, None, 0.0, as_is=False)  # sections so fine that they take seconds


@pytest.fixture
def alarm_interrupts() -> Iterator[None]:
    """SIGALRM acts as Ctrl-C does."""
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


def sectioning_s(solid: Solid, interrupt_after_s: float) -> float:
    """Time from the begin of sectioning to its end; interrupted after a while unless that is 0."""
    begun: list[float] = []

    def report(what: str) -> None:
        if what.startswith("sections") and not begun:
            begun.append(time.monotonic())
            signal.setitimer(signal.ITIMER_REAL, interrupt_after_s)

    if interrupt_after_s:
        with pytest.raises(KeyboardInterrupt):
            import_states(solid, SHARES, report)
    else:
        import_states(solid, SHARES, report)
    return time.monotonic() - begun[0]


@pytest.mark.usefixtures("alarm_interrupts")
def test_interrupted_it_does_not_wait_for_states_that_were_begun() -> None:
    mesh = trimesh.creation.cone(20.0, 40.0, sections=24)
    solid = Solid("cone", np.asarray(mesh.vertices), np.asarray(mesh.faces))
    others = set(active_children())
    whole_s = sectioning_s(solid, 0.0)
    assert sectioning_s(solid, 0.2) < whole_s / 2
    assert set(active_children()) <= others
