# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""Numbers and functions for code that is not compiled: the same bits, but compiled code is loaded by the first call."""

from __future__ import annotations

PI = 3.141592653589793
TWO_PI = 6.283185307179586


def exp(x: float) -> float:
    """Return e^x as `elementary.exp` does."""
    from impact_rig.arithmetic import elementary  # noqa: PLC0415  # compiled: see above

    return float(elementary.exp(x))


def log(x: float) -> float:
    """Return ln x as `elementary.log` does."""
    from impact_rig.arithmetic import elementary  # noqa: PLC0415  # compiled: see above

    return float(elementary.log(x))
