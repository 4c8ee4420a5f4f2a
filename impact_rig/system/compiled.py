# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled code is kept by the content of its sources; importing this module sees to it, before any is loaded.

Numba keeps compiled functions next to their sources and compiles one again when its own file has changed, but not when
a function it calls has: after an upgrade or an edit in place, old and new code would run mixed, or fail to load. Here
all compiled code of the package lives in one directory, named by a digest of every file that decides it. A branch
switch and back, a stash, or an edit of any other file throws nothing away, and code of other sources is never seen.

The directory is `__pycache__/compiled-<digest>` of the package; below `NUMBA_CACHE_DIR` where that is set, below the
user's cache directory where the package is not this user's alone. Of the digests, the last few that were used are kept.

What is loaded is run: a directory that somebody else can write, or put in the place of ours, is not used. What is
deleted was made here: such a directory holds `MARK`.
"""

from __future__ import annotations

import contextlib
import functools
import grp
import hashlib
import os
import pwd
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numba.core import caching, config

ROOT = Path(__file__).parents[1]
KEPT = 6
"""States of the sources whose compiled code is kept, the present one included."""

MARK = "Signature: 8a477f597d28d172789f06886806bc55\n# Compiled code of impact_rig, made anew when it is missing.\n"
"""What a directory that was made here says in its `CACHEDIR.TAG`, by which backups leave it out."""

_OURS = re.compile(r"compiled-[0-9a-f]{16}")
_HOLDS_COMPILED_CODE = re.compile(r"^(from|import) numba\b", re.MULTILINE)


def sources(root: Path = ROOT) -> list[Path]:
    """Return the files below `root` that decide compiled code.

    They are those that hold some, and those that these import from: Numba compiles imported constants in.
    """
    texts = {path: path.read_text(encoding="utf-8") for path in root.rglob("*.py")}
    holders = {path for path, text in texts.items() if _HOLDS_COMPILED_CODE.search(text)}
    imported = re.compile(rf"^from {root.name}\.([\w.]+) import", re.MULTILINE)
    found = set(holders)
    for holder in holders:
        for module in imported.findall(texts[holder]):
            stem = root.joinpath(*module.split("."))
            found.update({stem.with_suffix(".py"), stem / "__init__.py"} & texts.keys())
    return sorted(found)


def digest(root: Path = ROOT) -> str:
    """Return what tells one state of the compiled code's sources from another: their names and contents, no times."""
    found = hashlib.sha256()
    for path in sources(root):
        content = path.read_bytes()
        found.update(f"{path.relative_to(root).as_posix()} {len(content)}\n".encode())
        found.update(content)
    return found.hexdigest()[:16]


@functools.cache
def content_stamp(file: Path) -> str:
    """Return what tells one content of a file from another."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


class Locator(caching._CacheLocator):  # type: ignore[misc]  # Numba is untyped
    """Tells Numba where one function's compiled code is, and of which content of its file.

    For most files the directory's name says so; the force of a contact law, whose file says nothing of Numba, is
    compiled by itself and called by its address: no other code depends on it.
    """

    def __init__(self, function: Callable[..., object], directory: Path, file: Path) -> None:
        self._line = function.__code__.co_firstlineno
        self._directory = directory
        self._stamp = content_stamp(file)

    def get_cache_path(self) -> str:
        """Return the directory."""
        return str(self._directory)

    def get_source_stamp(self) -> str:
        """Return what the file's content decides, whatever the clock says."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name in one file apart."""
        return str(self._line)


