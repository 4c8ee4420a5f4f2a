# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The report of a campaign: one HTML page that needs nothing else, and its figures beside it."""

from impact_rig_studies.report.build import build_report

__all__ = ["build_report"]
