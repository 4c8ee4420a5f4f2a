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
"""Guesses of drive frequency and gap from the name of a file.

The decimal sign in the name may be a point, a comma or `p`.
"""

from __future__ import annotations

import re
from itertools import pairwise

_NUMBER = r"(?<![\d.,])(\d{1,9}(?:[.,pP]\d{1,9})?)"
_FREQUENCY = re.compile(rf"(?<!\d-){_NUMBER}[\s_-]?([kK]?)[hH][zZ](?![a-z])")
_RATE_WORD = (
    r"(?:f_?s|(?<![a-z])(?:sr|s?rate)|(?:sampl(?:e|ing)|scan|data|frame|acq)[ _-]?rate|"
    r"sampl(?:ing|ed)(?:[ _-]?freq[a-z]*|[ _-]at)?|abtast[a-z]*)"
)
_OF_RATE = re.compile(rf"{_RATE_WORD}[\s_=:@.-]{{0,3}}$", re.IGNORECASE)
# atomic, as in `9Hz sampled at 1kHz` the word includes `at`
_IS_RATE = re.compile(rf"[\s_-]{{0,3}}(?>{_RATE_WORD})(?![a-z]|[\s_=:@.-]{{0,3}}\d)", re.IGNORECASE)
_BETWEEN = re.compile(rf"[\s_-]{{0,3}}{_RATE_WORD}[\s_=:@.-]{{0,3}}", re.IGNORECASE)
_LENGTH = re.compile(rf"{_NUMBER}[\s_-]?([mM][mM]|[µu]m)(?![a-z])")
_GAP_WORD = r"(?:gap|spalt|clearance|spiel)"
_OF_GAP = re.compile(rf"{_GAP_WORD}[\s_=:-]{{0,3}}$", re.IGNORECASE)
_IS_GAP = re.compile(rf"[\s_-]{{0,3}}{_GAP_WORD}", re.IGNORECASE)
_NO_SPHERE = re.compile(
    r"(?<![a-z])(?:no|without|ohne)[_ -]?(?:sphere|ball|damper|kugel|d[äa]mpfer)(?![a-z])|(?<![a-z])bare(?![a-z])",
    re.IGNORECASE,
)


def frequency_hz(stem: str) -> float | None:
    """Return the frequency [Hz] in a file name such as `messung_9,1Hz`, `sweep_8p5Hz`, `9.1 hz` or `1kHz`.

    The result is None if the name has no frequency above 0, or several different frequencies. Sampling rates, as in
    `fs_1000Hz` or `64kHz_sampling`, do not count.
    """
    found = [(one, _number(one[1]) * (1e3 if one[2] else 1.0)) for one in _FREQUENCY.finditer(stem)]
    rates, others = set[float](), set[float]()
    for (before, low), (after, high) in pairwise(found):
        if _BETWEEN.fullmatch(stem[before.end() : after.start()]):
            rates.add(max(low, high))
            others.add(min(low, high))
    for one, hz in found:
        if not _OF_RATE.search(stem[: one.start()]) and not _IS_RATE.match(stem[one.end() :]):
            others.add(hz)
    return _only(others - rates - {0.0})


def gap_m(stem: str) -> float | None:
    """Return the gap [m] in a file name such as `gap_0,5mm`, or 0 for a name such as `no_sphere`.

    A length next to a word such as `gap` takes precedence over other lengths. The result is None if the name has no
    length in mm or µm, or several different lengths.
    """
    if _NO_SPHERE.search(stem):
        return 0.0
    lengths = list(_LENGTH.finditer(stem))
    named = [one for one in lengths if _OF_GAP.search(stem[: one.start()])]
    named = named or [one for one in lengths if _IS_GAP.match(stem[one.end() :])]
    return _only({_number(one[1]) / (1e3 if one[2].lower() == "mm" else 1e6) for one in named or lengths})


def _only(values: set[float]) -> float | None:
    """Return the value if there is exactly one; None if there are no values or several."""
    return next(iter(values)) if len(values) == 1 else None


def _number(text: str) -> float:
    return float(text.replace(",", ".").replace("p", ".").replace("P", "."))
