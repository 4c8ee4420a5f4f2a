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
"""Target of the server for nidaqmx: sequences of calls with any values, in any order."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st
from nidaqmx._stubs import nidaqmx_pb2 as messages

from fuzz.target import Target
from impact_rig.driver.daqmx_board import Board
from impact_rig.driver.daqmx_server import servicer
from impact_rig.errors import ImpactRigError
from impact_rig.rig.config import RigConfig

INT32, UINT32 = (-(2**31), 2**31 - 1), (0, 2**32 - 1)
TEXTS = st.sampled_from(
    ["", "t", "u", "Dev1/ai0", "Dev1/ai0:3", "Dev1/ai3:0", "Dev1/ao0", "/Dev1/ao/StartTrigger", "/Dev1/ai/StartTrigger"]
) | st.text(max_size=12)
ENUMERATORS = st.sampled_from([0, 1, 2, 6, 10178, 10123, 10348, 10097, 10158, 10186, 12470, 12509, 12510])
NUMBERS = st.sampled_from([0, 1, 2, 10, 200, 1000]) | ENUMERATORS
FLOATS = st.sampled_from([-10.0, -1.0, 0.0, 0.1, 1.0, 10.0, 100.0, 1000.0]) | st.floats()
SAMPLES = st.lists(FLOATS, max_size=20) | st.just([0.1] * 200)
ATTRIBUTES = st.sampled_from(
    [value for name, value in vars(messages).items() if "_ATTRIBUTE_" in name and isinstance(value, int)]
)
CALLS = (
    "CreateTask", "ClearTask", "StartTask", "StopTask", "TaskControl", "IsTaskDone", "WaitUntilTaskDone", "ResetDevice",
    "CreateAIVoltageChan", "CreateAIAccelChan", "CreateAOVoltageChan", "CfgSampClkTiming", "CfgDigEdgeStartTrig",
    "DisableStartTrig", "CfgInputBuffer", "CfgOutputBuffer", "ReadAnalogF64", "ReadAnalogScalarF64", "WriteAnalogF64",
    "WriteAnalogScalarF64", "GetErrorString", "GetReadAttributeUInt32", "GetTimingAttributeDouble",
    "GetTaskAttributeString", "GetChanAttributeInt32", "GetSystemInfoAttributeString", "GetDeviceAttributeString",
    "SetWriteAttributeInt32", "SetReadAttributeBool", "SetBufferAttributeUInt32", "SetTimingAttributeDouble",
    "ReadAnalogWaveforms", "WriteAnalogWaveforms", "GetChanAttributeDouble", "SetChanAttributeDouble",
)  # fmt: skip


class _RefusedError(ImpactRigError):
    pass


class _Context:
    """Context of a call whose client has disconnected, so that nothing waits."""

    def is_active(self) -> bool:
        return False

    def set_trailing_metadata(self, metadata: Any) -> None:
        assert dict(metadata)["ni-error"]

    def abort(self, _code: Any, message: str) -> None:
        raise _RefusedError(message)


def _field(field: Any) -> st.SearchStrategy[Any]:
    kinds = {
        field.CPPTYPE_DOUBLE: FLOATS, field.CPPTYPE_BOOL: st.booleans(), field.CPPTYPE_STRING: TEXTS,
        field.CPPTYPE_INT32: NUMBERS | st.integers(*INT32), field.CPPTYPE_UINT32: NUMBERS | st.integers(*UINT32),
        field.CPPTYPE_UINT64: NUMBERS | st.integers(0, 2**63), field.CPPTYPE_ENUM: NUMBERS,
    }  # fmt: skip
    if field.name == "write_array":
        return SAMPLES
    if field.name == "waveforms":
        return st.lists(st.builds(dict, y_data=SAMPLES), max_size=2)
    if field.name == "attribute_raw":
        return ATTRIBUTES | NUMBERS
    if field.cpp_type == field.CPPTYPE_MESSAGE:
        return st.builds(dict, name=st.sampled_from(["t", "t", "u", ""]))
    return kinds[field.cpp_type]


def _call(name: str) -> st.SearchStrategy[tuple[str, dict[str, Any]]]:
    fields = getattr(messages, f"{name}Request").DESCRIPTOR.fields
    given = {field.name: _field(field) for field in fields if field.containing_oneof is None or "raw" in field.name}
    return st.tuples(st.just(name), st.fixed_dictionaries({}, optional=given))


def _usual(*, output: bool) -> st.SearchStrategy[list[tuple[str, dict[str, Any]]]]:
    """Return the calls that make a task ready to start, so that later calls reach deeper."""
    task, kind = {"name": "t"}, "CreateAOVoltageChan" if output else "CreateAIVoltageChan"
    channel = {"physical_channel": "Dev1/ao0" if output else "Dev1/ai0:3", "min_val": -10.0, "max_val": 10.0}
    clock = {"rate": 1000.0, "sample_mode_raw": 10123, "samps_per_chan": 200}
    return st.just([
        ("CreateTask", {"session_name": "t"}), (kind, {"task": task, "units_raw": 10348, **channel}),
        ("CfgSampClkTiming", {"task": task, **clock}),
    ])  # fmt: skip


def daqmx(calls: list[tuple[str, dict[str, Any]]]) -> tuple[int, int]:
    """Check that a call succeeds or is rejected with an error of NI-DAQmx."""
    board, refused = Board(RigConfig()), 0
    service = servicer(board)
    try:
        for name, fields in calls:
            try:
                getattr(service, name)(getattr(messages, f"{name}Request")(**fields), _Context())
            except _RefusedError:
                refused += 1
    finally:
        board.close()
    return len(calls), refused


ANY = st.lists(st.one_of(*(_call(name) for name in CALLS)), min_size=1, max_size=8)
TARGETS = (
    Target(
        "daqmx",
        st.tuples(st.just([]) | _usual(output=False) | _usual(output=True), ANY).map(lambda parts: parts[0] + parts[1]),
        daqmx,
        ("impact_rig/driver/daqmx_board.py", "impact_rig/driver/daqmx_server.py"),
    ),
)
