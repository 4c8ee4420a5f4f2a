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
"""Arithmetic that every machine does alike: elementary functions, refined constants, random numbers.

IEEE 754 fixes +, −, ×, ÷, sqrt, comparison and rounding to the last bit; it fixes neither sine nor exponential, and a
matrix routine may add in any order it likes. Whatever decides a sample or an impact is therefore computed with what is
in here and with those operations in a written order, and with nothing of libm, BLAS or LAPACK.
"""

ARITHMETIC = 6
"""Version of the arithmetic: it rises when the same seed and commands give other bits than before.

A recording carries it; what another version recorded can be replayed and analysed, but not re-simulated bit for bit.
1 was never written down: it used the libraries of the machine.
"""

__all__ = ["ARITHMETIC"]
