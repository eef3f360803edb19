"""palpate: identifies the known object on a table, its stable state and its place, from a few touches.

    import palpate
    with palpate.open_rig("my-rig.toml") as rig:        # or open_rig(seed=7): the emulated bench
        answer = rig.identify(palpate.load_objects("my-parts.json"))

Every name is loaded when it is first used, so that importing palpate is quick. See docs/python.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palpate.api.answers import Answer as Answer
    from palpate.api.answers import Plan as Plan
    from palpate.api.answers import RecognitionAnswer as RecognitionAnswer
    from palpate.api.bus import scan as scan
    from palpate.api.bus import stop as stop
    from palpate.api.catalogue import check_objects as check_objects
    from palpate.api.catalogue import import_objects as import_objects
    from palpate.api.catalogue import list_objects as list_objects
    from palpate.api.files import load_calibration as load_calibration
    from palpate.api.files import load_contacts as load_contacts
    from palpate.api.files import load_objects as load_objects
    from palpate.api.files import load_references as load_references
    from palpate.api.files import load_rig as load_rig
    from palpate.api.files import load_scene as load_scene
    from palpate.api.files import save as save
    from palpate.api.recognition import plan as plan
    from palpate.api.recognition import recognise as recognise
    from palpate.api.rig import Rig as Rig
    from palpate.api.rig import open_rig as open_rig
    from palpate.api.session import Session as Session
    from palpate.api.session import open_session as open_session
    from palpate.api.study import study as study
    from palpate.api.warning import RigWarning as RigWarning
    from palpate.errors import DeviceError as DeviceError
    from palpate.errors import InputError as InputError
    from palpate.errors import OutputError as OutputError
    from palpate.errors import PalpateError as PalpateError
    from palpate.errors import SafetyStop as SafetyStop
    from palpate.recognizer import Contact as Contact
    from palpate.recognizer import Finger as Finger
    from palpate.recognizer import NormalRange as NormalRange
    from palpate.rig.identification.observers import MoveEvent as MoveEvent
    from palpate.rig.identification.observers import PlanEvent as PlanEvent
    from palpate.rig.identification.observers import RecognitionEvent as RecognitionEvent
    from palpate.rig.identification.observers import StageEvent as StageEvent
    from palpate.rig.identification.observers import TouchEvent as TouchEvent

    __version__: str

_HOMES = {
    "api.answers": ("Answer", "Plan", "RecognitionAnswer"),
    "api.bus": ("scan", "stop"),
    "api.catalogue": ("check_objects", "import_objects", "list_objects"),
    "api.files": (
        "load_calibration",
        "load_contacts",
        "load_objects",
        "load_references",
        "load_rig",
        "load_scene",
        "save",
    ),
    "api.recognition": ("plan", "recognise"),
    "api.rig": ("Rig", "open_rig"),
    "api.session": ("Session", "open_session"),
    "api.study": ("study",),
    "api.warning": ("RigWarning",),
    "recognizer": ("Contact", "Finger", "NormalRange"),
    "rig.identification.observers": (
        "MoveEvent",
        "PlanEvent",
        "RecognitionEvent",
        "StageEvent",
        "TouchEvent",
    ),
    "errors": ("DeviceError", "InputError", "OutputError", "PalpateError", "SafetyStop"),
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
