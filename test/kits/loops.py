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
"""Event loop for one piece of work, in a separate thread, so that no loop is left for other tests."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def run(work: Coroutine[Any, Any, T]) -> T:
    """Return the result of a coroutine."""
    found: list[T] = []
    errors: list[BaseException] = []

    def do() -> None:
        try:
            with asyncio.Runner() as runner:
                try:
                    found.append(runner.run(work))
                finally:
                    # one that still has something to send to a peer that reads no more would outlive the loop
                    for transport in list(runner.get_loop()._transports.values()):  # type: ignore[attr-defined]
                        transport.abort()
        except BaseException as error:  # handed on below
            errors.append(error)

    thread = threading.Thread(target=do)
    thread.start()
    thread.join()
    if errors:
        raise errors[0]
    return found[0]
