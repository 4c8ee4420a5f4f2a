# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Safe files in directories that other users can write to: only regular files are read, and no link is written through.

Reading follows links, but never waits for a writer and stops at a limit. Writing creates a new file and moves it into
place when it is complete. It therefore never writes into a link or file that another user created under that name. If a
process is killed while it writes, its partial file remains until the next write of the same path removes it.

A lock is held by one process of this machine at a time, and is released when the process ends, for whatever reason. Its
file is in a directory of this user and stays there: that the file exists does not mean that the lock is held.

The functions `share_dir` and `config_dir` find the package's own files. A checkout has `config/` and `launch/` next to
the package. pip, colcon and Debian put them in `share/impact_rig` of the prefix that holds the package. No environment
variable decides, so a checkout and an installed version never mix.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import fcntl
import io
import itertools
import json
import math
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from impact_rig.errors import ImpactRigError, RecordingError
from impact_rig.names import csv_cell
from impact_rig.system.endings import defer_signals

T = TypeVar("T")
NEW_FILE = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
"""Flags for opening a file that must not exist yet, not even as a link."""
READ_BYTES = 2**20  # read at once: the limit of a file's size may exceed the memory


def open_regular(path: Path) -> int:
    """Return a descriptor of a regular file, open for reading.

    Raises:
        OSError: the file cannot be opened. Or it is a directory, FIFO, socket or device, or a link to one.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # do not wait for the writer of a FIFO
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return descriptor


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a regular file of at most `limit` bytes.

    Raises:
        OSError: the file cannot be read, is not a regular file, or is larger than `limit`.
    """
    with os.fdopen(open_regular(path), "rb") as file:
        if os.fstat(file.fileno()).st_size <= limit:  # 0 for a file that the system generates
            content = io.BytesIO()
            while content.tell() <= limit and (part := file.read(min(READ_BYTES, limit + 1 - content.tell()))):
                content.write(part)
            if content.tell() <= limit:
                return content.getvalue()
    raise OSError(errno.EFBIG, f"larger than {limit} bytes", str(path))


