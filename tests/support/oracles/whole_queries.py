"""Whole queries in a process of their own that computes with numpy alone."""

import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import ObjectModel
from palpate.recognizer import STANDARD_BUDGET, Budget, Catalogue, Contact, recognise


@dataclass(frozen=True)
class WholeQuery:
    """Grips on objects, of which some contacts may be spurious."""

    models: Sequence[ObjectModel]
    grips: Sequence[Sequence[Contact]]
    spurious: int = 0
    budget: Budget = STANDARD_BUDGET

    def answer(self) -> list[np.ndarray]:
        """Number of cells; states, witnesses, configurations and bounds (mm, rad), weights of hypotheses."""
        found = recognise(Catalogue(self.models), self.grips[0], self.spurious, self.budget)
        for contacts in self.grips[1:]:
            found = found.extend(contacts)
        held = found.hypotheses
        configuration = np.column_stack([held.position_mm, held.regions.theta])
        bounds = np.column_stack([held.lo, held.hi])
        return [np.array(len(found.cells)), held.state, held.verified, configuration, bounds, held.weight]


def assert_same_by_numpy(queries: Sequence[WholeQuery]) -> None:
    """Every answer is what numpy alone gives, all numbers to 10⁻⁹."""
    done = subprocess.run(
        [sys.executable, "-m", "support.oracles.whole_queries"],
        input=pickle.dumps(queries),
        stdout=subprocess.PIPE,
        check=True,
        env={**os.environ, "PALPATE_KERNEL": "off", "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    for query, expected in zip(queries, pickle.loads(done.stdout), strict=True):
        for one, two in zip(query.answer(), expected, strict=True):
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-9)


if __name__ == "__main__":
    from palpate.recognizer import numpy_steps
    from palpate.recognizer.steps import STEPS

    assert STEPS is numpy_steps
    sys.stdout.buffer.write(pickle.dumps([query.answer() for query in pickle.load(sys.stdin.buffer)]))
