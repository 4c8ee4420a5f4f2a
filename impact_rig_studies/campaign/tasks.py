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
"""Tasks of a map or dynamics study, which are measured in any order; one file each, so that a study can be resumed.

| file | content |
|---|---|
| `<what>.yaml` | the file of the study as it was given |
| `configuration.yaml` | the complete configuration of the rig |
| `<folder>/` | one file per task: its definition, the code that measured it, its rows |
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import sys
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import attrs

from impact_rig.config.tree import MAX_FILE_BYTES
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.names import quoted
from impact_rig.rig.config import RigConfig, differences, dump, load_config, to_flat
from impact_rig.system import budget, files
from impact_rig.system.budget import BudgetError
from impact_rig_studies.campaign.store import DECIDING, code_fingerprint

CONFIGURATION_FILE = "configuration.yaml"
MAX_TASK_BYTES = 64 * 2**20

Row = Sequence[str | float]  # result at one grid point: texts and numbers, NaN for missing numbers


class WorkItem(Protocol):
    """Interface of jobs and tasks, the units of measurement, which can be sent to a worker process."""

    @property
    def key(self) -> str:
        """Identifier of the job or task: a digest of the values that determine its result, without the code."""

    def describe(self) -> str:
        """Return a short name of the job or task for the reader."""


@attrs.frozen
class HashedTask:
    """Base class of tasks whose result depends on their attributes alone, so `key` is a digest of only these."""

    @property
    def key(self) -> str:
        """Identifier of the task: 16 hexadecimal digits, a digest of all its attributes, but not of the code."""
        return hashlib.sha256(json.dumps(attrs.asdict(self), sort_keys=True).encode()).hexdigest()[:16]


class Task(WorkItem, Protocol):
    """Task of a map or dynamics study, whose result is stored as rows."""

    def read(self, rows: Sequence[Row]) -> Sequence[Row]:
        """Check rows that were read from this task's file, and return them with the types of measured rows.

        Raises:
            ValueError: the number of rows or columns, or a value, cannot be that of a result of this task.
        """


K = TypeVar("K")
R = TypeVar("R")
T = TypeVar("T", bound=Task)
Runner = Callable[[Sequence[T]], Generator[tuple[T, Sequence[Row]], None, None]]
"""Function that measures tasks, in processes or on a cluster: it yields each task with its rows, in any order."""


@attrs.frozen
class TaskStore(Generic[T]):
    """Store of the results of a study's tasks, as one file each in the study's directory.

    Attributes:
        damaged: messages about damaged files found by `get`; their tasks must be measured again.
    """

    directory: Path
    what: str  # command of the study, such as `map`, and name of the file that defines it
    folder: str  # name of the folder with a file for each task
    rooms: tuple[str, ...]  # packages whose code determines the results, in addition to `DECIDING`
    damaged: list[str] = attrs.field(factory=list, init=False, eq=False)

    @property
    def file(self) -> Path:
        """Path of the YAML file in `directory` that defines the study."""
        return self.directory / f"{self.what}.yaml"

    def prepare(self, text: str, base: RigConfig) -> None:
        """Create the directory, and write the study's definition `text` and its rig `base` into it.

        In the directory of a study of the same kind and rig, this replaces the definition and keeps the results.

        Raises:
            RecordingError: the directory cannot be written, is not empty and has no file `<what>.yaml`, or contains
                results of another rig.
        """
        refuse_other_results(self.directory, self.what, base)
        with files.translate_errors(f"cannot write {self.directory}"):
            files.make_folder(self.directory / self.folder)
            files.write_text(self.file, text)
            files.write_text(self.directory / CONFIGURATION_FILE, dump(base))

    def configuration(self) -> RigConfig:
        """Read the configuration of the rig of the study in this directory.

        Raises:
            ConfigError: the directory is not one of the command `what`, or its configuration is invalid.
        """
        if not self.file.exists() or not (self.directory / self.folder).is_dir():
            raise ConfigError(
                f"{self.directory} holds no results of `impact-rig {self.what}`; `impact-rig {self.what} --help` shows "
                "how to create them"
            )
        return load_config(self.directory / CONFIGURATION_FILE)

    def code(self) -> str:
        """Return the package's version and a digest of its own sources that determine the results of this study."""
        return code_fingerprint((*DECIDING, *self.rooms))

    def get(self, task: T) -> Sequence[Row] | None:
        """Return the stored rows of a task, or None if the task must be measured.

        A task must be measured if it has no stored rows, if they are damaged (noted in `damaged`), or if other code
        measured them.
        """
        path = self._path(task)
        try:
            found = json.loads(files.read_bytes(path, MAX_TASK_BYTES))
            if found["key"] == task.key and found["code"] != self.code():
                return None
            if found["key"] == task.key:
                return task.read([[_number(value) for value in row] for row in found["rows"]])
            why = "it holds the result of another task"
        except FileNotFoundError:
            return None
        except KeyError as error:
            why = f"no entry {error}"
        except (TypeError, OverflowError, RecursionError):
            why = "its JSON is not that of a result"
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
        message = f"{path}, a stored result, is damaged, changed or unreadable: {' '.join(why.split())[:200]}"
        if message not in self.damaged:
            self.damaged.append(message)
        return None

    def put(self, task: T, rows: Sequence[Row]) -> None:
        """Write the rows of a task into its file; an earlier result is replaced.

        Raises:
            RecordingError: the result cannot be written.
        """
        plain = [[value if isinstance(value, str) or math.isfinite(value) else None for value in row] for row in rows]
        content = {"task": task.describe(), "key": task.key, "code": self.code(), "rows": plain}
        with files.translate_errors(f"cannot write {self.directory / self.folder}"):
            files.write_text(self._path(task), json.dumps(content) + "\n")

    def _path(self, task: T) -> Path:
        return self.directory / self.folder / f"{task.key}.json"


