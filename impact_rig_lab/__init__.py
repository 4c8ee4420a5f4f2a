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
"""Live laboratory: a web page that shows motion and measurements of a live or recorded rig, and controls a live rig.

    browser ◄─ WebSocket ─► server, sessions ─► source: live (gateway, subscriptions) or playback (run players)

A source fills ring buffers of scans and of true motion, and keeps a snapshot of the state of the rig. The server has a
session for each open page. The session sends the browser what the page requests, but never faster than the browser can
draw. No source waits for a browser.
"""
