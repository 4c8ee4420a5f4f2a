# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`python -m impact_rig.kernels`: see `build`."""

from impact_rig.kernels.build import main

main()
