# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""Which code a result was measured with: results of other code are shown, but never mixed with new ones."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

import impact_rig

DECIDING = ("arithmetic", "physics", "instruments", "rig", "analysis", "operate", "config", "blocks.py", "simtime.py")
"""What decides a measured number; the rest of the package commands, stores and shows."""


@functools.cache
def fingerprint(deciding: tuple[str, ...] = DECIDING) -> str:
    """Return the package's version and 12 hexadecimal digits of the sources in these rooms."""
    root = Path(impact_rig.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root)
        if name.parts[0] in deciding:
            digest.update(f"{name.as_posix()}\0".encode())
            digest.update(path.read_bytes())
    return f"{impact_rig.__version__}-{digest.hexdigest()[:12]}"
