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
"""Limits on the cost of reading an untrusted recording, campaign or configuration, and one way to raise them.

Memory has fixed limits. Work is limited in proportion to the size of the files. Ordinary files stay far below both
limits. A file that exceeds a limit is rejected, and the error names the figure. A user who trusts a file raises all
limits with the environment variable IMPACT_RIG_BUDGET. (`impact_rig_lab.protocol` limits the messages of a web page.)

Plain YAML, which `load_yaml` reads, contains values, never Python objects, and no aliases. With aliases, a short text
could expand to an endless value.
"""

from __future__ import annotations

import math
import os
import sys
from typing import Any  # PyYAML's nodes

import attrs
import yaml
from yaml.composer import Composer

from impact_rig.errors import ImpactRigError

VARIABLE = "IMPACT_RIG_BUDGET"  # environment variable: factor for all limits, from 1 to inf

MIB = 2**20
CHUNK_BYTES = 32 * MIB  # limit of a decompressed chunk, and of every other record of a recording
# limit of the decompressed chunks that are in memory at the same time, because their messages are out of order
HELD_BYTES = 64 * MIB
MESSAGE_BYTES = 500  # memory overhead of a message
INDEX_BYTES = 16 * MIB  # limit of the index of one file
DECOMPRESSED_BYTES, DECOMPRESSED_PER_BYTE = 64 * MIB, 250
"""Limit of the decompressed bytes of all chunks together: a constant, plus a number per byte of the recording's files.
"""
RECORDS, RECORDS_PER_BYTE = 100_000, 1
"""Limit of the records (mostly messages) of all chunks together: a constant, plus a number per byte of the files."""
TOPICS = 5000
QOS_CHARACTERS = 4 * MIB  # limit of the texts of all topics that state the offered quality of service
METADATA_BYTES = 512 * 1024  # limit of `metadata.yaml`; half of it suffices for a thousand files
POINTS = 20_000  # limit of the measurements that a campaign requests, including repetitions


class BudgetError(ImpactRigError):
    """Error of an external input whose reading would need more memory or work than a limit allows."""


def allow(what: str, amount: float, limit: float) -> None:
    """Raise an error if the cost of reading something is above its limit, which `factor` raises.

    Args:
        what: unit of the cost as it follows the number in the message, such as `bytes in a chunk`.
        amount: the cost.
        limit: largest allowed cost, before it is multiplied by `factor`.

    Raises:
        BudgetError: `amount` is above the limit; the message names both, and how to raise the limit.
    """
    if amount > limit and amount > limit * factor():
        now = f"{limit * factor():.0f}"
        raise BudgetError(
            f"{amount:.0f} {what}, more than {now}; if you trust the source, set the environment variable "
            f"{VARIABLE}=N to allow N times the default"
        )


def factor() -> float:
    """Return the factor by which the environment variable IMPACT_RIG_BUDGET raises all limits; 1 if it is not set.

    `inf` removes all limits.

    Raises:
        BudgetError: the environment variable is not a number >= 1, for example empty.
    """
    text = os.environ.get(VARIABLE, "1")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value >= 1.0:
        raise BudgetError(f"the environment variable {VARIABLE} must be a number >= 1, got {text!r}")
    return value


def raised(limit: int) -> int:
    """Return a limit multiplied by `factor`, at most the largest size of an object in memory.

    Raises:
        BudgetError: the environment variable is not a number >= 1.
    """
    return int(min(limit * factor(), sys.maxsize))


@attrs.define
class ReadBudget:
    """Sums of the decompressed bytes and records in one pass through the chunks of a recording.

    A sum above its limit raises a `BudgetError`.

    Attributes:
        size: size of the recording's files [bytes]; the limits of the sums grow in proportion to it.
    """

    size: int
    _decompressed: int = attrs.field(default=0, init=False)
    _records: int = attrs.field(default=0, init=False)

    def chunk(self, size: int) -> None:
        """Add a chunk of `size` decompressed bytes to the sum; call this before it is decompressed.

        Raises:
            BudgetError: the chunk has more than 32 MiB, or all chunks so far have more than 64 MiB plus 250 times the
                size of the files. The environment variable `IMPACT_RIG_BUDGET` multiplies both limits.
        """
        allow("bytes in a chunk", size, CHUNK_BYTES)
        self._decompressed += size
        limit = DECOMPRESSED_BYTES + DECOMPRESSED_PER_BYTE * self.size
        allow(f"bytes in the chunks of {self.size} bytes of files", self._decompressed, limit)

    def records(self, count: int) -> None:
        """Add the `count` records of one chunk to the sum.

        Raises:
            BudgetError: the chunk has too many records for 64 MiB of memory (500 bytes each), or all chunks so far have
                more than 100,000 plus one per byte of the files.
        """
        allow("records in a chunk", count, HELD_BYTES // MESSAGE_BYTES)
        self._records += count
        allow(f"records in {self.size} bytes of files", self._records, RECORDS + RECORDS_PER_BYTE * self.size)


# libyaml's scanner is fast; PyYAML may have been built without it
_Fastest: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
MAX_DEPTH = 100  # libyaml's loader uses the stack for each level; a stack overflow would end the process


class PlainYamlError(ValueError):
    """Invalid YAML: too long, a syntax error, too deep nesting, an alias, a duplicate key or an unknown tag."""


def load_yaml(text: str, limit: int) -> object:
    """Return the value in a plain YAML text of at most `limit` characters; None for an empty text.

    Raises:
        PlainYamlError: the text is longer, invalid, has an alias, a duplicate key or several documents, or is nested
            deeper than 100 levels.
    """
    if len(text) > limit:
        raise PlainYamlError(f"it must have at most {limit} characters, got {len(text)}")
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: an invalid date
        raise PlainYamlError(" ".join(str(error).split())) from error


class _Loader(Composer, _Fastest):  # type: ignore[misc]  # chosen at run time
    """Loader that parses a text once: it raises PlainYamlError for an alias, a duplicate key or too deep nesting."""

    def __init__(self, text: str) -> None:
        Composer.__init__(self)
        _Fastest.__init__(self, text)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node of the document; PyYAML calls this.

        Raises:
            PlainYamlError: the node is an alias, has a key twice, or is nested too deep.
        """
        if self.check_event(yaml.AliasEvent):
            line = self.peek_event().start_mark.line + 1
            raise PlainYamlError(f"an alias (*name), as in line {line}, is not accepted; repeat the value")
        if self._depth >= MAX_DEPTH and self.check_event(yaml.SequenceStartEvent, yaml.MappingStartEvent):
            line = self.peek_event().start_mark.line + 1
            raise PlainYamlError(f"it is nested deeper than {MAX_DEPTH} levels in line {line}")
        self._depth += 1
        node = Composer.compose_node(self, parent, index)
        self._depth -= 1
        if isinstance(node, yaml.MappingNode):
            _refuse_twice(node)
        return node


def _refuse_twice(mapping: yaml.MappingNode) -> None:
    """Raise a PlainYamlError if a mapping has a key twice: the second value would silently replace the first."""
    seen = set()
    for key, _ in mapping.value:
        if isinstance(key, yaml.ScalarNode):
            if (key.tag, key.value) in seen:
                raise PlainYamlError(f"duplicate key {key.value!r} in line {key.start_mark.line + 1}")
            seen.add((key.tag, key.value))
