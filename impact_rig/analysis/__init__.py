# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Analysis: arrays in, values out; knows only scans, `daq/info`, `shaker/applied` and the operator's labels.

Nothing here imports ROS, the physics or the instruments, so live, replayed and real data take one path. One topic per
module: `sine` (IEEE 1057 fits), `transmissibility`, `tracker` (the same, streaming), `impacts`, `frf`, `decay`,
`settling`, `reduction`. Import the module you need: this package imports none of them by itself.
"""
