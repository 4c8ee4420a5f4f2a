# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The live laboratory: one page in the browser that shows what a rig does, or did, and turns its knobs.

    browser ◄─ WebSocket ─► server ─► session ─► source: live (a client of the graph) or playback (a recorded run)

A source fills rings of scans and of true motion and keeps a snapshot in plain words; a session draws from them what
its browser asked for, never faster than that browser draws it. Nobody waits for a browser.
"""
