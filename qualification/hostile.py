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
"""Hostile recordings and campaigns, generated and run under every command: `python -m qualification.hostile`, a minute.

Each command must end within 5 s of CPU time, with a peak memory of at most 300 MB, the right exit code and at most one
line of error. (Wall time is printed as well; other work on the machine stretches it.) The command must touch no other
file and send no control character to the terminal. The table is shown in docs/explanation/reliability.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import attrs
import numpy as np
import zstandard
from rich.console import Console
from rich.table import Table as TextTable

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.cli.recorded import INCOMPLETE
from impact_rig.instruments.section import SCAN
from impact_rig.recording import schema_text
from impact_rig.recording.records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    SCHEMA,
    STATISTICS,
)  # fmt: skip

MIB = 2**20
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
MEMORY_LIMIT_MB, TIME_LIMIT_S = 300.0, 5.0
PATIENCE_S = 60.0
COMMANDS = ("info", "recover", "verify", "analyze", "export", "replay")
VICTIM = b"nobody may write here\n"
LAUGHS = "\n".join(f"- &a{i} [{', '.join([f'*a{i - 1}' if i else 'x'] * 9)}]" for i in range(12))
FAR_NS = 2**64 - 1


# --- recordings that lie --------------------------------------------------------------------------------------------


def record(opcode: int, content: bytes) -> bytes:
    """Return an MCAP record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    """Return a length-prefixed string."""
    return struct.pack("<I", len(value.encode())) + value.encode()


def message(log_time_ns: int, data: bytes) -> bytes:
    """Return a message of channel 1."""
    return record(MESSAGE, struct.pack("<HIQQ", 1, 0, log_time_ns, log_time_ns) + data)


