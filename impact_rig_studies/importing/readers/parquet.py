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
"""Reader of Parquet files, with pyarrow."""

from __future__ import annotations

import io
from pathlib import Path
from types import ModuleType
from typing import Any  # columns of pyarrow

from impact_rig_studies.importing.columns import signals_of
from impact_rig_studies.importing.limits import check_column_count, check_expanded_bytes, check_value_count
from impact_rig_studies.importing.signals import ImportedSignals


def reserve() -> None:
    """Make pyarrow's memory pool reserve its address space.

    Call this before the memory of the process is limited, so that the pool does not count against the limit.
    """
    pyarrow = __import__("pyarrow")
    pyarrow.allocate_buffer(1, memory_pool=pyarrow.default_memory_pool())


def read(path: Path, content: bytes, library: ModuleType) -> ImportedSignals:
    """Read all columns of a Parquet file as signals; `library` is `pyarrow.parquet`.

    Columns that cannot become a NumPy array are left out, with the reason for the user. Sizes are checked before
    decompression.

    Raises:
        BudgetError: the content is larger than a file of this size may contain, or has too many columns.
    """
    file = library.ParquetFile(io.BytesIO(content))
    check_column_count(file.metadata.num_columns)
    check_value_count(float(file.metadata.num_rows) * file.metadata.num_columns, len(content))
    groups = range(file.metadata.num_row_groups)
    check_expanded_bytes(sum(file.metadata.row_group(number).total_byte_size for number in groups), len(content))
    table = file.read(use_threads=False)
    units = {
        field.name: (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for field in file.schema_arrow
    }
    columns, left_out = {}, {}
    for name in table.column_names:
        try:
            columns[name] = _plain(table.column(name)).to_numpy()
        except (TypeError, ValueError, NotImplementedError) as error:  # those of pyarrow are derived from these
            left_out[name] = f"no numbers: {error}"[:100]
    return signals_of(path, "Parquet", columns, {name: unit for name, unit in units.items() if unit}, left_out=left_out)


def _plain(column: Any) -> Any:
    """Return a pyarrow column converted to a type that NumPy has: decimals to floats, dictionaries to their values."""
    kind = str(column.type)
    if kind.startswith("dictionary"):
        return column.cast(column.type.value_type)
    return column.cast("float64") if kind.startswith("decimal") else column
