"""Files that are there when they are complete, and never take the place of what they are made from."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from gatar_edge.errors import LogError


@contextlib.contextmanager
def written_whole(output: Path, sources: Sequence[Path]) -> Iterator[BinaryIO]:
    """A stream that becomes `output` once all is written and on the disk; nothing is left where something fails.

    Raises LogError where the file cannot be written, or is one of the logs that it is made from.
    """
    if output.exists() and not output.is_file():
        raise LogError(f"{output} cannot be written: it is no file")
    if output.exists() and any(output.samefile(source) for source in sources if source.exists()):
        raise LogError(f"{output} is a log that is read: give another name with -o")
    part = Path(f"{output}.part")
    try:
        with part.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, output)
    except OSError as error:
        raise LogError(f"{output} cannot be written: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
