# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Analyses of one block of scans at a time, one file each; docs/extending.md shows how to add one.

Every module of this folder that defines one is found; the analysis node feeds it and publishes what it returns.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import ClassVar

from impact_rig.blocks import Table
from impact_rig.topics import Topic


class Blockwise:
    """An analysis with a topic of its own.

    Attributes:
        topic: its row of the topic table; its publisher is `analysis`, and it carries tables.
        needs: the channels without which it has nothing to say.
    """

    topic: ClassVar[Topic]
    needs: ClassVar[tuple[str, ...]]

    def feed(self, scan: Table) -> Table | None:
        """Return what there is to say of a block of `daq/scan`; blocks come in the order of their stamps."""
        raise NotImplementedError


def _found() -> tuple[type[Blockwise], ...]:
    found: list[type[Blockwise]] = []
    for place in sorted(pkgutil.iter_modules(__path__), key=lambda place: place.name):
        module = importlib.import_module(f"{__name__}.{place.name}")
        own = [kind for kind in vars(module).values() if getattr(kind, "__module__", None) == module.__name__]
        found += [kind for kind in own if isinstance(kind, type) and issubclass(kind, Blockwise)]
    return tuple(found)


ANALYSES = _found()
"""Every such analysis, in alphabetical order of modules."""