@contextlib.contextmanager
def atomic_write(path: Path, *, replace: bool = True) -> Iterator[BinaryIO]:
    """Yield a new file, open for writing, and move it to `path` at the end of the `with` block.

    The content of the file is on the disk (fsync) before the file is moved. If the block raises an error, the new file
    is removed and `path` stays as it was.

    Args:
        path: path of the file.
        replace: whether to replace an existing file or link (the link itself, not its target). Otherwise an existing
            file or link stays, and the end of the block raises FileExistsError.

    Raises:
        OSError: the file cannot be created or moved.
    """
    descriptor, partial = _create_partial(path)
    try:
        with os.fdopen(descriptor, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if replace:
            partial.replace(path)
        else:
            _put(partial, path)
    finally:
        with defer_signals():
            partial.unlink(missing_ok=True)


def _create_partial(path: Path) -> tuple[int, Path]:
    """Create and lock a temporary file, which is moved to `path` later, and return its descriptor and path.

    A temporary file for `path` that a killed process left behind is removed. If another process is writing to `path`
    now, the name of the temporary file gets a random part.

    Raises:
        OSError: the file cannot be created.
    """
    usual = path.with_name(f".{path.name[:100]}.partial")
    with contextlib.suppress(OSError):
        left = os.open(usual, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            if stat.S_ISREG(os.fstat(left).st_mode):
                fcntl.flock(left, fcntl.LOCK_EX | fcntl.LOCK_NB)  # otherwise its writer is alive
                usual.unlink()
        finally:
            os.close(left)
    for partial in (usual, path.with_name(f".{path.name[:100]}.{secrets.token_hex(8)}.partial")):
        try:
            descriptor = os.open(partial, NEW_FILE, 0o666)
        except FileExistsError:
            continue
        with contextlib.suppress(OSError):  # file systems without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_nlink:
            return descriptor, partial
        os.close(descriptor)  # another process mistook it for one left behind
    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(usual))


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, completely or not at all; an existing file is replaced.

    Raises:
        OSError: the file cannot be written.
    """
    with atomic_write(path) as file:
        file.write(text.encode())


def write_json(path: Path, content: object) -> None:
    """Write results as JSON, completely or not at all; an existing file is replaced.

    `plain` converts values for which JSON has no type: NaN and infinite numbers become null, for example.

    Raises:
        OSError: the file cannot be written.
    """
    write_text(path, json.dumps(plain(content), indent=2) + "\n")


def write_csv(path: Path, names: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table as CSV, completely or not at all; an existing file is replaced.

    Numbers are exact, so that reading them back gives the same doubles. NaN becomes an empty cell. A text that a
    spreadsheet would run as a formula gets an apostrophe in front.

    Raises:
        OSError: the file cannot be written.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(map(csv_cell, names))
    writer.writerows(
        ["" if isinstance(cell, float) and math.isnan(cell) else csv_cell(cell) for cell in row] for row in rows
    )
    write_text(path, text.getvalue())


@contextlib.contextmanager
def results_in(directory: Path, prepare: Callable[[], T]) -> Iterator[T]:
    """Call `prepare`, which creates a directory for results, and yield its return value to the `with` block.

    The directory is removed if `prepare` raises an error, or if the block raises one before it has added a file. A
    directory that existed before is not removed. A directory without results would make the next attempt fail.

    Args:
        directory: the directory that `prepare` creates.
        prepare: function that creates the directory and its initial files.
    """
    is_new, prepared = not directory.exists(), None
    try:
        found = prepare()
        prepared = set(directory.rglob("*")) if is_new else None
        yield found
    except BaseException:
        if is_new and (prepared is None or prepared.issuperset(directory.rglob("*"))):
            shutil.rmtree(directory, ignore_errors=True)
        raise


@contextlib.contextmanager
def staged(directory: Path) -> Iterator[Path]:
    """Yield a temporary folder for results, and move its content to `directory` at the end of the `with` block.

    If the block raises an error, the temporary folder is removed and `directory` stays as it was.

    Args:
        directory: existing or new directory; nothing in it is replaced.

    Raises:
        OSError: `directory` cannot be written, or contains a file of the same name as a result. In an existing
            directory, results that were moved before this one stay, and the others are removed.
    """
    directory = Path(os.path.abspath(directory))  # noqa: PTH100  # `resolve` would follow a link
    parent = directory if directory.is_dir() else directory.parent
    make_folder(parent)
    hidden = Path(tempfile.mkdtemp(prefix=f".{directory.name[:100]}.", suffix=".partial", dir=parent))
    folder = hidden / directory.name
    try:
        folder.mkdir()
        yield folder
        moves = [(folder, directory)]
        if parent is directory:  # it may be a mount, which cannot be replaced
            moves = [(path, directory / path.name) for path in sorted(folder.iterdir())]
        with defer_signals():
            for path, target in moves:
                if target.is_symlink() or target.is_file():  # a directory with content is refused by the system
                    why = f"{target.name} exists already and is not overwritten; choose another directory"
                    raise FileExistsError(errno.EEXIST, why, str(target))
                path.rename(target)
    finally:
        with defer_signals():
            shutil.rmtree(hidden, ignore_errors=True)


def plain(value: Any) -> object:  # Any: NumPy's types, without importing NumPy
    """Convert a value to types that JSON has, for output that other programs read.

    NaN and infinite numbers become None. NumPy values become plain numbers and lists. Bytes become text (UTF-8, with
    U+FFFD for invalid bytes). Mappings, lists and tuples are converted with all that they contain; the keys of mappings
    become text. Values of other types become the text that `str` gives.
    """
    if isinstance(value, (bool, int, str)) or value is None:
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if names := getattr(getattr(value, "dtype", None), "names", None):  # a record of NumPy, or an array of them
        return {name: plain(value[name]) for name in names} if not value.shape else [plain(row) for row in value]
    return plain(value.tolist()) if hasattr(value, "tolist") else str(value)


@contextlib.contextmanager
def translate_errors(what: str) -> Iterator[None]:
    """Turn an `OSError` in the `with` block into a `RecordingError` with the message "`what`: reason of the system".

    `what` says what failed, such as `cannot read FILE`. A `RecordingError` in the block passes unchanged.
    """
    try:
        yield
    except RecordingError:  # has its message already
        raise
    except OSError as error:
        raise RecordingError(f"{what}: {error.strerror}") from error


def free_path(path: Path) -> Path:
    """Return `path`, or if it exists the first of `path_2`, `path_3`, … that does not exist.

    Nothing is created or reserved.
    """
    numbered = (path.with_name(f"{path.name}_{number}") for number in itertools.count(2))
    return next(found for found in itertools.chain([path], numbered) if not found.exists())


def make_folder(path: Path) -> None:
    """Create a folder for results and its parents, if it does not exist yet, and refuse a link in its place.

    Such a link, created by another user, could lead to a directory that only this user may write to.

    Raises:
        OSError: the folder cannot be created, or is a link.
    """
    if not path.is_symlink():
        path.mkdir(parents=True, exist_ok=True)
    if path.is_symlink():
        why = "it is a link; links are not followed for writing: use a directory instead"
        raise OSError(errno.ELOOP, why, str(path))


def state_dir(name: str) -> Path:
    """Return the folder `impact_rig/<name>` for data that a program keeps between its runs, created if needed.

    Its parent is `XDG_STATE_HOME`, else `~/.local/state`. If the folder cannot be created, or this user has no
    permission to write into it, a new temporary folder is returned instead, whose data the next run does not find.
    """
    base = os.environ.get("XDG_STATE_HOME")
    with contextlib.suppress(OSError, RuntimeError):  # no home directory
        folder = (Path(base) if base else Path.home() / ".local" / "state") / "impact_rig" / name
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="impact_rig_"))


def refuse_foreign(directory: Path) -> None:
    """Raise an error if a directory, or the link at this path, belongs to another user, who could change its content.

    Raises:
        PermissionError: another user owns it; the message has the id of that user.
    """
    owners = {directory.stat().st_uid, directory.lstat().st_uid} - {os.geteuid()}
    if owners:
        why = f"it belongs to another user (id {min(owners)}), who could change its content: choose another directory"
        raise PermissionError(errno.EPERM, why, str(directory))


def _put(partial: Path, path: Path) -> None:
    """Put a file at a path that must not exist, not even as a dangling link; raise FileExistsError if it exists.

    `partial` may remain, as a hard link to the same file; the caller removes it.
    """
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links: reserve the name, then replace it
        os.close(os.open(path, NEW_FILE, 0o666))
        partial.replace(path)


LOCK_PARENTS = tuple(map(Path, ("/dev/shm", "/run/lock", "/var/tmp", "/tmp")))  # noqa: S108  # 0700 folders
"""Directories in which the directory of locks can be; the first one in which it can be used is chosen.

No environment variable decides, because all programs of a user on one machine must find the same locks.
"""
PLACES = "impact_rig_places"  # folder of the locks by which rigs reserve a ROS domain and namespace


def place(domain_id: int, namespace: str) -> str:
    """Return the name of the lock by which one rig reserves its ROS domain and namespace: `7.cell` for 7 and `/cell`.

    For the root namespace, it is only the number. The lock is in the folder `PLACES`.
    """
    return f"{domain_id}{namespace.replace('/', '.').rstrip('.')}"


def hold(folder: str, name: str) -> int | None:
    """Acquire a lock; return the descriptor that holds the lock until closed, or None if the lock is already held.

    Args:
        folder: folder of the lock's file, within `lock_directory`.
        name: name of the lock, used in the file name.

    Raises:
        OSError: the file can be neither created nor opened, so the state of the lock is unknown.
    """
    handle = _open(folder, name)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    with contextlib.suppress(OSError):
        os.ftruncate(handle, 0)
        os.pwrite(handle, b"%d" % os.getpid(), 0)
    return handle


def is_held_by_others(folder: str, name: str) -> bool:
    """Return whether a lock is certainly held by a process that did not acquire it with `hold`, so it is no rig or lab.

    `hold` writes the id of its process into the lock's file. The result is True if the process that holds the lock
    has another id. It is False if the lock is free or its holder is unknown, for example in another container.
    """
    holding = holder(folder, name)
    if not holding:  # the lock is free, or its holder is in another container
        return False
    with contextlib.suppress(OSError):
        handle = _open(folder, name)
        try:
            return os.pread(handle, 32, 0) != b"%d" % holding
        finally:
            os.close(handle)
    return False


def holder(folder: str, name: str) -> int | None:
    """Return the id of the process that holds a lock; None if it is free or the holder is unknown."""
    try:
        handle = _open(folder, name)
    except OSError:
        return None
    try:
        inode = os.fstat(handle).st_ino
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()  # number: FLOCK ADVISORY WRITE process major:minor:inode begin end
            if words[1] == "FLOCK" and words[5].rpartition(":")[2] == str(inode):
                return int(words[4])
    except (OSError, ValueError, IndexError):
        return None
    finally:
        os.close(handle)
    return None


def can_hold(folder: str, name: str) -> bool:
    """Return whether the file of a lock can be opened, so that `hold` can find out if the lock is free.

    The file is created if it does not exist.
    """
    try:
        os.close(_open(folder, name))
    except OSError:
        return False
    return True


def lock_directory() -> Path:
    """Return the directory of this user's locks, which is the same for all processes; it is created if needed.

    No other user can open its files, so no other user can hold a lock or create a link there.

    Raises:
        OSError: the directory cannot be used in any of `LOCK_PARENTS`. The error has path and reason of the last one.
    """
    problem = OSError(errno.ENOENT, os.strerror(errno.ENOENT), str(LOCK_PARENTS))
    for parent in LOCK_PARENTS:
        directory = parent / f"impact_rig-{os.geteuid()}"
        try:
            with contextlib.suppress(FileExistsError):
                directory.mkdir(mode=0o700)
            status = directory.lstat()
            if not stat.S_ISDIR(status.st_mode):
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(directory))
            if status.st_uid != os.geteuid():
                raise PermissionError(errno.EPERM, "it belongs to another user, who must delete it", str(directory))
            if status.st_mode & 0o077:
                open_to_others = "other users may open it: delete it, or set its mode to 700"
                raise PermissionError(errno.EPERM, open_to_others, str(directory))
            if not os.access(directory, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(directory))
        except OSError as error:
            problem = error
        else:
            return directory
    raise problem


def _open(folder: str, name: str) -> int:
    """Open the file of a lock and return its descriptor; this does not acquire the lock.

    The file and its folder are created if needed.
    """
    directory = lock_directory() / folder
    with contextlib.suppress(FileExistsError):
        directory.mkdir()
    return os.open(directory / f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)


_PACKAGE = Path(__file__).resolve().parents[1]


def share_dir(package: Path = _PACKAGE) -> Path:
    """Return the directory that contains `config/`, `launch/` and `package.xml`: the source tree or the installed one.

    Args:
        package: directory of the Python package.

    Raises:
        ImpactRigError: the package was copied without them.
    """
    candidates = [package.parent, *(parent / "share" / package.name for parent in package.parents)]
    for candidate in candidates:
        if (candidate / "package.xml").is_file() and (candidate / "config").is_dir():
            return candidate
    raise ImpactRigError(
        f"config/ and package.xml are neither next to {package} nor in share/{package.name} of a "
        "directory above it: reinstall the package"
    )


def config_dir() -> Path:
    """Return the directory `config/` with the configuration files of the package, such as `nominal.yaml`.

    Raises:
        ImpactRigError: the package was copied without it.
    """
    return share_dir() / "config"


def reason_unreadable(error: OSError, path: Path) -> str:
    """Return a text for users that says why a file cannot be read, with its path.

    For a relative path that does not exist, the text also names the file with this path in the package, such as
    `config/nominal.yaml`, if there is one.
    """
    text = f"{error.strerror} ({path})"
    if isinstance(error, FileNotFoundError) and not path.is_absolute():
        with contextlib.suppress(ImpactRigError):  # without these files, the first part is all that there is to say
            installed = share_dir() / path
            if installed.is_file():
                text += f"; the package has {installed}"
    return text
