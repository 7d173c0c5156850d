"""Compiled functions are never those of other sources."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

pytest.importorskip("numba")

import numba

from gatar_edge.learn import jit


@pytest.mark.parametrize("changed", ["learn/kernels.py", "absent.py", "allocators/tours.py"])
def test_a_change_of_any_source_leads_to_another_cache(changed: str, tmp_path: Path) -> None:
    package = tmp_path / "gatar_edge"
    for name in ("learn/kernels.py", "learn/train.py", *jit._CONSTANTS):
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(Path(jit.__file__).parent.parent / name, package / name)
    before = jit.digest_of(package)

    (package / "learn/train.py").write_text("# is not compiled\n")
    assert jit.digest_of(package) == before

    (package / changed).write_text((package / changed).read_text() + "\nSLOPE = 2\n")
    assert jit.digest_of(package) != before


def test_what_was_compiled_from_other_sources_is_removed(tmp_path: Path) -> None:
    old = jit.cache_folder(tmp_path, "0123")
    old.mkdir()
    (tmp_path / "somebody-else").mkdir()

    new = jit.cache_folder(tmp_path, "4567")
    new.mkdir()

    assert jit.cache_folder(tmp_path, "4567") == new
    assert sorted(path.name for path in tmp_path.iterdir()) == [new.name, "somebody-else"]


def test_this_package_compiles_into_the_cache_of_its_sources() -> None:
    assert jit.digest_of(Path(jit.__file__).parent.parent) in str(numba.config.CACHE_DIR)
