"""The fault codes: the one enumeration for loop, API, documents and tests."""

from enum import StrEnum


class FaultCode(StrEnum):
    """Reason why a run failed or a cell latched. `docs/reference/faults.md` explains each code; codes do not change."""

    FORCE_CEILING = "FORCE_CEILING"
    SENSOR_INVALID = "SENSOR_INVALID"
    SENSOR_STUCK = "SENSOR_STUCK"
    BIAS = "BIAS"
    STALE = "STALE"
    SOURCE = "SOURCE"
    PROTOCOL = "PROTOCOL"
    LINK = "LINK"
    POLICY_INVALID = "POLICY_INVALID"
    POLICY_DEADLINE = "POLICY_DEADLINE"
    BOUNDS = "BOUNDS"
    KINEMATICS = "KINEMATICS"
    SEARCH_LIMIT = "SEARCH_LIMIT"
    CONTACT_AT_START = "CONTACT_AT_START"
    PROTECTIVE_STOP = "PROTECTIVE_STOP"
    AUTHORITY = "AUTHORITY"
    CLIENT_LOST = "CLIENT_LOST"
    STOP_UNCONFIRMED = "STOP_UNCONFIRMED"
    OVERRUN = "OVERRUN"
    OPERATOR_STOP = "OPERATOR_STOP"
    INTERRUPTED = "INTERRUPTED"
    INTERNAL = "INTERNAL"
