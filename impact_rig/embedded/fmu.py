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
"""Rig as a co-simulation unit (FMU) of FMI 2.0 or 3.0: fmu.c compiled with rig.c and the kernels, without Python."""

from __future__ import annotations

import html
import platform
import subprocess
import tempfile
import uuid
import zipfile
from pathlib import Path

import numpy as np

from impact_rig import __version__, embedded
from impact_rig.blocks import TRUTH_SCAN_COLUMNS
from impact_rig.embedded.snapshot import SETUP, snapshot
from impact_rig.errors import ImpactRigError
from impact_rig.kernels.build import FOLDER, OBJECT, compiler
from impact_rig.physics.sampling import QUANTITIES
from impact_rig.rig.config import RigConfig
from impact_rig.rig.interlock import amplitude_limit
from impact_rig.system.files import atomic_write

HERE = Path(__file__).parent
VERSIONS = embedded.VERSIONS
PLATFORMS = {
    "3.0": {"x86_64": "x86_64-linux", "aarch64": "aarch64-linux"},
    "2.0": {"x86_64": "linux64", "aarch64": "linuxaarch64"},
}
"""Folder of the compiled rig within an FMU, by version of FMI and machine."""
MODEL = "impact_rig"
DRIVES = ("sine", "zero_order", "first_order")
"""Kinds of drive: a sine, or a stream with either interpolation. fmu.c knows them by their index."""
NAMES = {"current": "coil_current"}
"""Output variables of an FMU whose names differ from those of the quantities, because an input has that name."""
MOTION, IMPACTS, READINGS = 10, 30, 40
"""First FMI value references of the motion, the number of impacts and the readings, as in fmu.c."""
UNITS = dict(zip(QUANTITIES, ("m", "m", "m", "m/s", "m/s", "m/s", "m/s2", "m/s2", "m/s2", "A", "N", "N"), strict=True))
ABOUT = {column.name: column.doc.rstrip(".") for column in TRUTH_SCAN_COLUMNS}


def write_fmu(config: RigConfig, path: Path, version: str = VERSIONS[0], kernels: Path = FOLDER) -> None:
    """Write a co-simulation unit (FMU) of a rig; an existing file is replaced.

    Args:
        config: configuration of the rig. The FMU has the gap as a parameter, and drive signals as inputs; all other
            values are fixed. With a sine, the inputs are `frequency` [Hz] and the amplitude `current`. With the
            waveform "stream", `current` is the only input: the sample of the drive in each step. `current` is in the SI
            unit of `drive.kind`.
        path: path of the file to write.
        version: version of FMI, one of `VERSIONS`.
        kernels: folder of the compiled kernels; kernels of another machine need its cross compiler, named in the
            environment variable CC.

    Raises:
        ConfigError: rig.c does not support this rig, see `snapshot`.
        ImpactRigError: the folder contains no kernels, or the C compiler is missing or fails.
        OSError: the file cannot be written.
    """
    data = snapshot(config)
    row = np.frombuffer(data[: SETUP.itemsize], SETUP)[0]
    is_sine, high = _drive(config) == "sine", row["highest_amplitude"]
    frequency = f"frequency must be >= {row['lowest_hz']:g} and <= {row['highest_hz']:g} Hz, " if is_sine else ""
    least, unit = 0.0 if is_sine else -high, amplitude_limit(config.drive, config.shaker)[1]
    token = f"{{{uuid.uuid5(uuid.NAMESPACE_URL, f'{version} {_drive(config)} {data.hex()}')}}}"
    if not (kernels / OBJECT).exists():
        raise ImpactRigError(f"{kernels / OBJECT} is missing: run `python -m impact_rig.kernels.build {kernels}`")
    with tempfile.TemporaryDirectory(prefix="impact_rig_fmu_") as name:
        work = Path(name)
        numbers = ",".join(map(str, data))
        (work / "snapshot.h").write_text(
            f'#define SNAPSHOT_TOKEN "{token}"\n#define SNAPSHOT_FREQUENCY {config.drive.frequency_hz!r}\n'
            f"#define SNAPSHOT_DRIVE {DRIVES.index(_drive(config))}\n"
            f'#define SNAPSHOT_INPUTS "{frequency}current must be >= {least:.4g} and <= {high:.4g} {unit}"\n'
            f'#define SNAPSHOT_GAPS "gap must be >= {row["shortest_gap_m"]:g} and <= {row["longest_gap_m"]:g} m"\n'
            f"static const unsigned char snapshot[] = {{{numbers}}};\n"
        )
        machine = _compile(work, kernels)
        with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as fmu:
            fmu.writestr("modelDescription.xml", _description(config, row, version, token))
            fmu.write(work / f"{MODEL}.so", f"binaries/{PLATFORMS[version][machine]}/{MODEL}.so")


def _drive(config: RigConfig) -> str:
    return config.drive.stream_hold if config.drive.waveform == "stream" else config.drive.waveform


