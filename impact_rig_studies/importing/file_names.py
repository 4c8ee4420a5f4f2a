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
"""Frequency and gap in the name of a file: guesses, with decimal point, comma or `p`."""

from __future__ import annotations

import re

_NUMBER = r"(?<![\d.,])(\d{1,9}(?:[.,p]\d{1,9})?)"
_FREQUENCY = re.compile(rf"{_NUMBER}[\s_-]?(k?)hz(?![a-z])", re.IGNORECASE)
_GAP = re.compile(rf"{_NUMBER}[\s_-]?mm(?![a-z])", re.IGNORECASE)
_NO_SPHERE = re.compile(
    r"(?<![a-z])(?:no|without|ohne)[_ -]?(?:sphere|ball|damper|kugel|d[äa]mpfer)(?![a-z])|(?<![a-z])bare(?![a-z])",
    re.IGNORECASE,
)


def frequency_hz(stem: str) -> float | None:
    """Return the frequency in a name such as `messung_9,1Hz`, `sweep_8p5Hz` or `9.1 hz`; None: there is none."""
    match = _FREQUENCY.search(stem)
    value = _number(match[1]) * (1e3 if match[2] else 1.0) if match else 0.0
    return value if value > 0.0 else None


def gap_m(stem: str) -> float | None:
    """Return the gap in a name such as `gap_0,5mm` or `no_sphere` (0) [m]; None: there is none."""
    if _NO_SPHERE.search(stem):
        return 0.0
    match = _GAP.search(stem)
    return _number(match[1]) * 1e-3 if match else None


def _number(text: str) -> float:
    return float(text.replace(",", ".").replace("p", ".").replace("P", "."))
