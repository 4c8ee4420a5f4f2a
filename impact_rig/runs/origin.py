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
"""Origin of an imported run: what was read from its file, what was assumed, and what was left out."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

SOURCE = "source.json"  # attachment of an imported run
LARGEST_BYTES = 4_000_000  # limit of the attachment [bytes]; the widest known source has about 100 channels
MOST_LISTED = 12  # maximum number of items listed individually


def origin(attachments: Mapping[str, bytes]) -> dict[str, str]:
    """Return the origin of an imported run (what was read, assumed and left out) as a text for each heading.

    `attachments` are the files stored inside the run, by name; the attachment `SOURCE` describes the origin. The result
    is empty if the run was not imported, or `SOURCE` is larger than `LARGEST_BYTES`. If `SOURCE` is damaged, the result
    says so under the heading `origin`.
    """
    text = attachments.get(SOURCE, b"")
    if not text or len(text) > LARGEST_BYTES:
        return {}
    try:
        return dict(_facts(json.loads(text)))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {"origin": f"unknown: the attachment {SOURCE} is damaged"}


def _facts(source: dict[str, object]) -> Iterator[tuple[str, str]]:
    signals = source["signals"]
    if not isinstance(signals, list):
        raise TypeError
    used = [one for one in signals if one["channel"]]
    yield "format", str(source["format"])
    for one in used[:MOST_LISTED]:
        unit = f" [{one['unit']}]" if one["unit"] else " without a unit"
        place = f" ({one['origin']})" if one["origin"] else ""
        yield f"channel {one['channel']}", f"{one['name']}{unit}{place}, {one['kind']} over {one['abscissa']}"
    unused = [f"{one['name']} ({one['kind']})" for one in signals if not one["channel"]]
    left_out = source["left_out"]
    if not isinstance(left_out, dict):
        raise TypeError
    reasons = [f"{name}: {why}" for name, why in left_out.items()]
    for what, texts in (("not used", unused), ("assumed", source["assumptions"]), ("left out", reasons)):
        if isinstance(texts, list) and texts:
            more = f"; and {len(texts) - MOST_LISTED} more" if len(texts) > MOST_LISTED else ""
            yield what, "; ".join(map(str, texts[:MOST_LISTED])) + more
