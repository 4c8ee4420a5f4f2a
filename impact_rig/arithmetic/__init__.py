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
"""Arithmetic with the same results on every machine: elementary functions, precise constants, random numbers.

IEEE 754 fixes +, −, ×, ÷, sqrt, comparison and rounding to the last bit. It does not fix sine or exponential, and a
matrix routine may add in any order. Everything that determines a sample or an impact is therefore computed with this
package and with those operations in a written order, without libm, BLAS or LAPACK.
"""

ARITHMETIC = 6
"""Version of the arithmetic: it rises when the same seed and commands give other bits than with the version below.

A recording contains it. A recording of another version can be replayed and analysed, but not re-simulated bit for bit.
Version 1 was never recorded: it used the libraries of the machine.
"""

__all__ = ["ARITHMETIC"]
