"""The mission client's states, events and outcomes: everything that moves `MissionClient` stands in TRANSITIONS."""

from __future__ import annotations

from enum import Enum

from gatar_edge.bridge.dialect import MissionResult


class Result(Enum):
    """How a transfer ended: one member per cause."""

    ACCEPTED = "on board"
    ALREADY_ON_BOARD = "on board already, nothing sent"
    DOWNLOADED = "downloaded"
    CLEARED = "cleared"
    CANCELLED = "given up for another transfer"
    NOT_SENDABLE = "an item is not finite, out of range, or there are none or too many"
    NO_ANSWER = "the vehicle did not answer"
    TIMEOUT = "not finished within the total time"
    DENIED = "another ground station is uploading"
    PEER_ERROR = "the vehicle answered ERROR"
    UNSUPPORTED_FRAME = "frame not supported"
    UNSUPPORTED = "command not supported"
    NO_SPACE = "too many items for the vehicle"
    INVALID = "an item is invalid"
    INVALID_PARAM1 = "param1 is invalid"
    INVALID_PARAM2 = "param2 is invalid"
    INVALID_PARAM3 = "param3 is invalid"
    INVALID_PARAM4 = "param4 is invalid"
    INVALID_PARAM5_X = "latitude is invalid"
    INVALID_PARAM6_Y = "longitude is invalid"
    INVALID_PARAM7 = "altitude is invalid"

    @property
    def ok(self) -> bool:
        """Whether what was asked for is done."""
        return self in (Result.ACCEPTED, Result.ALREADY_ON_BOARD, Result.DOWNLOADED, Result.CLEARED)


class Step(Enum):
    """What is being waited for."""

    IDLE = "nothing"
    COUNT = "the first request"
    ITEMS = "requests"
    LAST_ACK = "the final acknowledgement"
    LIST = "the vehicle's count"
    FETCH = "the vehicle's items"
    BACKOFF = "the other ground station"
    CLEAR = "the acknowledgement of clearing"


class Event(Enum):
    """What happened, from the state machine's point of view."""

    UPLOAD = "upload asked for"
    DOWNLOAD = "download asked for"
    CLEAR = "clearing asked for"
    REQUEST = "an item requested, others not yet"
    ALL_REQUESTED = "an item requested, and so all were"
    ACCEPTED = "ACK ACCEPTED that counts"
    DOUBTFUL = "ACK ACCEPTED that may be of an earlier transfer"
    DROPPED = "ACK OPERATION_CANCELLED: the vehicle gave up"
    DENIED = "ACK DENIED"
    ERROR = "ACK ERROR"
    REFUSED = "ACK with a reason"
    COUNTED = "the vehicle's count"
    SAME = "what is on board is what was sent"
    DIFFERENT = "what is on board is something else"
    COMPLETE = "the download is complete"
    SILENT = "nothing heard for too long"
    UNANSWERED = "re-sent too often"
    BACKED_OFF = "waited long enough"


_S, _E = Step, Event
TRANSITIONS: dict[Step, dict[Event, Step]] = {
    _S.IDLE: {
        _E.UPLOAD: _S.COUNT,
        _E.DOWNLOAD: _S.LIST,
        _E.CLEAR: _S.CLEAR,
        # a delayed COUNT has re-opened the upload on the vehicle, or this request is a late copy: find out
        _E.REQUEST: _S.LAST_ACK,
        _E.ALL_REQUESTED: _S.LAST_ACK,
    },
    _S.COUNT: {
        _E.REQUEST: _S.ITEMS,
        _E.ALL_REQUESTED: _S.LAST_ACK,
        _E.DENIED: _S.BACKOFF,
        _E.REFUSED: _S.IDLE,
        _E.UNANSWERED: _S.IDLE,
    },
    _S.ITEMS: {
        _E.REQUEST: _S.ITEMS,
        _E.ALL_REQUESTED: _S.LAST_ACK,
        _E.DROPPED: _S.COUNT,
        _E.REFUSED: _S.IDLE,
        _E.SILENT: _S.COUNT,
    },
    _S.LAST_ACK: {
        _E.REQUEST: _S.LAST_ACK,
        _E.ALL_REQUESTED: _S.LAST_ACK,
        _E.ACCEPTED: _S.IDLE,
        _E.DOUBTFUL: _S.LIST,
        _E.DROPPED: _S.COUNT,
        _E.REFUSED: _S.IDLE,
        _E.SILENT: _S.LIST,
    },
    _S.LIST: {
        _E.REQUEST: _S.LAST_ACK,
        _E.ALL_REQUESTED: _S.LAST_ACK,
        _E.ACCEPTED: _S.IDLE,
        _E.DROPPED: _S.COUNT,
        _E.REFUSED: _S.IDLE,
        _E.COUNTED: _S.FETCH,
        _E.DIFFERENT: _S.COUNT,
        _E.COMPLETE: _S.IDLE,
        _E.UNANSWERED: _S.IDLE,
    },
    _S.FETCH: {
        _E.REQUEST: _S.LAST_ACK,
        _E.ALL_REQUESTED: _S.LAST_ACK,
        _E.ACCEPTED: _S.IDLE,
        _E.DROPPED: _S.COUNT,
        _E.ERROR: _S.LIST,
        _E.COUNTED: _S.FETCH,  # PX4 rewinds at a duplicated LIST: from the start again
        _E.SAME: _S.IDLE,
        _E.DIFFERENT: _S.COUNT,
        _E.COMPLETE: _S.IDLE,
        _E.UNANSWERED: _S.LIST,
    },
    _S.BACKOFF: {
        _E.REQUEST: _S.ITEMS,
        _E.ALL_REQUESTED: _S.LAST_ACK,
        _E.BACKED_OFF: _S.COUNT,
    },
    _S.CLEAR: {
        _E.ACCEPTED: _S.IDLE,
        _E.ERROR: _S.IDLE,  # ArduPilot, armed and running it
        _E.DENIED: _S.IDLE,
        _E.REFUSED: _S.IDLE,
        _E.UNANSWERED: _S.IDLE,
    },
}

# MAV_MISSION_RESULT -> what it means to an upload; ACCEPTED needs more thought, INVALID_SEQUENCE means nothing:
# ArduPilot sends it for every late or doubled item and goes on.
ACK_EVENTS: dict[int, Event] = {
    MissionResult.ERROR: Event.ERROR,
    MissionResult.DENIED: Event.DENIED,
    MissionResult.OPERATION_CANCELLED: Event.DROPPED,
}

REFUSALS: dict[int, Result] = {
    code: Result[code.name]
    for code in MissionResult
    if MissionResult.UNSUPPORTED_FRAME <= code <= MissionResult.INVALID_PARAM7
}
