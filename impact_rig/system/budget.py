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
"""What reading somebody's recording, campaign or configuration may cost, before it is refused; one way to raise it.

Memory has fixed limits; work is bounded in proportion to the size of the files. What is honest stays far below; what is
made to fill the memory or to run for ever is refused by the figure that gives it away. What a page may send is bounded
in `lab.protocol`.

Plain YAML holds values, never objects of Python, and a short text never stands for a long one: an alias names one value
in many places, or inside itself, and whoever prints or copies what was read pays for all of them.
"""

from __future__ import annotations

import math
import os
from typing import Any  # PyYAML's nodes

import attrs
import yaml
from yaml.composer import Composer

from impact_rig.errors import ImpactRigError

VARIABLE = "IMPACT_RIG_BUDGET"  # environment: every limit times this number, at least 1

MIB = 2**20
CHUNK_BYTES = 32 * MIB  # of a chunk when decompressed, and of every other record of a recording
HELD_BYTES = 64 * MIB  # of decompressed chunks that are in memory at once, because their messages are not in order
MESSAGE_BYTES = 500  # what a message in memory costs besides its content
INDEX_BYTES = 16 * MIB  # of the index of one file
DECOMPRESSED_BYTES, DECOMPRESSED_PER_BYTE = 64 * MIB, 250
"""Of all chunks together: so many, and so many per byte of the files."""
RECORDS, RECORDS_PER_BYTE = 100_000, 1
"""Records in all chunks together, messages above all: so many, and so many per byte of the files."""
TOPICS = 5000
QOS_CHARACTERS = 4 * MIB  # of the texts of all topics that say which quality of service was offered
METADATA_BYTES = 512 * 1024  # of `metadata.yaml`; one that lists a thousand files has half of that
POINTS = 20_000  # measurements that a campaign asks for, repetitions included


class BudgetError(ImpactRigError):
    """Something from outside asks for more than the budget."""


def allow(what: str, amount: float, limit: float) -> None:
    """Refuse `amount` of something if it is above `limit` times the factor in the environment.

    Raises:
        BudgetError: it is; names both and how to raise the limit.
    """
    if amount > limit and amount > limit * factor():
        now = f"{limit * factor():.0f}"
        raise BudgetError(f"{amount:.0f} {what}, more than {now}; if you trust it: {VARIABLE}=N allows N times as much")


def factor() -> float:
    """Return by how much the user has raised all limits.

    Raises:
        BudgetError: what the environment says is no number >= 1.
    """
    text = os.environ.get(VARIABLE, "1")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value >= 1.0:
        raise BudgetError(f"{VARIABLE} must be a number >= 1, got {text!r}")
    return value


@attrs.define
class Spending:
    """What one pass through the chunks of a recording has cost so far."""

    size: int  # of its files [bytes]
    _decompressed: int = attrs.field(default=0, init=False)
    _records: int = attrs.field(default=0, init=False)

    def chunk(self, size: int) -> None:
        """Take a chunk of `size` bytes into account, before it is decompressed.

        Raises:
            BudgetError: it is too large, or all are too large together.
        """
        allow("bytes in a chunk", size, CHUNK_BYTES)
        self._decompressed += size
        limit = DECOMPRESSED_BYTES + DECOMPRESSED_PER_BYTE * self.size
        allow(f"bytes in the chunks of {self.size} bytes of files", self._decompressed, limit)

    def records(self, count: int) -> None:
        """Take the records of a chunk into account.

        Raises:
            BudgetError: a chunk has too many to be held in memory, or all have too many together.
        """
        allow("records in a chunk", count, HELD_BYTES // MESSAGE_BYTES)
        self._records += count
        allow(f"records in {self.size} bytes of files", self._records, RECORDS + RECORDS_PER_BYTE * self.size)


_Fastest: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's scanner is fast; PyYAML may be built without
MAX_DEPTH = 100  # libyaml's loader takes the stack for each level, and all of it ends the process


class PlainYamlError(ValueError):
    """A text is not YAML, nested too deeply, or more than plain YAML."""


def load_yaml(text: str, limit: int) -> object:
    """Return what a plain YAML text of at most `limit` characters holds.

    Raises:
        PlainYamlError: it is longer, no YAML, has an alias, a key twice, or is nested deeper than `MAX_DEPTH`.
    """
    if len(text) > limit:
        raise PlainYamlError(f"it has more than {limit} characters")
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a date that is none
        raise PlainYamlError(" ".join(str(error).split())) from error


class _Loader(Composer, _Fastest):  # type: ignore[misc]  # chosen at run time
    """Refuses, while it composes the nodes, what a plain text has not got: nothing is read twice."""

    def __init__(self, text: str) -> None:
        Composer.__init__(self)
        _Fastest.__init__(self, text)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node."""
        if self.check_event(yaml.AliasEvent):
            raise PlainYamlError("an alias (*name) is not accepted")
        if self._depth >= MAX_DEPTH and self.check_event(yaml.SequenceStartEvent, yaml.MappingStartEvent):
            raise PlainYamlError(f"it is nested deeper than {MAX_DEPTH} levels")
        self._depth += 1
        node = Composer.compose_node(self, parent, index)
        self._depth -= 1
        if isinstance(node, yaml.MappingNode):
            _refuse_twice(node)
        return node


def _refuse_twice(mapping: yaml.MappingNode) -> None:
    """Refuse a key that is there twice: the later value would silently take the place of the first."""
    seen = set()
    for key, _ in mapping.value:
        if isinstance(key, yaml.ScalarNode):
            if (key.tag, key.value) in seen:
                raise PlainYamlError(f"the key {key.value!r} is there twice, again in line {key.start_mark.line + 1}")
            seen.add((key.tag, key.value))
