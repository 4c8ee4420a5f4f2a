"""Arrays of records whose fields have names, in compiled code and in plain Python alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.core import config

DISABLED = bool(getattr(config, "DISABLE_JIT", False))
"""Whether compiled functions run as plain Python in this process."""


def records(count: int, kind: np.dtype[np.void]) -> Any:
    """Return `count` records of zeros; `records[i].field` reads and writes in place.

    Plain Python needs a recarray for that; to compiled code an ordinary array is the same and is handed over in a
    third of the time. A field must not be called like an attribute of NumPy's scalars (real, put, round, …).
    """
    assert not any(hasattr(np.record, name) for name in kind.names or ())
    made = np.zeros(count, kind)
    return made.view(np.recarray) if DISABLED else made
