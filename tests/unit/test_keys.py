"""The team's key is read only from a file that nobody else may read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gatar_edge.errors import ConfigError
from gatar_edge.keys import DEMO_KEY, read_key

KEY = bytes(range(100, 132))


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "team.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("content", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"])
def test_a_key_may_be_raw_or_hexadecimal(tmp_path: Path, content: bytes) -> None:
    assert read_key(key_file(tmp_path, content)) == KEY


def test_raw_bytes_that_look_like_white_space_are_kept(tmp_path: Path) -> None:
    assert read_key(key_file(tmp_path, b" " * 31 + b"\n")) == b" " * 31 + b"\n"


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644, 0o620, 0o666])
def test_a_key_that_others_may_use_is_refused_with_the_mend(tmp_path: Path, mode: int) -> None:
    path = key_file(tmp_path, KEY, mode)
    with pytest.raises(ConfigError) as caught:
        read_key(path)
    assert str(caught.value) == f"key file {path} has mode {mode:04o}, so others may use it: chmod 600 {path}"


@pytest.mark.parametrize("mode", [0o600, 0o400])
def test_a_key_of_the_owner_alone_is_read(tmp_path: Path, mode: int) -> None:
    assert read_key(key_file(tmp_path, KEY, mode)) == KEY


@pytest.mark.parametrize("content", [b"", KEY[:31], KEY + b"\n", KEY.hex().encode()[:-1] + b"g", "é".encode() * 32])
def test_what_is_no_key_is_refused_without_showing_it(tmp_path: Path, content: bytes) -> None:
    path = key_file(tmp_path, content)
    with pytest.raises(ConfigError, match="does not hold 32 raw bytes or 64 hexadecimal digits") as caught:
        read_key(path)
    shown = str(caught.value).replace(str(path), "")
    assert not content or content.decode("latin-1") not in shown
    assert caught.value.__cause__ is None


def test_a_missing_key_file_is_named_with_the_way_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nothing\.key cannot be read \(No such file or directory\): make one with"):
        read_key(tmp_path / "nothing.key")


def test_a_folder_or_a_pipe_in_the_keys_place_is_refused_at_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe, 0o600)
    for path in (tmp_path, pipe):
        with pytest.raises(ConfigError, match="is not a file"):
            read_key(path)


def test_the_demonstration_key_is_a_whole_key_and_never_changes() -> None:
    assert len(DEMO_KEY) == 32
    assert DEMO_KEY.hex().startswith("5e6765109933f055")
