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
"""A law for Rattlesnake's random vibration environment, which loads it from this file.

The law multiplies each line of the last drive by wanted / reached density. The first drive is that of a linear rig.
"""

import numpy as np


def control_law(specification, _warnings, _aborts, transfer_function, *rest):
    """Return the cross spectral densities of the drive, shape (lines, drives, drives)."""
    last_response, last_output = rest[-2:]
    if last_response is None or last_output is None:
        inverse = np.linalg.pinv(transfer_function)
        return inverse @ specification @ inverse.conj().transpose(0, 2, 1)
    reached, wanted = (np.einsum("ijj->i", one).real for one in (last_response, specification))
    step = np.divide(wanted, reached, out=np.ones_like(wanted), where=reached > 0.0)
    return last_output * np.clip(step, 0.25, 4.0)[:, None, None]
