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
"""Amplitudes of the motion over complete cycles of the drive, in closed form from the stored states.

For each cycle the results are the complex amplitudes of both bases at the drive frequency (the fundamentals), and the
position and velocity of the sphere at the start of the cycle.

For a segment of the drive that is one cycle, T = 2π/ω, let Y be the integral of the structural state y(t) exp(−jωt),
and D that of the drive. The structure is linear, y' = M y + b_0 u + b_1 u', and the only effect of the sphere on it, at
the walls or by friction, is the force N = −m x_2''. So

    (jω − M) Y = −[y] + b_0 D + b_1 ([u] + jω D) + N's integral / m_1,   [y] = y(T) − y(0)

    D = e^{jφ} (A T + B T² / 2) / 2j − e^{−jφ} B T / 4ω,   [u] = B T sin φ

The complex amplitude of x, for x = Im(X exp(jωt)), is 2j/T times its integral. That of x_2'' is

    in flight       that of the guide's friction, which is constant
    in a contact    that of a straight line with the changes of velocity and position of each step: it leaves out the
                    curvature of the force, (ω τ)² / 24 with τ the length of the step
    ATTACHED        that of x_1'' in closed form
"""

from __future__ import annotations

import numpy as np

from impact_rig.kernels import REALS_2D, Reals, Record, Records, entry, kernel
from impact_rig.physics.flight import DriveSegment, drive_segment, mode_decay, phasor, resolve
from impact_rig.physics.model import MODEL, Model
from impact_rig.physics.sampling import TRAJECTORY, Trajectory, begin_flight_at
from impact_rig.physics.state import ATTACHED, CONTACT, FLIGHT, PRESCRIBED, SPHERE_LOOSE, V1, X1, XB

CYCLE = np.dtype(
    [
        ("x_b", "c16"),  # X_b of x_b = Im(X_b exp(jωt)), t from the start of the cycle [m]
        ("x_1", "c16"),  # X_1, likewise [m]
        ("x_2", "f8"),  # position of the sphere at the start of the cycle, 0 without a sphere [m]
        ("v_2", "f8"),  # its velocity at that instant [m/s]
    ]
)
"""Record of one cycle of the drive: complex amplitudes of both bases, and the sphere's motion at the start."""


@kernel
def _sphere(p: Record, s: Record) -> tuple[float, float]:
    """Return the sphere's position x_2 [m] and velocity v_2 [m/s] in a state of any phase."""
    if s.phase != CONTACT:
        return s.y[X1] + s.d, s.y[V1] + s.d_rate
    part = (1.0 - p.share) * s.side
    return s.y[X1] + s.d + part * s.w * s.w, s.y[V1] + part * s.speed


@kernel
def _integrate_straight(omega: float, length: float, x_2: float, v_2: float, x_end: float, v_end: float) -> complex:
    """Return the integral of x_2'' exp(−jωt) over one step of a contact, with t counted from the middle of the step.

    The acceleration x_2'' is approximated as linear in time. During the `length` seconds of the step, position and
    velocity of the sphere change from x_2 and v_2 to x_end and v_end.
    """
    moment = 0.5 * length * (v_end + v_2) - (x_end - x_2)  # of x_2'' about the middle
    square = omega * length * omega * length
    return complex((v_end - v_2) * (1.0 - square * (1.0 / 24.0)), -omega * moment * (1.0 - square * (1.0 / 40.0)))


@kernel
def _integrate_one_body(
    system: Record, flight: Record, omega: float, t: float, rotor: complex, t_end: float, rotor_end: complex
) -> complex:
    """Return the integral of x_1'' exp(−jωt) from t to t_end in a flight with the sphere attached.

    `rotor` and `rotor_end` are exp(−jωt) at both ends. t counts from the start of the drive segment [s].
    """
    jw = complex(0.0, omega)
    steady, growing = flight.steady[X1], flight.growing[X1]
    for _ in range(2):
        steady, growing = jw * steady + growing, jw * growing
    length, minus_2jw = t_end - t, -2.0 * jw
    total = length * (steady + 0.5 * (t_end + t) * growing)
    steady, growing = steady.conjugate(), growing.conjugate()
    end = (steady + growing * t_end - growing / minus_2jw) * (rotor_end * rotor_end)
    total = (total - (end - (steady + growing * t - growing / minus_2jw) * (rotor * rotor)) / minus_2jw) * -0.5j
    for n in range(system.modes):
        rate = system.rate[n]
        _, decay = mode_decay(rate, length)
        wave = 0.5 * (rate * rate) * system.right[n, X1] * flight.modal[n]
        total += wave * (decay * rotor_end - rotor) / (rate - jw)
        total += wave.conjugate() * (decay.conjugate() * rotor_end - rotor) / (rate.conjugate() - jw)
    return total


