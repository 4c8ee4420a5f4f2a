# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The website: docs/ as pages, built by MkDocs with the theme Material, offline and strict."""
