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
"""Files in directories that others may write to: what is opened is a regular file, what is written was never a link.

Reading never waits (a FIFO has no writer), never runs on (a device has no end) and stops at a limit. Writing goes to a
new file, which is put in place when it is complete: a link or file that another user created under its name is not
followed. What a killed process left of such a file is removed when the file is written again.

A lock is held by one process of this machine at a time and ends with it, however that ends. It is on a file in a
directory of this user, which stays and means nothing.

The package's own files: a checkout has `config/` and `launch/` next to the package; pip, colcon and Debian put them in
`share/impact_rig` of the prefix that holds the package (`<prefix>/lib/python3.x/site-packages/impact_rig`): a checkout
and an installed version never mix, as no environment variable is asked.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import fcntl
import io
import math
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np

from impact_rig.errors import ImpactRigError, RecordingError
from impact_rig.names import csv_cell
from impact_rig.system.endings import unhurried

T = TypeVar("T")
NEW_FILE = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
"""How a file is opened that must not be there yet, not even as a link."""


def open_regular(path: Path) -> int:
    """Return a descriptor of a regular file, open for reading.

    Raises:
        OSError: it cannot be opened, or is a directory, FIFO, socket or device.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a FIFO is not waited for
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
        OSError: it cannot be read, is no regular file, or is larger; nothing of a larger one is read.
    """
    with os.fdopen(open_regular(path), "rb") as file:
        if os.fstat(file.fileno()).st_size <= limit:
            content = file.read(limit + 1)
            if len(content) <= limit:
                return content
    raise OSError(errno.EFBIG, f"larger than {limit} bytes", str(path))


@contextlib.contextmanager
def written_whole(path: Path, *, replace: bool = True) -> Iterator[BinaryIO]:
    """Give a new file, open for writing, and put it in the place `path` after the block.

    If the block fails, nothing is left. What is in the place already is replaced, a link itself and not what it points
    to; or, with `replace=False`, kept.

    Args:
        path: where the file shall be.
        replace: whether something else may be there.

    Raises:
        OSError: the file cannot be made or put in its place; FileExistsError if it must not replace what is there.
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
        with unhurried():
            partial.unlink(missing_ok=True)


