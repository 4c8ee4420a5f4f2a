# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The exceptions of impact_rig: one type per kind of mistake; messages say what was wrong and what would be right."""


class ImpactRigError(Exception):
    """Base class: catch this to catch every error this package raises on purpose."""


class ConfigError(ImpactRigError, ValueError):
    """A configuration value, key or file is wrong; the message names key, value, range and file."""


class CommandError(ImpactRigError, ValueError):
    """A command was refused; the shaker keeps its last good state."""


class CodecError(ImpactRigError, ValueError):
    """Bytes are not the message they claim to be."""


class RecordingError(ImpactRigError, OSError):
    """A run cannot be written or read; what was already on disk is untouched."""


class GoneError(ImpactRigError, RuntimeError):
    """A process that one works with has ended by itself: it says nothing about what was asked of it."""


class SimulationError(ImpactRigError, RuntimeError):
    """The simulation cannot go on (a fault of the model or its tolerances, never of a user's command)."""
