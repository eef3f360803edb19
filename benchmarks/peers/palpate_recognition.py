"""palpate's own recogniser, asked like its peers."""

from collections.abc import Sequence

import numpy as np
from question import Answer, Model, Peer, Solve, Touch

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, recognise

HEIGHT_MM = 10.0


def prepare(models: Sequence[Model]) -> Solve:
    """A catalogue of plates; grown outlines and pairs are made when a tip is first seen."""
    catalogue = Catalogue([plate(model) for model in models])

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        recognition = recognise(catalogue, [contact(touch, k) for k, touch in enumerate(touches)])
        found = []
        for item in recognition.hypotheses:
            at, bounds = item.configuration, item.bounds
            box = (bounds.x_mm, bounds.y_mm, bounds.theta_rad)
            found.append(Answer(item.state.object_name, (at.x_mm, at.y_mm, at.theta_rad), box))
        return found

    return solve


def plate(model: Model) -> ObjectModel:
    """The object as a plate that is higher than the fingers."""
    section = Section((0.0, 2 * HEIGHT_MM), (Polygon(np.array(model.outline)),))
    return ObjectModel(model.name, (State("flat", (section,)),))


def contact(touch: Touch, number: int) -> Contact:
    """A touch as palpate has it."""
    finger = Finger(touch.radius_mm, HEIGHT_MM)
    normal = NormalRange(*touch.normal_rad)
    return Contact(f"f{number}", finger, True, touch.start_mm, touch.centre_mm, touch.bound_mm, normal)


PEER = Peer(prepare, ("palpate", "numpy", "scipy", "shapely"))