def _create_partial(path: Path) -> tuple[int, Path]:
    """Create the file that becomes `path`, locked while this process writes it, in the place of one that was left.

    Raises:
        OSError: it cannot be created.
    """
    usual = path.with_name(f".{path.name[:100]}.partial")
    with contextlib.suppress(OSError):
        left = os.open(usual, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            if stat.S_ISREG(os.fstat(left).st_mode):
                fcntl.flock(left, fcntl.LOCK_EX | fcntl.LOCK_NB)  # otherwise its writer lives
                usual.unlink()
        finally:
            os.close(left)
    for partial in (usual, path.with_name(f".{path.name[:100]}.{secrets.token_hex(8)}.partial")):
        try:
            descriptor = os.open(partial, NEW_FILE, 0o666)
        except FileExistsError:
            continue
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_nlink:
            return descriptor, partial
        os.close(descriptor)  # another process took it for one that was left
    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(usual))


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all; what is there is replaced.

    Raises:
        OSError: it cannot be written.
    """
    with written_whole(path) as file:
        file.write(text.encode())


def write_csv(path: Path, names: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table as CSV: numbers read back as the same doubles, NaN becomes an empty cell, no text is a formula.

    Raises:
        OSError: it cannot be written.
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
    """Prepare a directory for results and yield what `prepare` returns.

    If the block fails before it has added a file, a directory that was not there before is removed: a half-made one
    would look like a result, and would block the next attempt.

    Args:
        directory: the directory that `prepare` makes.
        prepare: function that makes the directory and writes what stands there before the first result.
    """
    is_new, prepared = not directory.exists(), set[Path]()
    try:
        found = prepare()
        prepared = set(directory.rglob("*")) if is_new else prepared
        yield found
    except BaseException:
        if is_new and prepared.issuperset(directory.rglob("*") if prepared else ()):
            shutil.rmtree(directory, ignore_errors=True)
        raise


def plain(value: object) -> object:
    """Return what JSON knows: no NaN, no infinity, no numpy, no bytes."""
    if isinstance(value, (bool, int, str)) or value is None:
        return value
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(item) for item in value]
    if isinstance(value, np.void):
        return {name: plain(value[name]) for name in value.dtype.names or ()}
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return int(value) if isinstance(value, np.integer) else bool(value) if isinstance(value, np.bool_) else str(value)


@contextlib.contextmanager
def errors_as(what: str) -> Iterator[None]:
    """Tell what the system refuses in the block as a `RecordingError`: what could not be done, and why."""
    try:
        yield
    except RecordingError:  # has its words already
        raise
    except OSError as error:
        raise RecordingError(f"{what}: {error.strerror}") from error


def make_folder(path: Path) -> None:
    """Make a folder within a directory of results, with its parents, unless it is there; never write through a link.

    Who may write to the directory could have laid out a link under the name that the folder always has, to a place
    that only its user may write to.

    Raises:
        OSError: it cannot be made, or is a link.
    """
    if not path.is_symlink():
        path.mkdir(parents=True, exist_ok=True)
    if path.is_symlink():
        raise OSError(errno.ELOOP, "it is a link, and nothing is written through one", str(path))


def state_dir(name: str) -> Path:
    """Return a folder for what the program keeps for this user between runs, made if it is missing.

    Where the user's folder of states (`XDG_STATE_HOME`, else `~/.local/state`) cannot be written, it is a new temporary
    one.
    """
    base = os.environ.get("XDG_STATE_HOME")
    with contextlib.suppress(OSError, RuntimeError):  # no home at all
        folder = (Path(base) if base else Path.home() / ".local" / "state") / "impact_rig" / name
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="impact_rig_"))


def refuse_foreign(directory: Path) -> None:
    """Refuse a directory, or a link to one, that belongs to somebody else: the owner can change what is in it.

    Raises:
        PermissionError: it does; the error says whose it is.
    """
    owners = {directory.stat().st_uid, directory.lstat().st_uid} - {os.geteuid()}
    if owners:
        raise PermissionError(errno.EPERM, f"it belongs to another user (id {min(owners)})", str(directory))


def _put(partial: Path, path: Path) -> None:
    """Move a file to a place where nothing is, not even a link that leads nowhere."""
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links: hold the place, then fill it
        os.close(os.open(path, NEW_FILE, 0o666))
        partial.replace(path)


LOCK_PARENTS = tuple(map(Path, ("/dev/shm", "/run/lock", "/var/tmp", "/tmp")))  # noqa: S108  # 0700 folders in these
"""Where the directory of locks may be. No variable decides: two jobs of one machine must find the same."""
PLACES = "impact_rig_places"  # folder of the locks on places in the graph


def place(domain_id: int, namespace: str) -> str:
    """Return the name of the lock that a rig of a domain and namespace holds."""
    return f"{domain_id}{namespace.replace('/', '.').rstrip('.')}"


def hold(folder: str, name: str) -> int | None:
    """Return the descriptor that holds a lock, until it is closed; None: it is held, by this process or another.

    Args:
        folder: where its file is, within `lock_directory`.
        name: of the lock, part of a file name.

    Raises:
        OSError: the file can be neither made nor opened, so there is no telling.
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
    """Return whether a lock is surely held by a process that did not take it by `hold`, and so means nothing."""
    holding = holder(folder, name)
    if not holding:  # nobody holds it, or a process in another container
        return False
    with contextlib.suppress(OSError):
        handle = _open(folder, name)
        try:
            return os.pread(handle, 32, 0) != b"%d" % holding
        finally:
            os.close(handle)
    return False


def holder(folder: str, name: str) -> int | None:
    """Return the id of the process that holds a lock; None: nobody does, or there is no telling."""
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
    """Return whether `hold` can tell who holds a lock."""
    try:
        os.close(_open(folder, name))
    except OSError:
        return False
    return True


def lock_directory() -> Path:
    """Return the directory of this user's locks: the same for all processes of the user, whatever their environment.

    Nobody else can open what is in it, so no other user can hold a lock, or lay out a link, there.

    Raises:
        OSError: no candidate can be used; names the last one and the reason.
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
            if status.st_uid != os.geteuid() or status.st_mode & 0o077:
                raise PermissionError(errno.EPERM, "other users may change what is in it", str(directory))
            if not os.access(directory, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(directory))
        except OSError as error:
            problem = error
        else:
            return directory
    raise problem


def _open(folder: str, name: str) -> int:
    """Open the file of a lock."""
    directory = lock_directory() / folder
    with contextlib.suppress(FileExistsError):
        directory.mkdir()
    return os.open(directory / f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)


_PACKAGE = Path(__file__).resolve().parents[1]


def share_dir(package: Path = _PACKAGE) -> Path:
    """Return the directory that holds `config/`, `launch/` and `package.xml`.

    Raises:
        ImpactRigError: the package was copied without them.
    """
    candidates = [package.parent, *(parent / "share" / package.name for parent in package.parents)]
    for candidate in candidates:
        if (candidate / "package.xml").is_file() and (candidate / "config").is_dir():
            return candidate
    raise ImpactRigError(f"config/ and package.xml are neither beside {package} nor in share/{package.name} above it")


def config_dir() -> Path:
    """Return the directory of the working configurations."""
    return share_dir() / "config"