class Cache:
    """The compiled code of the package at `root`, as its sources are now."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._name = f"compiled-{digest(root)}"

    def from_function(self, function: Callable[..., object], file: str) -> Locator | None:
        """Return where `function` is kept, or None if it is not of this package: Numba's question."""
        if not Path(file).is_relative_to(self._root):
            return None
        directory = self.directory or Path(self._of_this_process.name)
        return Locator(function, directory / Path(file).relative_to(self._root).parent, Path(file))

    @functools.cached_property
    def directory(self) -> Path | None:
        """The first of the possible places that can be written, and by nobody else; None: there is none."""
        for place in self._places():
            directory = place / self._name
            with contextlib.suppress(OSError, KeyError):
                place.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):
                    directory.mkdir(mode=0o700)
                    _mark(directory).write_text(MARK, encoding="utf-8")
                    _forget(place)
                if is_private(directory):
                    os.utime(directory)  # used now
                    return directory
        return None

    @functools.cached_property
    def _of_this_process(self) -> tempfile.TemporaryDirectory[str]:
        places = " or ".join(str(place) for place in self._places())
        sys.stderr.write(f"compiled code is not kept: nobody but this user may be able to write {places}\n")
        return tempfile.TemporaryDirectory(prefix="impact_rig_")

    def _places(self) -> Iterator[Path]:
        if config.CACHE_DIR:
            yield Path(config.CACHE_DIR)
        else:
            yield self._root / "__pycache__"
            yield Path(caching.AppDirs(appname=self._root.name, appauthor=False).user_cache_dir)


class Direct:
    """A compiled function that is called without Numba's look at the types of its arguments, after the first call.

    Where arguments are tuples of records that look takes a millisecond: more than the work of a block. It is needed
    once, as long as every call has the same types, which is the caller's promise: nothing checks it afterwards.

    Args:
        function: what `njit` made; where nothing is compiled, it is called as it is.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._call: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the function."""
        if self._call is not None:
            return self._call(*arguments)
        result = self._function(*arguments)
        compiled = list(getattr(self._function, "overloads", {}).values())
        self._call = compiled[0].entry_point if len(compiled) == 1 else self._function
        return result


def is_private(directory: Path) -> bool:
    """Whether nobody else can change what is in `directory`, or put another one in its place.

    It is this user's and written by no one else. Those above it are this user's or root's and written by no one else,
    or as /tmp is, where everybody moves only what is theirs. root is not counted as somebody else.

    Raises:
        OSError: it is not there.
        KeyError: this user has no name.
    """
    if directory.is_symlink() or directory.stat().st_uid != os.geteuid():
        return False
    path = directory.resolve(strict=True)
    return not _others_write(path.stat()) and all(
        above.st_uid in {0, os.geteuid()} and (above.st_mode & stat.S_ISVTX or not _others_write(above))
        for above in map(Path.stat, path.parents)
    )


def _others_write(status: os.stat_result) -> bool:
    """Whether the mode lets others write; a group of the user's name without other members is the user's own."""
    if status.st_mode & stat.S_IWOTH or not status.st_mode & stat.S_IWGRP:
        return bool(status.st_mode & stat.S_IWOTH)
    group = grp.getgrgid(status.st_gid)
    return bool(group.gr_mem) or group.gr_name != pwd.getpwuid(os.geteuid()).pw_name


def _mark(directory: Path) -> Path:
    return directory / "CACHEDIR.TAG"


def _made_here(directory: Path) -> bool:
    """Whether it is a directory of compiled code that this package made for this user."""
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return (
            _OURS.fullmatch(directory.name) is not None
            and not directory.is_symlink()
            and directory.stat().st_uid == os.geteuid()
            and _mark(directory).read_text(encoding="utf-8") == MARK
        )
    return False


def _forget(place: Path) -> None:
    """Delete all but the last used; a process that still runs such code has it in memory."""
    made = [directory for directory in place.iterdir() if _made_here(directory)]
    for directory in sorted(made, key=lambda path: path.stat().st_mtime_ns, reverse=True)[KEPT:]:
        shutil.rmtree(directory, ignore_errors=True)


def keep_by_content(root: Path = ROOT) -> None:
    """Let Numba ask for the package at `root` here before it looks elsewhere."""
    caching.CacheImpl._locator_classes.insert(0, Cache(root))


keep_by_content()
