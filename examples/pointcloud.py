# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`sensor_msgs/PointCloud2` as numpy, without a loop and without impact_rig."""

import numpy as np

FORMATS = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}


def columns(message):
    """Return the rows of a table as a structured array; a field with a count above 1 is text."""
    names = [field.name for field in message.fields]
    formats = [FORMATS[field.datatype] if field.count == 1 else f"S{field.count}" for field in message.fields]
    offsets = [field.offset for field in message.fields]
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": message.point_step}
    return np.frombuffer(message.data, np.dtype(layout))


def stamp_ns(message):
    """Return the stamp of a message with a header."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
