"""Everything that gatar-edge raises on purpose.

    GatarError                  one root, so that a caller can catch all of ours and nothing else
    ├── ConfigError             a configuration, command line or team string cannot be used
    ├── MessageError            bytes from a neighbour are not a message that may be used
    ├── ModelError              a model file cannot be read, or its contract is not ours
    ├── LogError                a log is unreadable, foreign, or of a future version
    ├── LinkError               a socket or serial port cannot be opened
    ├── WorldError              a map or scenario cannot be used
    └── MissingExtraError       a command needs an optional dependency that is not installed

Expected outcomes of a protocol (a refused mission, a lost link) are enum values, not exceptions. A message says what,
what was got, the limit, and the mend. The command line prints it as one line and exits with code 2.
"""

from __future__ import annotations


class GatarError(Exception):
    """Root of all errors that gatar-edge raises on purpose."""


class ConfigError(GatarError):
    """A configuration, command line or team string cannot be used."""


class MessageError(GatarError):
    """Bytes from a neighbour are not a message that may be used."""


class ModelError(GatarError):
    """A model file cannot be read, or its contract is not ours."""


class LogError(GatarError):
    """A log is unreadable, foreign, or of a future version."""


class LinkError(GatarError):
    """A socket or serial port cannot be opened."""


class WorldError(GatarError):
    """A map or scenario cannot be used."""


class MissingExtraError(GatarError):
    """A command needs an optional dependency that is not installed."""

    def __init__(self, command: str, extra: str, missing: str) -> None:
        super().__init__(f"{command} needs {missing}, which is not installed: pip install 'gatar-edge[{extra}]'")