@kernel
def _integrate_acceleration(
    model: Model, f: DriveSegment, trajectory: Trajectory, rows: tuple[int, int], duration: float, flight: Record
) -> complex:
    """Return the integral of x_2'' exp(−jωt) over the drive segment f, with x_2'' the acceleration of the sphere.

    t runs from the start of the segment to `duration` [s]. `rows` are two row numbers of the history: of the first
    state in this segment, and of the first state in the next segment.
    """
    p, history, total, rotor = model.parameters[0], trajectory.history, 0.0j, 1.0 + 0.0j
    x_2, v_2 = _sphere(p, history[rows[0]])
    for row in range(rows[0], rows[1]):
        s = history[row]
        t_end = history[row + 1].t if row + 1 < rows[1] else duration
        rotor_end = phasor(-f.omega * t_end)
        x_end, v_end = _sphere(p, history[row + 1])
        length = t_end - s.t
        if s.phase == CONTACT:
            total += phasor(-f.omega * (s.t + 0.5 * length)) * _integrate_straight(
                f.omega, length, x_2, v_2, x_end, v_end
            )
        elif s.phase == ATTACHED:
            system = begin_flight_at(model, f, s, flight)
            total += _integrate_one_body(system, flight, f.omega, s.t, rotor, t_end, rotor_end)
        else:
            braking = -s.slide * p.friction_acceleration
            total += braking * (rotor_end - rotor) * complex(0.0, 1.0 / f.omega)
            total += (v_end - v_2 - braking * length) * rotor_end  # at a rigid wall the speed changes at once
        x_2, v_2, rotor = x_end, v_end, rotor_end
    return total


@entry(MODEL, TRAJECTORY, FLIGHT, REALS_2D)
def follow_cycles(model: Model, trajectory: Trajectory, flights: Records, out: Reals) -> None:
    """Compute the record CYCLE for each drive segment of the trajectory: both bases' amplitudes and the sphere's start.

    Each segment must be one complete cycle of the drive. A row of `out`, shape (segments, 6), holds real and imaginary
    part of X_b and of X_1, then x_2 and v_2 of the sphere at the start of the cycle. `flights` is scratch memory, one
    record of FLIGHT.
    """
    p, system, flight = model.parameters[0], model.systems[SPHERE_LOOSE], flights[0]
    flight.omega = -1.0
    for i in range(out.shape[0]):
        row = trajectory.segments[i]
        f, duration = drive_segment(row), row.duration
        sphere_integral = 0.0j
        if p.sphere_present:
            rows = trajectory.first_state[i], trajectory.first_state[i + 1]
            sphere_integral = -p.m * _integrate_acceleration(model, f, trajectory, rows, duration, flight)
        jw, rotor = complex(0.0, f.omega), phasor(f.phase)
        drive = rotor * (f.amplitude + 0.5 * f.growth * duration) * duration * -0.5j
        drive -= rotor.conjugate() * (f.growth * duration * 0.25 / f.omega)
        rise = f.growth * duration * rotor.imag
        begin, end = trajectory.history[trajectory.first_state[i]], trajectory.history[trajectory.first_state[i + 1]]
        load = flight.steady  # scratch
        for k in range(system.states):
            load[k] = begin.y[k] - end.y[k] + system.b_0[k] * drive + system.b_1[k] * (rise + jw * drive)
        load[V1] += sphere_integral * p.per_m_1
        x_2, v_2 = _sphere(p, begin)
        out[i, 4], out[i, 5] = (x_2, v_2) if p.sphere_present else (0.0, 0.0)
        for s, sign in ((begin, 1.0), (end, -1.0)):
            if s.phase == CONTACT:  # y belongs to the pair
                load[X1] -= sign * p.share * s.side * s.w * s.w
                load[V1] -= sign * p.share * s.side * s.speed
        resolve(system, f.omega, load, flight.answer)
        flight.omega = -1.0  # mark it as holding no answer to the drive
        base = drive if p.drive_kind == PRESCRIBED else flight.answer[XB]
        amplitude = complex(0.0, 2.0 / duration)
        base, superior = amplitude * base, amplitude * flight.answer[X1]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = base.real, base.imag, superior.real, superior.imag
