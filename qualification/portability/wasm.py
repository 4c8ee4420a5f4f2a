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
"""Recording of runs whose kernels are WebAssembly, in wasmtime.

    python -m qualification.portability.wasm MODULE STAMPS OUTPUT RUN...

Only the kernels run there. They replace the shared library with the same calls; arrays are copied in and out.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.machinery
import struct
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import wasmtime
from numpy.typing import NDArray

LIBRARY = "impact_rig.kernels._library"
MOST_SLOTS, MOST_RESULTS = 320, 4  # as in library.c
WORD = 2**64 - 1


class Library(types.ModuleType):
    """The shared library's interface for Python, on WebAssembly.

    Args:
        module: the WebAssembly module.
        stamps: file with the digests of its sources.
    """

    def __init__(self, module: Path, stamps: Path) -> None:
        super().__init__(LIBRARY)
        self.__spec__ = importlib.machinery.ModuleSpec(LIBRARY, None)
        engine = wasmtime.Engine()
        self._store = wasmtime.Store(engine)
        linker = wasmtime.Linker(engine)
        two_words = wasmtime.FuncType([wasmtime.ValType.i32()] * 2, [wasmtime.ValType.i32()])
        linker.define_func("wasi_snapshot_preview1", "random_get", two_words, lambda *_: 0)  # for libc's stack guard
        instance = linker.instantiate(self._store, wasmtime.Module.from_file(engine, str(module)))
        self._exports = instance.exports(self._store)
        self._stamps = stamps.read_text(encoding="utf-8")
        self._room: dict[int, tuple[int, int]] = {}  # address and size of the memory allocated for an array of a call
        self._in, self._out = self._allocate(8 * MOST_SLOTS), self._allocate(8 * MOST_RESULTS)

    def sources(self) -> str:
        """Return the digests of the sources."""
        return self._stamps

    def address(self, name: str) -> int:
        """Return the index of a function in the table, 0 if there is no such function."""
        text = name.encode() + b"\0"
        at = self._place(-1, len(text))
        self._memory()[at : at + len(text)] = np.frombuffer(text, np.uint8)
        return int(self._call("impact_rig_address", at))

    def entry(self, name: str, plan: str, dtypes: tuple[Any, ...], results: str) -> Callable[..., Any]:
        """Return a kernel that Python can call."""
        symbol = f"ir_{name.replace('.', '_')}_slots"

        def call(*arguments: Any) -> Any:
            arrays: list[tuple[NDArray[Any], int]] = []
            words: list[int] = []
            letters = iter(plan)
            for value in arguments:
                words += self._piece(letters, value, arrays)
            memory = self._memory()  # after all allocations: memory that grows moves
            for value, at in arrays:
                memory[at : at + value.nbytes] = np.frombuffer(value, np.uint8) if value.nbytes else 0
            memory[self._in : self._in + 8 * len(words)] = np.array(words, np.uint64).view(np.uint8)
            status = self._call(symbol, self._in, self._out)
            memory = self._memory()
            for value, at in arrays:
                if value.nbytes and value.flags.writeable:
                    np.frombuffer(value, np.uint8)[:] = memory[at : at + value.nbytes]
            if status:
                raise RuntimeError(f"{name} failed with status {status}")
            found = memory[self._out : self._out + 8 * MOST_RESULTS].view(np.int64).tolist()
            given = [bool(one) if kind == "b" else one for kind, one in zip(results, found, strict=False)]
            return None if not results else given[0] if len(given) == 1 else tuple(given)

        return call

    def _piece(self, letters: Iterator[str], value: Any, arrays: list[tuple[NDArray[Any], int]]) -> list[int]:
        """Return the slots of one piece of the arguments, see library.c."""
        letter = next(letters)
        if letter == "f":
            return list(struct.unpack("<Q", struct.pack("<d", value)))
        if letter in "ib":
            return [int(value) & WORD]
        if letter == "p":
            return [value.address, 0, 0]
        if letter == "(":
            count = ord(next(letters))
            if len(value) != count:
                raise TypeError(f"expected a tuple of {count}, got {len(value)}")
            return [word for one in value for word in self._piece(letters, one, arrays)]
        where = value.ctypes.data, value.nbytes
        same = [at for one, at in arrays if (one.ctypes.data, one.nbytes) == where]
        arrays.append((value, same[0] if same else self._place(len(arrays), value.nbytes)))
        return [0, 0, value.size, value.itemsize, arrays[-1][1], *value.shape, *value.strides]

    def _place(self, index: int, size: int) -> int:
        at, room = self._room.get(index, (0, -1))
        if room < size:
            room = max(64, 2 * size)
            at = self._allocate(room)
            self._room[index] = at, room
        return at

    def _allocate(self, size: int) -> int:
        at = int(self._call("malloc", size))
        if not at:
            raise MemoryError(f"{size} bytes")
        return at

    def _call(self, name: str, *arguments: int) -> Any:
        return self._exports[name](self._store, *arguments)

    def _memory(self) -> NDArray[np.uint8]:
        memory = self._exports["memory"]
        data = memory.data_ptr(self._store)
        kind = ctypes.c_uint8 * memory.data_len(self._store)
        return np.ctypeslib.as_array(kind.from_address(ctypes.addressof(data.contents)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("module", type=Path, help="kernels as WebAssembly")
    parser.add_argument("stamps", type=Path, help="list of their sources; then as of qualification.portability.child")
    given, sys.argv[1:] = parser.parse_known_args()
    sys.modules[LIBRARY] = Library(given.module, given.stamps)
    from impact_rig import kernels
    from qualification.portability.child import main

    assert kernels._LIBRARY is sys.modules[LIBRARY]
    sys.exit(main())