def zeros(size: int) -> Iterator[bytes]:
    """Yield a message of `size` zeros."""
    yield struct.pack("<BQ", MESSAGE, 22 + size) + struct.pack("<HIQQ", 1, 0, 0, 0)
    yield from (bytes(MIB) for _ in range(size // MIB))
    yield bytes(size % MIB)


def scans(blocks: int = 3, at_ns: Callable[[int], int] = lambda number: number * 10_000_000) -> Iterator[bytes]:
    """Yield blocks of daq/scan as a real rig publishes them."""
    rows = np.zeros(100, SCAN)
    rows["time"] = np.arange(100) * 1e-4
    return (message(at_ns(i), codec.encode(Table(i * 10_000_000, rows))) for i in range(blocks))


def recording(
    path: Path,
    content: Iterable[bytes],
    *,
    topic: str = "/daq/scan",
    qos: str = "",
    listed: int = 1,
    count: int = 3,
    end_ns: int = 20_000_000,
    channels: int = 1,
) -> Path:
    """Write a recording with one chunk, given in pieces, that its index lists `listed` times.

    If there is more than one channel, the channels are defined in the chunk only, where only a recovery looks for them.
    """
    offered = text("offered_qos_profiles") + text(qos)
    schema = record(SCHEMA, struct.pack("<H", 1) + text(POINT_CLOUD) + text("ros2msg") + text(schema_text(POINT_CLOUD)))
    names = [topic, *(f"{topic}_{number}" for number in range(2, channels + 1))]
    channel = b"".join(
        record(CHANNEL, struct.pack("<HH", n, 1) + text(name) + text("cdr") + struct.pack("<I", len(offered)) + offered)
        for n, name in enumerate(names, 1)
    )
    compressor, packed, size, crc = zstandard.ZstdCompressor().compressobj(), b"", 0, 0
    for piece in itertools.chain([schema + channel] if channels > 1 else [], content):
        packed += compressor.compress(piece)
        size, crc = size + len(piece), zlib.crc32(piece, crc)
    packed += compressor.flush()
    head = MAGIC + record(HEADER, text("ros2") + text("hostile"))
    times = struct.pack("<QQ", 0, end_ns)
    chunk = record(
        CHUNK, times + struct.pack("<QI", size, crc) + text("zstd") + struct.pack("<Q", len(packed)) + packed
    )
    index = record(
        CHUNK_INDEX,
        times + struct.pack("<QQ", len(head), len(chunk)) + struct.pack("<I", 0) + struct.pack("<Q", 0) + text("zstd")
        + struct.pack("<QQ", len(packed), size),
    )  # fmt: skip
    counts = struct.pack("<IHQ", 10, 1, count * listed)
    statistics = record(STATISTICS, struct.pack("<QHIIIIQQ", count * listed, 1, 1, 0, 0, listed, 0, end_ns) + counts)
    data = head + chunk + record(DATA_END, struct.pack("<I", 0))
    summary = schema + channel + index * listed + statistics
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data + summary + record(FOOTER, struct.pack("<QQI", len(data), 0, 0)) + MAGIC)
    return path


def escapes(folder: Path) -> Path:
    """Write a recording with markup, colours and a window title in the names of file and topic."""
    tricks = "[/red]\x1b[31m\x1b]0;title\x07"
    return recording(folder / f"run [gap=2mm] {tricks} x" / "run.mcap", scans(), topic=f"/{tricks}/daq/scan")


def fifo(folder: Path) -> Path:
    """Create a named pipe in place of a recording, which never gets a writer."""
    run = folder / "fifo"
    run.mkdir()
    os.mkfifo(run / "fifo.mcap")
    return run


def endless(folder: Path) -> Path:
    """Create a link to a device without end."""
    run = folder / "endless"
    run.mkdir()
    (run / "endless.mcap").symlink_to("/dev/zero")
    return run


def large_metadata(folder: Path) -> Path:
    """Write a `metadata.yaml` of 9 MB."""
    path = recording(folder / "metadata" / "metadata.mcap", scans())
    lines = "".join(f"    - {{path: x, message_count: {i}}}\n" for i in range(240_000))
    path.with_name("metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  files:\n{lines}")
    return path.parent


def huge_plan(folder: Path) -> Path:
    """Write a campaign of 81 million points."""
    path = folder / "plan.yaml"
    axis = "{from: %s, to: %s, step: %s}"
    gaps, frequencies = axis % ("0.001", "0.01", "0.000001"), axis % ("8.0", "10.0", "0.000222")
    path.write_text(f"studies:\n  s:\n    frequencies_hz: {frequencies}\n    gaps_m: {gaps}\n")
    return path


RECORDINGS: dict[str, Callable[[Path], Path]] = {
    # 70 MB of zeros in a few kB, sixty times
    "compression bomb, indexed 60 times": lambda folder: recording(
        folder / "bomb.mcap", (message(0, bytes(MIB)) for _ in range(70)), listed=60, count=70
    ),
    # the same, once
    "chunk of 2 GB": lambda folder: recording(folder / "large.mcap", zeros(2_000_000_000), count=1),
    "7.7 million empty messages": lambda folder: recording(
        folder / "empty.mcap", (message(0, b"") * 77_000 for _ in range(100)), count=7_700_000
    ),
    "one chunk indexed 20,000 times": lambda folder: recording(folder / "repeated.mcap", scans(), listed=20_000),
    # of which one has messages
    "60,000 topics": lambda folder: recording(folder / "topics.mcap", scans(), channels=60_000),
    # which double and double
    "aliases in a QoS text": lambda folder: recording(folder / "aliases.mcap", scans(), qos=LAUGHS),
    "a QoS text inside itself": lambda folder: recording(folder / "self.mcap", scans(), qos="&a [*a]"),
    # a message 584 years later
    "log time 2⁶⁴ − 1": lambda folder: recording(
        folder / "late.mcap", scans(at_ns=(0, 10_000_000, FAR_NS).__getitem__), end_ns=FAR_NS
    ),
    "invalid topic name": lambda folder: recording(folder / "name.mcap", scans(), topic="/no name/daq/scan"),
    "escape sequences and markup": escapes,
    "FIFO": fifo,
    "link to /dev/zero": endless,
    "9 MB metadata.yaml": large_metadata,
    # an honest recording; links lie where its copies would be written first
    "links at predictable names": lambda folder: recording(folder / "links.mcap", scans()),
}
CAMPAIGNS: dict[str, Callable[[Path], Path]] = {
    "plan of 9,000 × 9,000": huge_plan,
    "/dev/zero as a file": lambda folder: folder / ".." / ".." / ".." / ".." / "dev" / "zero",
}
LEGIBLE = {
    "aliases in a QoS text": COMMANDS,
    "a QoS text inside itself": COMMANDS,
    "links at predictable names": COMMANDS,
    "log time 2⁶⁴ − 1": ("info", "recover", "export"),
    "invalid topic name": ("info", "recover", "export"),
    "escape sequences and markup": ("info", "recover", "export"),
}
"""Recordings that these commands read despite everything that is wrong with them; other commands reject them."""


def expected_code(command: str, what: str) -> int:
    """Return the correct exit code of a command for one of these inputs.

    None of the recordings contains a calibration or a journal, so nothing can be analysed or verified. A recovery does
    not need `metadata.yaml`, but without it cannot know whether there were more files.
    """
    if command == "recover" and what == "9 MB metadata.yaml":
        return INCOMPLETE
    return 0 if command in LEGIBLE.get(what, ()) and command not in ("verify", "analyze") else 1


# --- what commands make of them -------------------------------------------------------------------------------------


@attrs.frozen
class Cost:
    """Resources used by a command, and its result."""

    code: int  # exit code; negative: the signal that ended it
    wall_s: float  # wall time [s]
    cpu_s: float  # CPU time of the command alone [s]
    peak_mb: float  # peak memory [MB]
    output: str  # all output
    error: str  # output on stderr

    def faults(self, expected: int) -> list[str]:
        """Return deviations from the required behaviour apart from resources; `expected` is the exit code."""
        found = []
        if self.code != expected:
            found.append(f"exit code {self.code}, not {expected}")
        if "Traceback" in self.output or len(self.error.splitlines()) > 1:
            found.append("more than one line of error")
        if any(not (c.isprintable() or c == "\n") for c in self.output):
            found.append("control characters")
        return found


SERVER = f"""
import json, os, sys, time
import rich.table
from impact_rig.analysis import tracker
from impact_rig.cli import main
from impact_rig.cli.main import command_line
from impact_rig.runs import drawings, exports, info, reanalysis, recovery, verification
command_line()
write = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
for line in sys.stdin:
    folder, *words = json.loads(line)
    began = time.monotonic()
    child = os.fork()
    if not child:
        os.chdir(folder)
        for number, (name, how) in enumerate(((os.devnull, os.O_RDONLY), ("stdout", write), ("stderr", write))):
            os.dup2(os.open(name, how, 0o600), number)
        sys.argv = ["impact-rig", *words]
        sys.exit(main())
    while not (ended := os.wait4(child, os.WNOHANG))[0]:
        if time.monotonic() - began > {PATIENCE_S}:
            os.kill(child, 9)
        time.sleep(0.01)
    code, usage = os.waitstatus_to_exitcode(ended[1]), ended[2]
    wall_s, cpu_s = time.monotonic() - began, usage.ru_utime + usage.ru_stime
    print(json.dumps([code, wall_s, cpu_s, usage.ru_maxrss * 1024 / 1e6]), flush=True)
"""
"""Server that imports the common modules once, forks for each program and measures it. The peak memory includes that of
the imports.
"""


class Programs:
    """Runner of `impact-rig` for many calls; a context manager."""

    def __init__(self) -> None:
        self._server = subprocess.Popen(  # noqa: S603  # our own program
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip

    def __enter__(self) -> Programs:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.communicate()

    def cost(self, arguments: Sequence[str | Path], folder: Path) -> Cost:
        """Run the command with these arguments in a folder and return the resources it used."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(json.dumps([str(folder), *map(str, arguments)]).encode() + b"\n")
        self._server.stdin.flush()
        code, wall_s, cpu_s, peak_mb = json.loads(self._server.stdout.readline())
        written = [(folder / name).read_text(encoding="utf-8", errors="replace") for name in ("stdout", "stderr")]
        return Cost(code, wall_s, cpu_s, peak_mb, "".join(written), written[1])


def words(command: str, path: Path, folder: Path) -> list[str | Path]:
    """Return the arguments of a command on a recording; links to the victim are placed where it writes first."""
    out = folder / f"{command}_{path.name.encode().hex()[:20]}"
    if command == "recover":
        out.mkdir()
        (out / ".metadata.yaml.partial").symlink_to(folder / "victim")
        return [command, path, out]
    if command == "export":
        out.mkdir()
        (out / ".scan.csv.partial").symlink_to(folder / "victim")
        return [command, path, "daq/scan", out / "scan.csv"]
    if command == "replay":
        return [command, path, "--delay", "0", "--rate", "1000"]
    return [command, path]


def main() -> int:
    """Generate all inputs, measure all commands and print the table; return 1 if there is a deviation."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    table = TextTable(title="peak memory [MB] / CPU time [s] / wall time [s] / exit code")
    for heading in ("", *COMMANDS):
        table.add_column(heading, justify="left" if not heading else "right")
    troubles = []
    with tempfile.TemporaryDirectory() as name, Programs() as programs:
        folder = Path(name)
        (folder / "victim").write_bytes(VICTIM)
        for what, make in (RECORDINGS | CAMPAIGNS).items():
            path = make(folder)
            asked = [words(command, path, folder) for command in COMMANDS]
            if what in CAMPAIGNS:
                asked = [["campaign", path, "--output", folder / "campaign"], ["check", path]]
            costs = [programs.cost(arguments, folder) for arguments in asked]
            cells = [f"{one.peak_mb:.0f} / {one.cpu_s:.1f} / {one.wall_s:.1f} / {one.code}" for one in costs]
            table.add_row(what + (" (campaign, check)" if what in CAMPAIGNS else ""), *cells)
            for arguments, one in zip(asked, costs, strict=True):
                found = one.faults(expected_code(str(arguments[0]), what))
                if one.peak_mb > MEMORY_LIMIT_MB or one.cpu_s > TIME_LIMIT_S:
                    found.append("too many resources")
                troubles += [f"{arguments[0]}, {what}: {fault}: {one.output[-500:]!r}" for fault in found]
        if (folder / "victim").read_bytes() != VICTIM:
            troubles.append("a foreign file was written")
    Console(width=190, markup=False).print(table)
    print(*troubles, sep="\n")  # noqa: T201  # a tool talks
    return 1 if troubles else 0


if __name__ == "__main__":
    sys.exit(main())
