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
