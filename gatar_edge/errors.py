"""Everything that gatar-edge raises on purpose.

    GatarError                  one root, so that a caller can catch all of ours and nothing else
    ├── ConfigError             a configuration, command line or team string cannot be used
    ├── MessageError            bytes from a neighbour are not a message that may be used
    ├── ModelError              a model file cannot be read, or its contract is not ours
    ├── LogError                a log is unreadable, foreign, or of a future version
    ├── LinkError               a socket or serial port cannot be opened
    ├── WorldError              a map or scenario cannot be used
    ├── DeadlineError           an allocator did not answer in time
    └── MissingExtraError       a command needs an optional dependency that is not installed

Expected outcomes of a protocol (a refused mission, a lost link) are enum values, not exceptions. A message says what,
what was got, the limit, and the mend. The command line prints it as one line and exits with code 2.
"""

from __future__ import annotations

from enum import StrEnum


class GatarError(Exception):
    """Root of all errors that gatar-edge raises on purpose."""


class ConfigError(GatarError):
    """A configuration, command line or team string cannot be used."""


class MessageCause(StrEnum):
    """Why bytes are not a message: one per cause, so that a receiver can count them apart."""

    MALFORMED = "malformed"  # wrong length, or a value that no sender of ours writes
    VERSION = "version"  # another version of the format
    FORGED = "forged"  # signed with another key, or changed on the way


class MessageError(GatarError):
    """Bytes from a neighbour are not a message that may be used; `cause` says in which way."""

    def __init__(self, text: str, cause: MessageCause = MessageCause.MALFORMED) -> None:
        super().__init__(text)
        self.cause = cause


class ModelError(GatarError):
    """A model file cannot be read, or its contract is not ours."""


class LogError(GatarError):
    """A log is unreadable, foreign, or of a future version."""


class LinkError(GatarError):
    """A socket or serial port cannot be opened."""


class WorldError(GatarError):
    """A map or scenario cannot be used."""


class DeadlineError(GatarError):
    """An allocator did not answer in time."""


class MissingExtraError(GatarError):
    """A command needs an optional dependency that is not installed."""

    def __init__(self, command: str, extra: str, missing: str) -> None:
        super().__init__(f"{command} needs {missing}, which is not installed: pip install 'gatar-edge[{extra}]'")
