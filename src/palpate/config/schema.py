"""JSON Schemas of all file formats, for editors and for programs that read or write the files.

`palpate schema NAME` prints them. That of rig files is also under version control, in `schemas/`, because the
first line of shipped rig files points there: after a change write it anew, `palpate schema rig --out
src/palpate/config/schemas/rig.schema.json`. References are inlined: the TOML language servers do not all
follow `$defs`.
"""

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from palpate.config.calibration_file import CalibrationFile, ReferencesFile
from palpate.config.catalogue_results import ImportOut, InventoryOut, ObjectsCheckOut, ObjectsListingOut
from palpate.config.commissioning_results import (
    CalibrateOut,
    HomeOut,
    RebootOut,
    ScanOut,
    SerialPortsOut,
    SetupOut,
    StopOut,
)
from palpate.config.contacts_file import ContactsFile
from palpate.config.diagnosis_results import CheckOut, DoctorOut, WiringOut
from palpate.config.emulation import Scene
from palpate.config.fields import Out
from palpate.config.import_settings import ImportSettings
from palpate.config.learning_result import LearningOut
from palpate.config.learning_study_result import LearningStudyOut
from palpate.config.objects_tables import ObjectsFileText
from palpate.config.recognition_results import GripOut, IdentificationOut, RecognitionOut
from palpate.config.rig_file import RigFile
from palpate.config.session_results import ExportOut, ReplayOut, SessionInfoOut, SessionsOut, WatchOut
from palpate.config.study_result import StudyOut

FORMATS: Mapping[str, type[BaseModel]] = {
    "calibrate": CalibrateOut,
    "calibration": CalibrationFile,
    "check": CheckOut,
    "contacts": ContactsFile,
    "doctor": DoctorOut,
    "export": ExportOut,
    "grip": GripOut,
    "home": HomeOut,
    "identification": IdentificationOut,
    "import": ImportOut,
    "import-settings": ImportSettings,
    "learning": LearningOut,
    "learning-study": LearningStudyOut,
    "objects": ObjectsFileText,
    "objects-check": ObjectsCheckOut,
    "objects-inventory": InventoryOut,
    "objects-listing": ObjectsListingOut,
    "reboot": RebootOut,
    "recognition": RecognitionOut,
    "references": ReferencesFile,
    "replay": ReplayOut,
    "rig": RigFile,
    "scan": ScanOut,
    "scene": Scene,
    "serial-ports": SerialPortsOut,
    "session-info": SessionInfoOut,
    "sessions": SessionsOut,
    "setup": SetupOut,
    "stop": StopOut,
    "study": StudyOut,
    "watch": WatchOut,
    "wiring": WiringOut,
}
"""Short name of each format and the model it is read into or written from."""


def schema_text(name: str) -> str:
    """JSON Schema of the format called `name`, as the text of its file."""
    model = FORMATS[name]
    mode: Any = "serialization" if issubclass(model, Out) else "validation"
    schema = model.model_json_schema(mode=mode)
    definitions = schema.pop("$defs", {})
    full = {"$schema": "https://json-schema.org/draft/2020-12/schema"} | inline_references(
        schema, definitions
    )
    return json.dumps(full, indent=2, ensure_ascii=False) + "\n"


def inline_references(node: Any, definitions: Mapping[str, Any]) -> Any:
    """Replace every reference by what it refers to; the formats are trees, so this ends."""
    if isinstance(node, list):
        return [inline_references(item, definitions) for item in node]
    if not isinstance(node, dict):
        return node
    rest = {key: inline_references(value, definitions) for key, value in node.items() if key != "$ref"}
    if "$ref" not in node:
        return rest
    return inline_references(definitions[node["$ref"].rpartition("/")[2]], definitions) | rest
