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
"""Reader of WAV files: PCM of 8 to 64 bits and floating point, with their real length."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from impact_rig.errors import RecordingError
from impact_rig_studies.importing.limits import check_column_count, check_value_count
from impact_rig_studies.importing.signals import ImportedSignals, Real, Signal, even_times

PCM, FLOAT, EXTENSIBLE = 1, 3, 0xFFFE
UNIT = "full scale"
_UNKNOWN_SIZE = (0, 0xFFFFFFFF)  # size of a chunk that was written to a stream


def read(path: Path, content: bytes) -> ImportedSignals:
    """Read all channels of a WAV file as signals `channel_0`, `channel_1`, ...; full scale is 1.

    If the file is shorter than its header claims, the existing samples are read, and `left_out` states how much is
    missing.

    Raises:
        RecordingError: the file is not a WAV file, its header is damaged, or its samples are neither PCM of up to 64
            bits nor floating point of 32 or 64 bits.
        BudgetError: the file has too many channels or values.
    """
    if content[:4] not in (b"RIFF", b"RIFX", b"RF64") or content[8:12] != b"WAVE":
        raise RecordingError(
            f"{path} is not a WAV file: it does not begin with RIFF, RIFX or RF64, a size and WAVE; correct its "
            "suffix, or convert it to WAV"
        )
    order = ">" if content[:4] == b"RIFX" else "<"
    form, data, claimed = _chunks(path, content, order)
    code, channels, rate, _, block, bits = struct.unpack(f"{order}HHIIHH", form[:16])
    if code == EXTENSIBLE and len(form) >= 28:
        code = struct.unpack(f"{order}I", form[24:28])[0]  # the first group of a GUID, in the order of the file
    if code not in (PCM, FLOAT):
        raise RecordingError(
            f"{path}: a WAV file of encoding {code:#x}; only PCM (1) and floating point (3) can be read; convert it"
        )
    width = block // channels if channels else 0
    if not (
        channels and rate and width in (1, 2, 3, 4, 5, 6, 7, 8) and block == width * channels and 0 < bits <= 8 * width
    ):
        raise RecordingError(
            f"{path}: damaged WAV header: {channels} channels, {rate} Hz, {bits} bits, {block} bytes for one sample of "
            "all channels; export the file again"
        )
    if code == FLOAT and width not in (4, 8):
        raise RecordingError(
            f"{path}: a WAV file of floating point with {8 * width} bits a sample; only 32 and 64 can be read; "
            "convert it"
        )
    check_column_count(channels)
    count = len(data) // block
    check_value_count(count * channels, len(content))
    values = _samples(data[: count * block], order, code, width, bits).reshape(count, channels)
    signals = {
        f"channel_{j}": Signal(
            np.ascontiguousarray(values[:, j]), UNIT, even_times(float(rate)), origin=f"channel {j + 1}"
        )
        for j in range(channels)
    }
    left_out = {}
    if claimed > len(data):
        left_out["end of the file"] = (
            f"the header claims {claimed // block} samples per channel, {count} are there: "
            f"{(claimed - len(data)) / claimed:.0%} is missing"
        )
    return ImportedSignals(path, "WAV", signals, left_out=left_out)


def _chunks(path: Path, content: bytes, order: str) -> tuple[bytes, memoryview, int]:
    """Return the format chunk of a WAV file, the bytes of its samples, and their size that the header claims.

    The claimed size [bytes] is larger than the number of returned bytes if the file was cut off. If the header leaves
    the size open, all bytes up to the end of the file are samples. `order` is the byte order, `<` or `>`.

    Raises:
        RecordingError: the file has no format or no samples.
    """
    form, at, wide = b"", 12, 0
    while at + 8 <= len(content):
        name, size = content[at : at + 4], struct.unpack(f"{order}I", content[at + 4 : at + 8])[0]
        begin = at + 8
        if name == b"ds64" and size >= 16:
            wide = struct.unpack(f"{order}Q", content[begin + 8 : begin + 16])[0]
        elif name == b"fmt ":
            form = content[begin : begin + size]
        elif name == b"data":
            if len(form) < 16:
                raise RecordingError(f"{path}: damaged WAV file: no format before its samples; export it again")
            if size == 0xFFFFFFFF and wide:
                size = wide
            there = len(content) - begin
            claimed = there if size in _UNKNOWN_SIZE else size
            return form, memoryview(content)[begin : begin + min(claimed, there)], claimed
        at = begin + size + size % 2
    raise RecordingError(f"{path}: damaged WAV file: it has no {'samples' if form else 'format'}; export it again")


def _samples(data: memoryview, order: str, code: int, width: int, bits: int) -> Real:
    """Return the samples of all channels, interleaved, as fractions of full scale, shape (n,).

    Args:
        data: bytes of the samples.
        order: byte order, `<` or `>`.
        code: encoding, `PCM` or `FLOAT`.
        width: bytes per sample, which determine full scale.
        bits: bits per sample that carry information.
    """
    if code == FLOAT:
        return np.frombuffer(data, f"{order}f{width}").astype(np.float64)
    if bits <= 8 and width == 1:
        return (np.frombuffer(data, np.uint8).astype(np.float64) - 128.0) / 128.0
    if width in (2, 4, 8):
        whole = np.frombuffer(data, f"{order}i{width}")
        return whole.astype(np.float64) / 2.0 ** (8 * width - 1)
    parts = np.frombuffer(data, np.uint8).reshape(-1, width)
    parts = parts if order == "<" else parts[:, ::-1]
    padded = np.zeros((len(parts), 8), np.uint8)  # the sample in the upper bytes of a 64-bit number
    padded[:, 8 - width :] = parts
    return padded.view("<i8").reshape(-1).astype(np.float64) / 2.0**63