def _number(value: object) -> str | float:
    if value is None or isinstance(value, str):
        return math.nan if value is None else value
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > sys.float_info.max:
        raise ValueError(f"a stored value must be a finite number, null or text, got {quoted(value)}")
    return float(value)


def refuse_other_results(directory: Path, what: str, rig: RigConfig) -> None:
    """Check that a directory is new or empty, or contains the same kind of study for the same rig.

    A directory without a valid `configuration.yaml` is accepted if it contains the file `<what>.yaml`.

    Args:
        directory: the directory.
        what: kind of study, such as `map`, and name of the file that defines it.
        rig: rig of the study that will be written.

    Raises:
        RecordingError: the directory is not empty and has no file `<what>.yaml`, or it contains results of another rig;
            the message then names a value in which the rigs differ.
    """
    if directory.exists() and any(directory.iterdir()) and not (directory / f"{what}.yaml").exists():
        raise RecordingError(f"{directory} is not empty and has no {what}.yaml: choose another --output")
    try:
        kept = load_config(directory / CONFIGURATION_FILE)
    except ConfigError:  # none yet, damaged, or of another version
        return
    for name, value in differences(rig, kept).items():
        raise RecordingError(
            f"{directory} has results of a rig with {name} {to_flat(kept)[name]}, not {value}; a directory "
            "can have results of one rig only: choose another --output"
        )


def measure(
    tasks: Sequence[K],
    get: Callable[[K], R | None],
    put: Callable[[K, R], None],
    runner: Callable[[Sequence[K]], Generator[tuple[K, R], None, None]],
) -> Generator[tuple[K, R], None, None]:
    """Measure the tasks without a stored result, store the results, and yield every task with its result.

    Tasks with a stored result are yielded first, then each measured task as soon as its result is stored.

    Args:
        tasks: jobs or tasks.
        get: function that returns the stored result of a task, or None if the task must be measured.
        put: function that stores the result of a task.
        runner: function that measures tasks, and yields each with its result in any order.

    Raises:
        RecordingError: a result cannot be stored.
    """
    missing = []
    for task in tasks:
        result = get(task)
        if result is None:
            missing.append(task)
        else:
            yield task, result
    if not missing:
        return
    with contextlib.closing(runner(missing)) as measured:
        for task, result in measured:
            put(task, result)
            yield task, result


P = TypeVar("P")


def load_plan(path: Path, what: str, read: Callable[[object, str], P]) -> P:
    """Read the file of a campaign, map or dynamics study, and return the plan that `read` creates from it.

    Args:
        path: path of the YAML file.
        what: kind of file, for messages.
        read: function that checks the parsed YAML document (first argument), and creates the plan from it; the second
            argument is the text of the file.

    Raises:
        ConfigError: the file cannot be read or is wrong; the message ends with the path of the file.
        BudgetError: `read` rejects the study as too large.
    """
    try:
        text = str(files.read_bytes(path, MAX_FILE_BYTES), "utf-8")
        document = budget.load_yaml(text, MAX_FILE_BYTES)
    except OSError as error:
        raise ConfigError(f"cannot read {what}: {files.reason_unreadable(error, path)}") from error
    except ValueError as error:  # PlainYamlError, or not UTF-8
        why = "it must be UTF-8 text, " if isinstance(error, UnicodeDecodeError) else ""
        raise ConfigError(f"cannot be read as plain YAML: {why}{' '.join(str(error).split())} ({path})") from error
    try:
        return read(document, text)
    except (ConfigError, BudgetError) as error:
        raise type(error)(f"{error} ({path})") from error
