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
"""Worker processes whose results are no longer needed before they are done."""

from __future__ import annotations

import os
import subprocess
import sys

ABANDONED = """
import concurrent.futures.process as process, time
from impact_rig_studies.campaign.pool import in_parallel

def late(wakeup):
    if not wakeup._closed:
        time.sleep(0.3)
        wakeup._writer.send_bytes(b"")

if __name__ == "__main__":
    jobs = in_parallel(time.sleep, [0.0, 30.0, 30.0, 30.0], 2)
    next(jobs)
    jobs.close()
    process._ThreadWakeup.wakeup = late  # what the interpreter's end does, just when the pool's own thread ends
"""


def test_an_abandoned_pool_ends_before_the_interpreter(tmp_path):
    program = tmp_path / "abandoned.py"
    program.write_text(ABANDONED)
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=60, check=True)
    assert (done.stdout, done.stderr) == ("", "")


THREADS = """
import os
from impact_rig_studies.campaign.pool import in_parallel

if __name__ == "__main__":
    found = dict(in_parallel(os.getenv, ["OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"], 2))
    print(*(found[name] for name in sorted(found)), os.environ.get("OPENBLAS_NUM_THREADS"))
"""


def test_workers_use_one_thread_for_linear_algebra_unless_the_user_chose_otherwise(tmp_path):
    program = tmp_path / "threads.py"
    program.write_text(THREADS)
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment["OMP_NUM_THREADS"] = "3"
    done = subprocess.run(
        [sys.executable, program], env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == ["1", "3", "1", "None"]
