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
"""The package finds its own files wherever it is installed."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from kits.shared import release

from impact_rig.client import isolated_domain
from impact_rig.errors import ImpactRigError
from impact_rig.kernels.build import OUTPUT, this_machine
from impact_rig.system.files import config_dir, share_dir
from tools.release import differences, page, unpack

ROOT = Path(__file__).parents[1]


def test_the_package_finds_its_configurations():
    assert (config_dir() / "nominal.yaml").is_file()
    assert (share_dir() / "launch" / "rig.launch.py").is_file()


@pytest.mark.parametrize(
    ("package", "share"),
    [
        ("checkout/impact_rig", "checkout"),
        ("venv/lib/python3.12/site-packages/impact_rig", "venv/share/impact_rig"),
        ("ws/install/impact_rig/lib/python3.12/site-packages/impact_rig", "ws/install/impact_rig/share/impact_rig"),
        ("opt/ros/jazzy/lib/python3.12/site-packages/impact_rig", "opt/ros/jazzy/share/impact_rig"),
    ],
)
def test_files_are_found_in_every_layout(tmp_path, package, share):
    (tmp_path / package).mkdir(parents=True)
    with pytest.raises(ImpactRigError, match=r"neither next to .* nor in share/impact_rig of a directory above it"):
        share_dir(tmp_path / package)
    (tmp_path / share / "config").mkdir(parents=True)
    (tmp_path / share / "package.xml").touch()
    assert share_dir(tmp_path / package) == tmp_path / share


CAN_BUILD = any(importlib.util.find_spec(name) for name in ("setuptools.command.bdist_wheel", "wheel"))
RELEASED = pytest.mark.skipif(
    not CAN_BUILD or not (ROOT / ".git").exists(),
    reason="setuptools before 70.1 builds wheels with the package wheel only; and git says what belongs to a release",
)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Source distribution, and the wheel made from it, with the library that the tests run on."""
    return release(tmp_path_factory)


@RELEASED
def test_a_release_contains_exactly_the_files_of_the_repository(built, tmp_path):
    sdist, wheel = built
    assert differences(sdist, wheel) == []
    other = tmp_path / wheel.name
    with zipfile.ZipFile(wheel) as source, zipfile.ZipFile(other, "w") as copy:
        for name in source.namelist():
            if not name.endswith("impact_rig/config/nominal.yaml"):
                copy.writestr(name, source.read(name))
        copy.writestr("impact_rig/removed_last_week.py", "")
    lacks, holds = differences(sdist, other)
    assert lacks.endswith("impact_rig/config/nominal.yaml")
    assert lacks.startswith(f"{wheel.name} lacks ")
    assert holds == f"{wheel.name} holds impact_rig/removed_last_week.py"


@RELEASED
@pytest.mark.ros
def test_an_installed_wheel_works_without_a_checkout(built, tmp_path):
    """In an empty directory, the wheel finds its files, serves the lab's page and is pytest's plugin.

    `python -m tools.release --try` does the same with all requirements of the wheel in an empty environment. Here, the
    wheel is put before the checkout on the path.
    """
    pytest.importorskip("aiohttp", reason="the extra [lab] is not installed")
    _, wheel = built
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"]
    elsewhere = ["--prefix", str(tmp_path / "prefix"), "--no-compile"]
    elsewhere += ["--ignore-installed"]  # else pip removes what these tests run
    subprocess.run([*pip, *elsewhere, str(wheel)], check=True, cwd=tmp_path)
    (package,) = (tmp_path / "prefix").glob("lib/python3*/site-packages/impact_rig")
    assert (package / "py.typed").is_file()
    assert share_dir(package) == tmp_path / "prefix" / "share" / "impact_rig"

    empty = tmp_path / "empty"
    empty.mkdir()
    assert (package / "kernels" / OUTPUT).is_file(), "who installs a wheel compiles nothing"
    environment = {**os.environ, "PYTHONPATH": str(package.parent), "IMPACT_RIG_KERNELS": "library"}
    program = tmp_path / "prefix" / "bin" / "impact-rig"
    with isolated_domain() as domain_id:
        environment["ROS_DOMAIN_ID"] = str(domain_id)
        with page([sys.executable, program], empty, environment) as served:
            assert b"impact_rig" in served
    (empty / "test_it.py").write_text(
        "import impact_rig\n\n"
        "def test_the_rig_of_the_wheel(virtual_rig):\n"
        f"    assert impact_rig.__file__.startswith({str(package)!r})\n"
        "    rig = virtual_rig()\n"
        "    rig.step(10)\n"
        "    assert sum(len(table.rows) for table in rig.tables()) == 1000\n"
    )
    tried = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_it.py"]
    done = subprocess.run(tried, cwd=empty, env=environment, capture_output=True, text=True, check=False)
    assert "1 passed" in done.stdout, done.stdout + done.stderr


@RELEASED
@pytest.mark.parametrize("kernels", ["jit", None])
def test_a_wheel_lacks_the_library_only_on_request(kernels, built, tmp_path):
    """If the library cannot be built, there is no wheel: Numba at run time must not be an accident."""
    source = unpack(built[0], tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(source / "requirements"), "CC": str(tmp_path / "no_compiler")}
    environment |= {"IMPACT_RIG_KERNELS": kernels} if kernels else {}
    command = [sys.executable, "-c", f"import build_backend; build_backend.build_wheel({str(tmp_path)!r})"]
    done = subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True, check=False)
    wheels = list(tmp_path.glob("*.whl"))
    if kernels is None:
        assert done.returncode
        assert wheels == []
        assert "IMPACT_RIG_KERNELS=jit" in done.stderr.splitlines()[-2]
    else:
        (wheel,) = wheels
        assert wheel.name.endswith("-py3-none-any.whl")
        assert not any(name.endswith((".so", ".o")) for name in zipfile.ZipFile(wheel).namelist())


def test_pip_installs_numba_only_where_a_release_has_no_assembly(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "requirements"))
    import build_backend

    assert any(one.startswith("numba==") for one in build_backend.get_requires_for_build_wheel())
    (tmp_path / f"{this_machine()}-mechanics.s").touch()
    monkeypatch.setattr(build_backend, "ASSEMBLY", tmp_path)
    assert build_backend.get_requires_for_build_wheel() == []
