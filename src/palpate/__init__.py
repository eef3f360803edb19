"""palpate: identifies the known object on a table, its stable state and its place, from a few touches.

    import palpate
    with palpate.open_rig("my-rig.toml") as rig:        # or open_rig(seed=7): the emulated bench
        answer = rig.identify(palpate.load_objects("my-parts.json"))

Every name is loaded when it is first used, so that importing palpate is quick. See docs/python.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palpate.base.errors import DeviceError as DeviceError
    from palpate.base.errors import InputError as InputError
    from palpate.base.errors import OutputError as OutputError
    from palpate.base.errors import PalpateError as PalpateError
    from palpate.base.errors import RigWarning as RigWarning
    from palpate.base.errors import SafetyStop as SafetyStop
    from palpate.base.tips import TipShape as TipShape
    from palpate.jobs.bus import scan as scan
    from palpate.jobs.bus import stop as stop
    from palpate.jobs.catalogue import check_objects as check_objects
    from palpate.jobs.catalogue import import_objects as import_objects
    from palpate.jobs.catalogue import list_objects as list_objects
    from palpate.jobs.files import load_calibration as load_calibration
    from palpate.jobs.files import load_contacts as load_contacts
    from palpate.jobs.files import load_objects as load_objects
    from palpate.jobs.files import load_references as load_references
    from palpate.jobs.files import load_rig as load_rig
    from palpate.jobs.files import load_scene as load_scene
    from palpate.jobs.files import save as save
    from palpate.jobs.learning import LearnedObject as LearnedObject
    from palpate.jobs.learning_study import study_learning as study_learning
    from palpate.jobs.ready_rig import ReadyRig as ReadyRig
    from palpate.jobs.recognition import Answer as Answer
    from palpate.jobs.recognition import Plan as Plan
    from palpate.jobs.recognition import RecognitionAnswer as RecognitionAnswer
    from palpate.jobs.recognition import plan as plan
    from palpate.jobs.recognition import recognise as recognise
    from palpate.jobs.rig import Rig as Rig
    from palpate.jobs.rig import open_rig as open_rig
    from palpate.jobs.session import Session as Session
    from palpate.jobs.session import open_session as open_session
    from palpate.jobs.study import study as study
    from palpate.recognizer import Contact as Contact
    from palpate.recognizer import Finger as Finger
    from palpate.recognizer import FingerApproach as FingerApproach
    from palpate.recognizer import Goals as Goals
    from palpate.recognizer import NormalRange as NormalRange
    from palpate.rig.identification.events import MoveEvent as MoveEvent
    from palpate.rig.identification.events import PlanEvent as PlanEvent
    from palpate.rig.identification.events import RecognitionEvent as RecognitionEvent
    from palpate.rig.identification.events import StageEvent as StageEvent
    from palpate.rig.identification.events import TouchEvent as TouchEvent
    from palpate.rig.identification.rig_recognition import GripPlanner as GripPlanner
    from palpate.rig.identification.rig_recognition import MadeGrip as MadeGrip
    from palpate.rig.identification.rig_recognition import RigRecognition as RigRecognition
    from palpate.rig.reach.carrier import Carrier as Carrier

    __version__: str

_HOMES = {
    "jobs.bus": ("scan", "stop"),
    "jobs.catalogue": ("check_objects", "import_objects", "list_objects"),
    "jobs.learning": ("LearnedObject",),
    "jobs.learning_study": ("study_learning",),
    "jobs.ready_rig": ("ReadyRig",),
    "jobs.files": (
        "load_calibration",
        "load_contacts",
        "load_objects",
        "load_references",
        "load_rig",
        "load_scene",
        "save",
    ),
    "jobs.recognition": ("Answer", "Plan", "RecognitionAnswer", "plan", "recognise"),
    "jobs.rig": ("Rig", "open_rig"),
    "jobs.session": ("Session", "open_session"),
    "jobs.study": ("study",),
    "recognizer": ("Contact", "Finger", "FingerApproach", "Goals", "NormalRange"),
    "rig.identification.events": (
        "MoveEvent",
        "PlanEvent",
        "RecognitionEvent",
        "StageEvent",
        "TouchEvent",
    ),
    "rig.identification.rig_recognition": ("GripPlanner", "MadeGrip", "RigRecognition"),
    "rig.reach.carrier": ("Carrier",),
    "base.tips": ("TipShape",),
    "base.errors": ("DeviceError", "InputError", "OutputError", "PalpateError", "RigWarning", "SafetyStop"),
}

__all__ = ["__version__", *(name for names in _HOMES.values() for name in names)]  # noqa: PLE0604


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415  # costs more than the rest of this module

        return version("palpate")
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module 'palpate' has no attribute {name!r}")
    return getattr(import_module(f"palpate.{home}"), name)


def __dir__() -> list[str]:
    return __all__
