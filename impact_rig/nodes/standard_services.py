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
"""Services of the package `simulation_interfaces`, each offered if the installed package defines it.

They offer pause, step and reset of the rig in the terms of that package. The rig has the state `STOPPED` if it is
inactive. It is also `STOPPED` if these services have paused and reset it, until it advances. Rig time never goes back,
not even at a reset.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any  # messages of a package that may be absent

from impact_rig import __version__
from impact_rig.errors import CommandError, ConfigError, describe
from impact_rig.graph import SIMULATION_PACKAGE, SIMULATION_SERVICES
from impact_rig.nodes.managed import Done, LateService
from impact_rig.nodes.session import Session
from impact_rig.rig import Rig

FEATURES = {
    "GetSimulationState": ("SIMULATION_STATE_GETTING",),
    "SetSimulationState": ("SIMULATION_STATE_SETTING", "SIMULATION_STATE_PAUSE"),
    "StepSimulation": ("STEP_SIMULATION_SINGLE", "STEP_SIMULATION_MULTIPLE"),
    "ResetSimulation": ("SIMULATION_RESET", "SIMULATION_RESET_STATE"),
}
"""Names of the features of `SimulatorFeatures` that a service provides, by service type."""
NOTE = f"impact_rig {__version__}; a step is step.blocks blocks; a reset starts again at scan 0 with continuing stamps"
Tell = Callable[[int, str], None]  # answers with a result code and an error message


class StandardServices:
    """Standard simulation services (`simulation_interfaces`) of a rig; no service is offered without that package."""

    def __init__(self, session: Session) -> None:
        self._session, self._node = session, session.node
        self._stopped: tuple[Rig, int] | None = None  # the stopped rig, and its next block at that time
        try:
            self._messages = importlib.import_module(f"{SIMULATION_PACKAGE}.msg")
            services = importlib.import_module(f"{SIMULATION_PACKAGE}.srv")
        except ImportError:
            return
        self._offered = [kind for kind in SIMULATION_SERVICES if hasattr(services, kind)]
        for kind in self._offered:
            service_type, name = getattr(services, kind), SIMULATION_SERVICES[kind]
            LateService(self._node, service_type, name, self._guarded(service_type, name.removeprefix("~/")))

    def _guarded(self, service_type: Any, name: str) -> Callable[[Any, int, Callable[[Any], None]], None]:
        """Return a request handler for the service `name` that always answers, with an error if an exception occurs."""
        handle = getattr(self, f"_{name}")
        codes = self._messages.Result

        def serve(request: Any, sent_ns: int, send: Callable[[Any], None]) -> None:
            response = service_type.Response()

            def tell(code: int, text: str = "") -> None:
                if code not in {codes.RESULT_OK, getattr(response, "ALREADY_IN_TARGET_STATE", codes.RESULT_OK)}:
                    self._node.refuse(name, text)
                if hasattr(response, "result"):
                    response.result = codes(result=code, error_message=text)
                send(response)

            try:
                if not name.startswith("get_"):
                    self._session.refuse_backlog(sent_ns)
                handle(request, response, tell)
            except (CommandError, ConfigError) as error:
                tell(codes.RESULT_OPERATION_FAILED, str(error))
            except Exception as error:  # no exception caused by a request may end the process
                self._node.report_failure(name, describe(error))
                tell(codes.RESULT_OPERATION_FAILED, describe(error))

        return serve

    def _done(self, tell: Tell, failed: int) -> Done:
        """Return a function of (success, message) that answers with RESULT_OK, or with `failed` and the message."""
        return lambda success, message: tell(*((self._messages.Result.RESULT_OK, "") if success else (failed, message)))

    def _state(self) -> int:
        states, rig = self._messages.SimulationState, self._session.rig
        if self._node.quitting or self._node.state == "finalized":
            return int(states.STATE_QUITTING)
        if rig is None or (self._session.paused and self._stopped == (rig, rig.next_block_ns)):
            return int(states.STATE_STOPPED)
        stands = self._session.paused or self._session.is_lockstep
        return int(states.STATE_PAUSED if stands else states.STATE_PLAYING)

    def _get_simulator_features(self, _request: Any, response: Any, tell: Tell) -> None:
        features = self._messages.SimulatorFeatures
        names = [name for kind in self._offered for name in FEATURES.get(kind, ())]
        response.features = features(features=[getattr(features, name) for name in names], custom_info=NOTE)
        tell(self._messages.Result.RESULT_OK, "")

    def _get_simulation_state(self, _request: Any, response: Any, tell: Tell) -> None:
        response.state = self._messages.SimulationState(state=self._state())
        tell(self._messages.Result.RESULT_OK, "")

    def _set_simulation_state(self, request: Any, response: Any, tell: Tell) -> None:
        codes, states = self._messages.Result, self._messages.SimulationState
        wanted, present, rig = request.state.state, self._state(), self._session.rig
        if wanted == present:
            tell(response.ALREADY_IN_TARGET_STATE, "")
        elif wanted not in {states.STATE_STOPPED, states.STATE_PLAYING, states.STATE_PAUSED, states.STATE_QUITTING}:
            tell(
                codes.RESULT_FEATURE_UNSUPPORTED,
                f"unknown simulation state {wanted}: must be {states.STATE_STOPPED} (STOPPED), {states.STATE_PLAYING} "
                f"(PLAYING), {states.STATE_PAUSED} (PAUSED) or {states.STATE_QUITTING} (QUITTING)",
            )
        elif present == states.STATE_QUITTING:
            tell(response.INCORRECT_TRANSITION, "the state cannot change: the rig is quitting")
        elif wanted == states.STATE_QUITTING:
            self._node.quitting = True
            tell(codes.RESULT_OK, "")
        elif rig is None:
            tell(response.STATE_TRANSITION_ERROR, self._session.why_not())
        elif wanted == states.STATE_PLAYING and self._session.is_lockstep:
            tell(
                response.STATE_TRANSITION_ERROR,
                "time.mode is lockstep: the rig advances by steps only, so it cannot play",
            )
        elif wanted == states.STATE_PLAYING:
            self._session.resume(self._done(tell, response.STATE_TRANSITION_ERROR))
        elif wanted == states.STATE_PAUSED:
            self._stopped = None
            self._session.pause(self._done(tell, response.STATE_TRANSITION_ERROR))
        else:
            done = self._done(tell, response.STATE_TRANSITION_ERROR)
            self._session.pause(lambda success, message: self._stop(success, message, done))

    def _stop(self, success: bool, message: str, done: Done) -> None:
        """Reset the rig if its pause succeeded, so that it counts as stopped, and answer the request by `done`.

        The answer is an error if the pause failed or the rig rejects the reset. After a rejected reset, the rig stays
        paused.
        """
        try:
            if success:
                self._reset_rig(stop=True)
        except (CommandError, ConfigError) as error:
            success, message = False, str(error)
        done(success, message)

    def _reset_rig(self, stop: bool) -> None:
        rig = self._session.running()
        self._session.reset(rig)
        if stop:
            self._stopped = rig, rig.next_block_ns

    def _step_simulation(self, request: Any, _response: Any, tell: Tell) -> None:
        failed = self._messages.Result.RESULT_OPERATION_FAILED
        self._session.running()
        if self._state() != self._messages.SimulationState.STATE_PAUSED:
            tell(failed, "a step needs the simulation state PAUSED: set that state first")
        else:
            self._session.step(request.steps, self._done(tell, failed))

    def _reset_simulation(self, request: Any, _response: Any, tell: Tell) -> None:
        scopes, codes = type(request), self._messages.Result
        # a bit field, of which every bit must be supported; the default means all
        wanted = scopes.SCOPE_ALL if request.scope == scopes.SCOPE_DEFAULT else request.scope
        if wanted & ~scopes.SCOPE_STATE:
            reason = f"only SCOPE_STATE ({scopes.SCOPE_STATE}) can be reset, as time continues and nothing is spawned"
            tell(codes.RESULT_FEATURE_UNSUPPORTED, reason)
            return
        self._reset_rig(stop=self._state() == self._messages.SimulationState.STATE_STOPPED)
        tell(codes.RESULT_OK, "")
