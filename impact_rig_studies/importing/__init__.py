# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Import of measurements of other rigs: files of other programs become runs.

`readers` turn a file into `signals`; `mapping` and `assignment` say which signal is which channel; `uniform` finds the
rate; `conversion` makes scans of them and `store` writes these as a run.
"""
