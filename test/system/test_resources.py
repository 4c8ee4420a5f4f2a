# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The package finds its own files, wherever it was installed to."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from impact_rig.errors import ImpactRigError
from impact_rig.system.resources import config_dir, share_dir


def test_this_package_finds_its_configurations():
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
    with pytest.raises(ImpactRigError, match=r"neither beside .* nor in share/impact_rig above it"):
        share_dir(tmp_path / package)
    (tmp_path / share / "config").mkdir(parents=True)
    (tmp_path / share / "package.xml").touch()
    assert share_dir(tmp_path / package) == tmp_path / share


CAN_BUILD = any(importlib.util.find_spec(name) for name in ("setuptools.command.bdist_wheel", "wheel"))


@pytest.mark.skipif(not CAN_BUILD, reason="setuptools before 70.1 builds wheels with the package wheel only")
def test_an_installed_package_brings_its_files(tmp_path):
    """A wheel is built and installed from a copy, then asked from an empty directory for its configurations."""
    copy = tmp_path / "copy"
    listed = ["package.xml", "setup.py", "setup.cfg", "pyproject.toml", "config", "launch", "resource"]
    copy.mkdir()
    for name in listed:
        source = share_dir() / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / name)
    shutil.copytree(share_dir() / "impact_rig", copy / "impact_rig", ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    elsewhere = ["--prefix", str(tmp_path / "prefix"), "--ignore-installed"]  # else pip removes what these tests run
    subprocess.run([*pip, *elsewhere, str(copy)], check=True, cwd=tmp_path)
    (package,) = (tmp_path / "prefix").glob("lib/python3*/site-packages/impact_rig")
    assert (package / "py.typed").is_file()
    assert share_dir(package) == tmp_path / "prefix" / "share" / "impact_rig"
    for name in ("config/nominal.yaml", "launch/rig.launch.py"):
        assert (share_dir(package) / name).is_file()
    assert (tmp_path / "prefix/share/ament_index/resource_index/packages/impact_rig").is_file()
    scripts = {path.name for path in Path(tmp_path, "prefix", "bin").iterdir()}
    assert scripts >= {"impact-rig", "rig_node", "analysis_node", "recorder_node"}
