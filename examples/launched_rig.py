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
"""Test a launched rig with `launch_pytest`: `pytest examples/launched_rig.py` where an apt-installed ROS is sourced.

Not among the examples that this package's tests run, as launch comes with an apt-installed ROS only.
"""

import launch_pytest
import pytest
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_pytest.actions import ReadyToTest

from impact_rig.client import Client
from impact_rig.system.files import share_dir


@launch_pytest.fixture
def description() -> LaunchDescription:
    """Return a launch description of one rig, which runs as fast as its analysis follows and is not recorded."""
    source = PythonLaunchDescriptionSource(str(share_dir() / "launch" / "rig.launch.py"))
    arguments = {"mode": "free_running", "peers": "analysis", "record": "false"}
    return LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments.items()), ReadyToTest()])


@pytest.mark.launch(fixture=description)
def test_a_launched_rig_measures_its_transmissibility() -> None:
    """A driven rig settles, and its transmissibility is published."""
    with Client(namespace="/rig") as client:
        client.wait_active("rig", "analysis")
        measured = client.collect("transmissibility/table")
        client.command(frequency_hz=9.1, current_a=0.1)
        settled = lambda: any(table.rows["settled"][0] == 1 for table in measured.tables())  # noqa: E731  # short
        client.wait_until(settled, "a measurement", 120.0)
