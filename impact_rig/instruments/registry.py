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
"""Registry of the instruments: the instrument classes defined in this folder, by channel name in scan order."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

from impact_rig.instruments.instrument import Instrument

_DEFINES_ONE = re.compile(r"^class \w+\(Instrument\)", re.MULTILINE)


def _found() -> dict[str, type[Instrument]]:
    found: list[type[Instrument]] = []
    for path in Path(__file__).parent.glob("*.py"):
        if _DEFINES_ONE.search(path.read_text(encoding="utf-8")):
            module = importlib.import_module(f"{__package__}.{path.stem}")
            own = [kind for kind in vars(module).values() if getattr(kind, "__module__", None) == module.__name__]
            found += [kind for kind in own if isinstance(kind, type) and issubclass(kind, Instrument)]
    ordered = sorted(found, key=lambda instrument: instrument.place)
    places = [instrument.place for instrument in ordered]
    assert places == list(range(len(ordered))), f"the places of the instruments must be 0, 1, 2, …, got {places}"
    return {instrument.name: instrument for instrument in ordered}


INSTRUMENTS: dict[str, type[Instrument]] = _found()  # every instrument by the name of its channel, in scan order
