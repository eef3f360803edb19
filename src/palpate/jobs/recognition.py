"""Recognition and planning from contacts alone: nothing moves, no device is needed."""

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from palpate import recognizer
from palpate.base.errors import InputError, quantity
from palpate.base.vocabulary import DEFAULT_BUDGET, Strategy
from palpate.config import ContactsFile, ObjectsFile, RigFile
from palpate.jobs.answers import Plan, RecognitionAnswer
from palpate.jobs.files import PathLike, check_arguments, load_contacts, objects_from
from palpate.recognizer import Budget, Contact, Finger
from palpate.rig.catalogue.finger_model import check_known, fingers_of
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.conversion import finger_of, grips_of
from palpate.rig.identification.grip_choice import grip_plan
from palpate.views.recognition_text import ContactRecord

Contacts = ContactsFile | PathLike | Sequence[Sequence[Contact]]
"""Contacts of each grip, misses included: from a file or made in Python."""

_MANY_INTERPRETATIONS = 10_000  # interpretations that take noticeably long


@check_arguments
def recognise(
    objects: ObjectsFile | PathLike | None,
    contacts: Contacts,
    *,
    max_spurious: int = 0,
    budget: int = DEFAULT_BUDGET,
    progress: Callable[[str], None] = lambda _: None,
) -> RecognitionAnswer:
    """Recognise: which objects, states and configurations agree with contacts.

    `objects`: None for the shipped ones. `max_spurious`: as many contacts need not be the object's.
    `budget`: units of work; with fewer there are more hypotheses, with wider bounds. `progress` is told of
    the preparation of a large catalogue, and of many ways to understand the contacts before the hypotheses
    are worked out. Raises InputError for files that are wrong, and for objects that are
    not known at the contacts' heights.
    """
    models, given = objects_from(objects), _contacts(contacts)
    check_known(models.objects, fingers_of(given.contacts))
    catalogue = prepare_catalogue(models.objects, _fingers_in(given), progress)
    begin = time.perf_counter()
    recognition = recognizer.recognise(catalogue, given.contacts, max_spurious, Budget(budget))
    count = len(recognition.constraints.nodes)
    if count > _MANY_INTERPRETATIONS:
        states = quantity(len(recognition.possible_states), "state", "states")
        progress(f"{states} left in {count} interpretations; working out hypotheses")
    _ = recognition.hypotheses
    seconds = time.perf_counter() - begin
    title = f"{_name(contacts, 'contacts')} in {_name(objects, 'objects')}"
    return RecognitionAnswer(recognition, given, catalogue, max_spurious, seconds, title)


@check_arguments
def plan(
    rig: RigFile,
    objects: ObjectsFile | PathLike | None,
    contacts: Contacts,
    *,
    strategy: Strategy | str = Strategy.PLANNED,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Plan: the grip of a rig that follows on contacts (memo §3.2), and what each hypothesis predicts of it.

    `seed` draws the grip of the strategy `random`. `progress` is told of a large catalogue's preparation.
    Raises InputError for files that are wrong, for objects that are not known at the fingers' heights, and if
    no finger touched anything.
    """
    models, given = objects_from(objects), _contacts(contacts)
    check_known(models.objects, [*rig.fingers, *fingers_of(given.contacts)])
    fingers = {*map(finger_of, rig.fingers), *_fingers_in(given)}
    catalogue = prepare_catalogue(models.objects, fingers, progress)
    planned = grip_plan(rig, catalogue, given.grips, parse_strategy(strategy), seed)
    return Plan(planned, given, catalogue, f"{_name(contacts, 'contacts')} on rig {rig.name}")


def parse_strategy(name: Strategy | str) -> Strategy:
    """The strategy of this name; InputError for an unknown one."""
    if name not in list(Strategy):
        raise InputError(f'there is no strategy "{name}"; allowed: {", ".join(Strategy)}')
    return Strategy(name)


def _contacts(contacts: Contacts) -> ContactRecord:
    if isinstance(contacts, str | os.PathLike):
        contacts = load_contacts(contacts)
    return ContactRecord(grips_of(contacts) if isinstance(contacts, ContactsFile) else contacts)


def _fingers_in(given: ContactRecord) -> set[Finger]:
    return {contact.finger for contact in given.contacts}


def _name(given: object, otherwise: str) -> str:
    return Path(given).name if isinstance(given, str | Path) else otherwise
