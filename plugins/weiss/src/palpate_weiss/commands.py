"""Commands and status codes of Weiss Robotics' tactile sensors."""

import enum

__all__ = ["DsaCommand", "DsaStatus", "WtsCommand", "WtsStatus"]


class WtsCommand(enum.IntEnum):
    """Commands of a WTS module; its answer has the same number."""

    LOOP = 0x06
    READ_FRAME = 0x20
    START = 0x21
    STOP = 0x22
    TARE = 0x23
    MATRIX_INFO = 0x30
    SET_MASK_WINDOW = 0x31
    SET_MASK = 0x32
    GET_MASK = 0x33
    SET_THRESHOLD = 0x34
    GET_THRESHOLD = 0x35
    SET_GAIN = 0x36
    GET_GAIN = 0x37
    SENSOR_TYPE = 0x38
    TEMPERATURE = 0x46
    SYSTEM_INFO = 0x50
    SET_TAG = 0x51
    GET_TAG = 0x52


class DsaCommand(enum.IntEnum):
    """Commands of the DSACON32 controller; its answer has the same number."""

    CONTROLLER_INFO = 0x01
    SENSOR_INFO = 0x02
    ACQUIRE = 0x03
    DESCRIPTOR = 0x05
    LOOP = 0x06
    STATE = 0x0A
    MATRIX_INFO = 0x0B
    SET_THRESHOLD = 0x13
    GET_THRESHOLD = 0x14


class WtsStatus(enum.IntEnum):
    """Status codes of the WTS, appendix A of its manual; those of the DSA differ from 12 on."""

    SUCCESS = 0
    NOT_AVAILABLE = 1
    NO_SENSOR = 2
    NOT_INITIALIZED = 3
    ALREADY_RUNNING = 4
    FEATURE_NOT_SUPPORTED = 5
    INCONSISTENT_DATA = 6
    TIMEOUT = 7
    READ_ERROR = 8
    WRITE_ERROR = 9
    INSUFFICIENT_RESOURCES = 10
    CHECKSUM_ERROR = 11
    NO_PARAM_EXPECTED = 12
    NOT_ENOUGH_PARAMS = 13
    CMD_UNKNOWN = 14
    CMD_FORMAT_ERROR = 15
    ACCESS_DENIED = 16
    ALREADY_OPEN = 17
    CMD_FAILED = 18
    CMD_ABORTED = 19
    INVALID_HANDLE = 20
    NOT_FOUND = 21
    NOT_OPEN = 22
    IO_ERROR = 23
    INVALID_PARAMETER = 24
    INDEX_OUT_OF_BOUNDS = 25
    CMD_PENDING = 26
    OVERRUN = 27
    RANGE_ERROR = 28
    AXIS_BLOCKED = 29
    FILE_EXISTS = 30


class DsaStatus(enum.IntEnum):
    """Status codes of the DSACON32."""

    SUCCESS = 0
    NOT_AVAILABLE = 1
    NO_SENSOR = 2
    NOT_INITIALIZED = 3
    ALREADY_RUNNING = 4
    FEATURE_NOT_SUPPORTED = 5
    INCONSISTENT_DATA = 6
    TIMEOUT = 7
    READ_ERROR = 8
    WRITE_ERROR = 9
    INSUFFICIENT_RESOURCES = 10
    CHECKSUM_ERROR = 11
    NOT_ENOUGH_PARAMS = 12
    CMD_UNKNOWN = 13
    CMD_FORMAT_ERROR = 14
    ACCESS_DENIED = 15
    ALREADY_OPEN = 16
    CMD_FAILED = 17
    CMD_ABORTED = 18
    INVALID_HANDLE = 19
    DEVICE_NOT_FOUND = 20
    DEVICE_NOT_OPENED = 21
    IO_ERROR = 22
    INVALID_PARAMETER = 23
    INDEX_OUT_OF_BOUNDS = 24
    CMD_PENDING = 25
    OVERRUN = 26
    RANGE_ERROR = 27
