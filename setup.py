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
"""Build with colcon (`ament_python`) or pip; package.xml has name, version, licence, addresses and description."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

HERE = Path(__file__).parent
PACKAGE = ET.parse(HERE / "package.xml").getroot()  # noqa: S314  # our own file
NAME = PACKAGE.findtext("name")
MAINTAINER = PACKAGE.find("maintainer")
URL = PACKAGE.findtext("url[@type='repository']")
EXAMPLES = [
    "examples",
    "examples/adapters",
    "examples/c",
    "examples/golden/test_regression/test_the_analysis_reproduces_the_stored_results",
    "examples/golden/test_regression/test_the_rig_reproduces_the_stored_readings",
]
ROS_WHEELS = ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"]


def files(pattern: str) -> list[str]:
    """Return the files that match, relative to this one as setuptools wants them."""
    return sorted(str(path.relative_to(HERE)) for path in HERE.glob(pattern))


VARIABLE = "IMPACT_RIG_KERNELS"
KERNELS = [Extension(f"{NAME}.kernels._library", [], py_limited_api=True)]


class BuildKernels(build_ext):
    """Build step for the library of compiled kernels, which the variable alone leaves out."""

    def build_extension(self, ext: Extension) -> None:
        folder = Path(self.get_ext_fullpath(ext.name)).absolute().parent
        command = [sys.executable, "-m", "impact_rig.kernels.build", str(folder)]
        try:
            subprocess.run(command, cwd=HERE, env={**os.environ, VARIABLE: "plain"}, check=True)  # noqa: S603  # ourselves
        except subprocess.CalledProcessError as error:
            raise CompileError(str(error)) from None


setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    license=PACKAGE.findtext("license"),
    description=" ".join(PACKAGE.findtext("description").split()),
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get("email"),
    url=URL,
    keywords=["impact damper", "vibration", "virtual test rig", "transmissibility", "measurement uncertainty", "ROS 2"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Framework :: Pytest",
        "Intended Audience :: Developers",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Topic :: Scientific/Engineering :: Physics",
        "Topic :: Software Development :: Testing",
        "Typing :: Typed",
    ],
    packages=find_packages(include=[f"{NAME}*"]),
    package_data={
        NAME: ["py.typed", "interface.json", "embedded/*.[ch]", "kernels/*.c", "recording/definitions.json"],
        f"{NAME}_studies": ["py.typed", "report/parts.html", "report/style.css"],
        f"{NAME}_lab": ["py.typed", "site/*", "static/*", "words.json"],
    },
    ext_modules=[] if os.environ.get(VARIABLE) in ("jit", "plain") else KERNELS,
    cmdclass={"build_ext": BuildKernels},
    options={"bdist_wheel": {"py_limited_api": "cp311"}},  # one file for every Python
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", files("config/*.yaml")),
        (f"share/{NAME}/config/campaigns", files("config/campaigns/*.yaml")),
        (f"share/{NAME}/config/maps", files("config/maps/*.yaml")),
        (f"share/{NAME}/config/dynamics", files("config/dynamics/*.yaml")),
        (f"share/{NAME}/config/excitation", files("config/excitation/*.yaml")),
        (f"share/{NAME}/config/foxglove", files("config/foxglove/*.json")),
        (f"share/{NAME}/config/sros2", files("config/sros2/*.xml")),
        (f"share/{NAME}/config/plotjuggler", files("config/plotjuggler/*.xml")),
        (f"share/{NAME}/launch", files("launch/*.launch.py")),
        (f"share/{NAME}/rviz", files("rviz/*.rviz")),
        (f"share/{NAME}/urdf", files("urdf/*.urdf")),
        *((f"share/{NAME}/{folder}", files(f"{folder}/*.*")) for folder in EXAMPLES),
    ],
    python_requires=">=3.11",
    # the lowest versions are those of Ubuntu 24.04
    install_requires=[
        "attrs>=23.2",
        "Jinja2>=3.1",
        "matplotlib>=3.6",
        "mcap>=1.5",  # the first whose writer can close a chunk on request; brings lz4 and zstandard
        "numpy>=1.26",
        "PyYAML>=6.0",
        "rich>=13.7",
        "scipy>=1.11",
    ],
    extras_require={
        # for machines without an apt-installed ROS 2 only: never mix the two, so these are never a requirement
        "wheels": [*ROS_WHEELS, "pytest"],  # pytest: see docs/how-to/testing.md
        "jit": ["numba>=0.59"],  # contact laws of one's own, compiled; and kernels where no library was built
        "lab": ["aiohttp>=3.9", "uplot-python>=1.1"],  # `impact-rig lab`; 3.9 is that of Ubuntu 24.04
        "completion": ["argcomplete>=3.1"],  # `register-python-argcomplete`; 3.1 is that of Ubuntu 24.04
        "cluster": ["distributed>=2024.1"],  # `impact-rig campaign --through dask`
        "exchange": ["pyarrow>=14", "pyuff>=2.4"],  # `impact-rig export` to Parquet and universal files
        # `impact-rig import`
        "import": ["h5py>=3.10", "npTDMS>=1.7", "pint>=0.23", "pyarrow>=14", "pyuff>=2.4", "rosbags>=0.10"],
        "nidaqmx": ["nidaqmx[grpc]>=1.0"],  # `impact-rig daqmx`, and the scripts that it serves
        "tables": ["pandas>=2.1", "xarray>=2024.1"],  # `to_dataframe()` and `to_xarray()`; 2.1 is that of Ubuntu 24.04
        "strategies": ["hypothesis>=6.98"],  # `impact_rig.testing.strategies`; 6.98 is that of Ubuntu 24.04
        "test": ["hypothesis", "pytest", "pytest-timeout"],  # also how `colcon test` knows to run pytest
    },
    zip_safe=False,
    entry_points={
        # named like the module, so that a pytest that loads it by name as well does not load it twice
        "pytest11": ["impact_rig.testing.plugin = impact_rig.testing.plugin"],
        "impact_rig.commands": [
            "analyze = impact_rig.cli.parsers:add_analyze",
            "check = impact_rig.cli.parsers:add_check",
            "daqmx = impact_rig.cli.parsers:add_daqmx",
            "export = impact_rig.cli.parsers:add_export",
            "fmu = impact_rig.cli.parsers:add_fmu",
            "info = impact_rig.cli.parsers:add_info",
            "interface = impact_rig.cli.parsers:add_interface",
            "record = impact_rig.cli.parsers:add_record",
            "recover = impact_rig.cli.parsers:add_recover",
            "replay = impact_rig.cli.parsers:add_replay",
            "verify = impact_rig.cli.parsers:add_verify",
            "lab = impact_rig_lab.cli:add_command",
            "campaign = impact_rig_studies.cli.parsers:add_campaign",
            "compare = impact_rig_studies.cli.parsers:add_compare",
            "demo = impact_rig_studies.cli.parsers:add_demo",
            "drive = impact_rig_studies.cli.parsers:add_drive",
            "dynamics = impact_rig_studies.cli.parsers:add_dynamics",
            "identify = impact_rig_studies.cli.parsers:add_identify",
            "import = impact_rig_studies.cli.parsers:add_import",
            "map = impact_rig_studies.cli.parsers:add_map",
            "report = impact_rig_studies.cli.parsers:add_report",
        ],
        "impact_rig.analyses": [
            "frf = impact_rig.cli.parsers:FRF",
            "sine = impact_rig.cli.parsers:SINE",
            "drop = impact_rig_studies.cli.parsers:DROP",
        ],
        "impact_rig.exporters": [
            "map = impact_rig_studies.exporters:map_points",
            "campaign = impact_rig_studies.exporters:campaign_points",
            "dynamics = impact_rig_studies.exporters:study_rows",
        ],
        "console_scripts": [
            "impact-rig = impact_rig.cli:main",
            "rig_node = impact_rig.nodes.__main__:rig",
            "analysis_node = impact_rig.nodes.__main__:analysis",
            "recorder_node = impact_rig.nodes.__main__:recorder",
            "plot_node = impact_rig.nodes.__main__:plot",
            "lab_node = impact_rig_lab.node:main",
            "stepped_sine_node = impact_rig_studies.__main__:stepped_sine",
        ],
    },
)