def _compile(work: Path, kernels: Path) -> str:
    """Compile the FMU's shared library into the folder `work`; return the compiler's target machine, such as `x86_64`.

    Raises:
        ImpactRigError: the C compiler is missing or fails.
    """
    sources = [str(HERE / "fmu.c"), str(HERE / "rig.c"), str(kernels / OBJECT)]
    options = ["-shared", "-fPIC", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", f"-I{work}", f"-I{kernels}"]
    command = [*compiler(), *options, *sources, "-o", str(work / f"{MODEL}.so"), "-lm"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  # the user's compiler
        made = subprocess.run([*compiler(), "-dumpmachine"], capture_output=True, text=True, check=False)  # noqa: S603
    except OSError as error:
        raise ImpactRigError(
            f"an FMU needs a C compiler ({compiler()[0]}: {error.strerror}): install gcc, or name another in CC"
        ) from None
    if done.returncode:
        errors = (line for line in done.stderr.splitlines() if "error" in line)
        why = next(errors, f"exit code {done.returncode}")
        raise ImpactRigError(
            f"the FMU cannot be built with the compiled kernels in {kernels} by {compiler()[0]} (CC): {why}; check "
            "that CC compiles for the machine of these kernels"
        )
    machine = made.stdout.partition("-")[0]
    return machine if machine in PLATFORMS["3.0"] else platform.machine()


def _description(config: RigConfig, row: np.void, version: str, token: str) -> str:
    """Return the content of an FMU's modelDescription.xml: its variables, their start values and its capabilities.

    `row` is the first part of the rig's snapshot (`SETUP`), which names the channels. `version` is the FMI version
    (`2.0` or `3.0`), and `token` identifies the FMU.
    """
    names = [name.decode() for name in row["name"][: row["channels"]]]
    kind = config.drive.kind
    sine = [
        (1, "frequency", "input", "discrete", "Frequency of the drive [Hz]", config.drive.frequency_hz),
        (2, "current", "input", "discrete", f"Amplitude of the {kind} drive, peak [SI]", 0.0),
    ]
    held = "during" if _drive(config) == "zero_order" else "at the end of"
    sample = [(2, "current", "input", "continuous", f"Sample of the {kind} drive {held} the step [SI]", 0.0)]
    step_s = 0.01 if _drive(config) == "sine" else 1.0 / config.drive.stream_rate_hz
    about_gap = "Total gap between sphere and walls; a new value puts the sphere back to its start [m]"
    inputs = [
        *(sine if _drive(config) == "sine" else sample),
        (3, "gap", "parameter", "tunable", about_gap, config.barriers.gap_m),
    ]
    outputs = [
        *(
            (MOTION + i, NAMES.get(name, name), f"{ABOUT[name]} [{unit}]")
            for i, (name, unit) in enumerate(UNITS.items())
        ),
        (IMPACTS, "impacts", "Number of contacts of the sphere with the walls that have ended"),
        *(
            (READINGS + i, f"reading_{name}", f"Newest reading of the channel {name} [SI]")
            for i, name in enumerate(names)
        ),
    ]
    variables = [_variable(version, *one) for one in inputs]
    for reference, name, about in outputs:
        variability = "discrete" if reference == IMPACTS else "continuous"
        variables.append(_variable(version, reference, name, "output", variability, about))
    if version == "3.0":
        variables.insert(0, _variable(version, 0, "time", "independent", "continuous", "Time of the scan clock [s]"))
        structure = "".join(
            f'<{element} valueReference="{one[0]}"/>' for element in ("Output", "InitialUnknown") for one in outputs
        )
        head = f'fmiVersion="3.0" instantiationToken="{token}"'
        state = "FMUState"
    else:
        unknowns = "".join(f'<Unknown index="{len(inputs) + 1 + i}"/>' for i in range(len(outputs)))
        structure = f"<Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns>"
        head = f'fmiVersion="2.0" guid="{token}" numberOfEventIndicators="0"'
        state = "FMUstate"
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription modelName="{MODEL}" version="{__version__}" generationTool="impact-rig" {head}>
<CoSimulation modelIdentifier="{MODEL}" canHandleVariableCommunicationStepSize="true"
 canGetAndSet{state}="true" canSerialize{state}="true"/>
<DefaultExperiment startTime="0" stopTime="10" stepSize="{step_s!r}"/>
<ModelVariables>
{chr(10).join(variables)}
</ModelVariables>
<ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>
"""


def _variable(
    version: str, reference: int, name: str, causality: str, variability: str, about: str, start: float | None = None
) -> str:
    head = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
    head += f' description="{html.escape(about)}"'
    value = "" if start is None else f' start="{start!r}"'
    return (
        f"<Float64 {head}{value}/>" if version == "3.0" else f"<ScalarVariable {head}><Real{value}/></ScalarVariable>"
    )
