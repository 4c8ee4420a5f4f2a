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
"""Studies of the model's nonlinear dynamics, defined by a YAML file with a section for each kind in `KINDS`.

The studies compute Poincaré sections, bifurcation diagrams, basins of attraction, periodic orbits with their energy per
cycle, branches of orbits, and Lyapunov exponents. The results are those of the mechanics alone, with exactly located
impacts and without sensors or noise.
"""

KINDS = ("section", "bifurcation", "basin", "orbit", "continue", "exponent")
"""Kinds of studies: the word after `impact-rig dynamics`, which is also the key of its section in the YAML file."""
