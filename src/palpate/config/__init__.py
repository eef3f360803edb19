"""File formats: input files and JSON results, their checks, shipped rigs and object models.

A file is read once and becomes frozen values. A file that is not usable is an `InputError` with one line that
names the file, the place, what is wrong and what is allowed.
"""

from palpate.config.arm_finger import ARM_MARGIN_MM, ArmFingerConfig
from palpate.config.calibration_file import (
    CalibrationDevice,
    CalibrationFile,
    CalibrationReference,
    Residuals,
    TouchResidual,
    calibration_path,
    load_calibration,
)
from palpate.config.calibration_finger import (
    ActuatorsCalibration,
    ContactBounds,
    DirectionParts,
    FingerCalibration,
    Overshoot,
    PlaceCalibration,
    PositionParts,
    RotaryCalibration,
    SlideCalibration,
    TactileCalibration,
    UnusableTaxel,
)
from palpate.config.calibration_overlay import (
    RigOnBench,
    apply_calibration,
    check_calibration,
    geometry_sha256,
    load_calibrated,
)
from palpate.config.contacts_file import ContactEntry, ContactsFile, load_contacts
from palpate.config.emulation import Scene, load_scene
from palpate.config.loading import shipped_objects, shipped_rig
from palpate.config.objects_file import ObjectsFile, load_objects
from palpate.config.rig_file import RigFile, add_finger_type, load_rig
from palpate.config.rig_fingers import (
    ArrayConfig,
    ContactLinesConfig,
    ContactSourceConfig,
    CurrentSensingConfig,
    FingerConfig,
    FreeRunningArrayConfig,
    MountedArrayConfig,
    WrappedArrayConfig,
)
from palpate.config.rig_servos import JointConfig, RigServo, StageConfig
from palpate.config.rig_tables import ClosingConfig, EmulationConfig, SearchConfig
from palpate.config.rig_tips import TipConfig
from palpate.config.slide_finger import SlideFingerConfig
from palpate.config.writers import calibration_toml

__all__ = [
    "ARM_MARGIN_MM",
    "ActuatorsCalibration",
    "ArmFingerConfig",
    "ArrayConfig",
    "CalibrationDevice",
    "CalibrationFile",
    "CalibrationReference",
    "ClosingConfig",
    "ContactBounds",
    "ContactEntry",
    "ContactLinesConfig",
    "ContactSourceConfig",
    "ContactsFile",
    "CurrentSensingConfig",
    "DirectionParts",
    "EmulationConfig",
    "FingerCalibration",
    "FingerConfig",
    "FreeRunningArrayConfig",
    "JointConfig",
    "MountedArrayConfig",
    "ObjectsFile",
    "Overshoot",
    "PlaceCalibration",
    "PositionParts",
    "Residuals",
    "RigFile",
    "RigOnBench",
    "RigServo",
    "RotaryCalibration",
    "Scene",
    "SearchConfig",
    "SlideCalibration",
    "SlideFingerConfig",
    "StageConfig",
    "TactileCalibration",
    "TipConfig",
    "TouchResidual",
    "UnusableTaxel",
    "WrappedArrayConfig",
    "add_finger_type",
    "apply_calibration",
    "calibration_path",
    "calibration_toml",
    "check_calibration",
    "geometry_sha256",
    "load_calibrated",
    "load_calibration",
    "load_contacts",
    "load_objects",
    "load_rig",
    "load_scene",
    "shipped_objects",
    "shipped_rig",
]
