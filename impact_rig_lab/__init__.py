# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The live laboratory: one page in the browser that shows what a rig does, or did, and turns its knobs.

    browser ◄─ WebSocket ─► server, sessions ─► source: live (gateway, subscriptions) or playback (run players)

A source fills rings of scans and of true motion and keeps a snapshot of the state as data; a session draws from them
what its browser asked for, never faster than that browser draws it. Nobody waits for a browser.
"""
