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
"""Targets of the lab's WebSocket: requests from a page, and the decoding of joint states for its drawing."""

from __future__ import annotations

import json
import math

from hypothesis import strategies as st

from fuzz.mutation import mutated
from fuzz.target import Target
from impact_rig.codec import encode_joint_state
from impact_rig_lab.protocol import LONGEST_TEXT, REQUESTS, parse
from impact_rig_lab.record import MotionBuffer

GOOD = [
    json.dumps(request).encode()
    for request in (
        {"id": 1, "do": "frequency", "value": 9.1},
        {"do": "ack", "frame": 12},
        {"do": "view", "span": 0.5, "columns": 600, "trigger": True, "spectrum": "laser", "top": 100},
        {
            "id": 2,
            "do": "sweep",
            "frequencies": [8.5, 9.1, 9.7],
            "direction": "up_down",
            "hold": "base",
            "target": 6e-5,
        },
        {"id": 3, "do": "fault", "kind": "dropout", "channel": "laser", "value": 0.1, "duration": 2, "rate": 10},
        {"id": 4, "do": "note", "value": "über <b>"},
        {"id": 5, "do": "stop"},
    )
]
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
NAMED = st.fixed_dictionaries(
    {"do": st.sampled_from(sorted(REQUESTS))},
    optional=dict.fromkeys(sorted({name for checks in REQUESTS.values() for name in checks} | {"id"}), VALUES),
).map(lambda request: json.dumps(request).encode())
JOINTS = [encode_joint_state(stamp, (1e-3, -2e-3, 3e-3), (0.1, 0.2, math.nan)) for stamp in (0, 10**18)]


def requests(raw: bytes) -> None:
    """Check that an accepted request has a known name and finite values, and can be published."""
    found = parse(raw)
    assert found.values.keys() == REQUESTS[found.do].keys()
    assert json.loads(json.dumps(dict(found.values), allow_nan=False)) is not None
    assert all(
        len(value) <= LONGEST_TEXT and value.isprintable()
        for value in found.values.values()
        if isinstance(value, str) and found.do != "load"  # a file, which the configuration's own reader checks
    )


def joint_states(raw: bytes) -> None:
    """Check that accepted joint states have three bodies."""
    motion = MotionBuffer()
    motion.add_state(raw, 0)
    assert motion.states.since(0).shape == (1, 7)


TARGETS = (
    Target("lab_socket", mutated(GOOD) | NAMED | st.binary(max_size=100), requests, ("impact_rig_lab/protocol.py",)),
    Target(
        "joint_state",
        mutated(JOINTS) | st.binary(max_size=120),
        joint_states,
        ("impact_rig_lab/record.py", "impact_rig/codec.py"),
    ),
)
