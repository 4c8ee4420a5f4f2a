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
"""Virtual test rig: drive, mechanics, instruments and journal combined in the class `Rig`.

The rig reads no clock: its caller says up to which rig time to simulate. The rig simulates whole ticks of 10 ms. The
first time that is not yet simulated is its *frontier*. A command takes effect at the frontier. The journal contains
each input with the first scan on which the input acts. Blocks are cut from scans that are already measured, so the
length of a block changes no sample. Individually valid values may be jointly infeasible, so new mechanics are tried in
a short simulation first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any  # Any: members of a journal entry

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

import impact_rig
from impact_rig import topics
from impact_rig.arithmetic.random import Random
from impact_rig.blocks import APPLIED, FRAME_DAQ, STREAM, Table
from impact_rig.config import Drive, Pluck
from impact_rig.config.tree import Value
from impact_rig.errors import CommandError, ConfigError, SimulationError
from impact_rig.instruments.chain import Chain
from impact_rig.instruments.fault import Fault
from impact_rig.physics import FunctionGenerator, Motion, Simulation
from impact_rig.physics.model import Model, build
from impact_rig.physics.stream import UNDERRUN, Event, Stream, StreamState
from impact_rig.rig.config import RigConfig, differences, from_flat
from impact_rig.rig.interlock import Interlock, Trip, check_amplitude, check_frequency, check_stream
from impact_rig.rig.journal import (
    INSTRUMENT_SECTIONS,
    PLANNED,
    InputKind,
    Journal,
    PlannedFaults,
    deciding_samples,
    is_mechanics,
    not_default,
    until_reset,
)
from impact_rig.rig.truth import Truth
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S, NS_PER_S, TICKS_PER_S, scan_index, stamp_ns

TRIAL_TICKS = 3
SLOWEST_RATE, FASTEST_RATE = 0.5, 1e5
"""Limits for the rates of the modes of structure and shaker, including the coil [1/s].

A slower mode moves in a tick of 10 ms by less than the rounding of its position. A faster one (a coil of L < 10 µs · R)
requires such short contact steps that a sphere at rest on a wall cannot be simulated in real time.
"""
_NOT_TOGETHER = (
    "the values of structure, shaker, sphere, barriers and contact cannot be simulated together, so correct them"
)
DRIVE_SEED = 0  # `spawn_key` of the drive's random numbers under `daq.seed`; the instruments use their own


def new_generator(config: RigConfig) -> FunctionGenerator:
    """Return a new function generator with the frequency and amplitude of the configuration.

    For a stream, the generator has the amplitude 0, but the configured amplitude is checked nevertheless.

    Raises:
        ConfigError: the configured amplitude exceeds the limits of the shaker, or the upper end of a random drive's
            band is 45 Hz or more.
    """
    seeds = np.random.SeedSequence(config.daq.seed, spawn_key=(DRIVE_SEED,))
    try:
        check_amplitude(config.drive.amplitude, config.drive, config.shaker)
    except CommandError as error:
        raise ConfigError(f"drive.amplitude: {error}") from error
    return FunctionGenerator(config.drive, config.shaker, Random(seeds))


def tried_model(config: RigConfig) -> Model:
    """Build the mechanical model of a configuration, and test it in a short simulation.

    Raises:
        ConfigError: the mechanics cannot be simulated, or the motion becomes infinite.
    """
    try:
        model = build(config)
        _check_together(config, model)
        sine = attrs.evolve(config.drive, waveform="sine") if config.drive.waveform == "stream" else config.drive
        trial, drive = Simulation(config, model=model), FunctionGenerator(sine, config.shaker, Random(0))
        drive.set_amplitude(1.0)
        motion = trial.advance(drive.segments(TRIAL_TICKS))
        last = motion.sample(np.array([motion.last_tick]), np.array([COMMAND_GRID_S]))
    except (ArithmeticError, ValueError, SimulationError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{_NOT_TOGETHER}: {error}") from error
    if not all(np.isfinite(last[name]).all() for name in last.dtype.names or ()):
        raise ConfigError(f"{_NOT_TOGETHER}: the motion becomes infinite within {TRIAL_TICKS * COMMAND_GRID_S:g} s")
    return model


def _check_together(config: RigConfig, model: Model) -> None:
    """Check that the mechanics can be simulated with this combination of masses, stiffnesses and dampings.

    Raises:
        ConfigError: the sphere outweighs the superior base, or a mode is too slow or too fast.
    """
    mass_kg, structure_kg = float(model.parameters["m"][0]), config.structure.mass_kg
    if mass_kg > structure_kg:
        raise ConfigError(
            f"the sphere must not outweigh the superior base that carries it, structure.mass_kg = {structure_kg:g} kg, "
            f"got {mass_kg:.4g} kg of sphere.diameter_m and density_kg_m3"
        )
    for system in model.systems:
        for value in np.abs(system["rate"][: int(system["modes"])]):
            if not SLOWEST_RATE <= value <= FASTEST_RATE:
                raise ConfigError(
                    f"each mode of structure and shaker must have a rate (|eigenvalue|) >= {SLOWEST_RATE:g} and "
                    f"<= {FASTEST_RATE:g} 1/s, got {value:.3g} 1/s: change the ratio of stiffness or damping to mass, "
                    "of stiffness to damping, or of coil resistance to inductance"
                )


@attrs.frozen(eq=False)
class Block:
    """Block of `daq.block_scans` consecutive scans, with the true motion and the contacts that ended during them.

    If a fault withholds the scans (`lost`), all other tables are still published.

    Attributes:
        number: number of the block since the start or reset, from 0.
        first_scan: index of its first scan since the start or reset, from 0.
        end_ns: stamp of the first scan after the block, which is the rig time at which the block is complete [ns].
        scan: table of `daq/scan`, also if the scans are withheld.
        impacts: table of `truth/impacts`, the contacts that ended in this block; None if there were none.
        monitor_states: true motion at the instants of the monitor topics, rows of `blocks.TRUTH_SCAN`, with `time`
            since the stamp of `scan`.
        monitor_scans: indices of the rows of `scan` at these instants.
        truth: table of `truth/scan`; None unless `output.truth_scan` was on during the whole block and still is.
        faults: table of `truth/faults`, the faults that start or end in this block; None if there are none.
        lost: whether a `lost_block` fault acts on any of the scans; then all scans of the block are withheld.
    """

    number: int
    first_scan: int
    end_ns: int
    scan: Table
    impacts: Table | None
    monitor_states: NDArray[np.void]
    monitor_scans: NDArray[np.int64]
    truth: Table | None
    faults: Table | None
    lost: bool

    def tables(self) -> list[tuple[topics.Topic, Table]]:
        """Return all tables of the block, each with its topic.

        The order is scans, impacts, faults, true motion. Tables that do not exist and withheld scans (`lost`) are left
        out.
        """
        order = (topics.SCAN, topics.IMPACTS_TRUTH, topics.FAULTS, topics.TRUTH_SCAN)
        tables = (None if self.lost else self.scan, self.impacts, self.faults, self.truth)
        return [(topic, table) for topic, table in zip(order, tables, strict=True) if table is not None]


BATCH_TICKS = 50  # ticks per call: enough to amortise the overhead of a call, few enough to limit memory
EMERGENCY = "emergency stop"


class Rig:
    """Virtual test rig without a clock: the caller says up to which rig time to simulate.

    Most programs use `LocalRig` or `RosRig` instead, which add analysis, recordings and topics. `advance` simulates the
    rig and returns blocks of scans. Inputs such as `accept` take effect at the frontier, the first time on a grid of 10
    ms that is not simulated yet. Only faults and samples of a stream have times of their own. The same configuration
    and inputs give the same bits on every machine.

    Args:
        config: configuration of the rig.
        start_ns: stamp of scan 0 [ns].

    Raises:
        ConfigError: the drive exceeds the limits of the shaker, the mechanics cannot be simulated with these values, or
            the instruments do not support `daq.rate_hz`.

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.Rig(impact_rig.RigConfig())
        >>> applied = rig.accept(frequency_hz=9.1, amplitude=0.52)  # Hz, A peak
        >>> blocks = rig.advance(until_ns=10**9)
        >>> len(blocks), blocks[0].scan.rows["laser"].shape
        (100, (100,))

    See Also:
        - `LocalRig`: this rig with analysis, recording and tables that are kept.
        - `Tracker`: measures the blocks.
        - docs/explanation/physics.md: the equations, with their sources.
    """

    start_ns: int  # stamp of scan 0; a reset moves it to the present
    _generator: FunctionGenerator
    _simulation: Simulation
    _interlock: Interlock
    _planned_faults: PlannedFaults
    _chain: Chain
    _truth: Truth

    def __init__(self, config: RigConfig, start_ns: int = 0) -> None:
        self.config = config
        self.rate_hz = config.daq.rate_hz
        self._journal = Journal(self.rate_hz, start_ns)
        self._certificate: NDArray[np.void] | None = None  # certificate of the present instruments; computed on demand
        self.take_journal = self._journal.take  # returns and drops the new entries of the journal
        self._applied: list[Table] = []
        self._latched: str | None = None
        self._tripped: frozenset[str] = frozenset()  # reasons of the interlock since the shaker was last free
        self._begin(InputKind.START, start_ns)

    # State

    @property
    def frontier_ns(self) -> int:
        """First rig time that is not yet simulated [ns], a multiple of 10 ms after scan 0; commands act from there."""
        return self.start_ns + self._ticks * COMMAND_GRID_NS

    @property
    def frontier_sample(self) -> int:
        """Index, from the start or reset, of the first scan on which a command made now acts."""
        return -(-self._ticks * self.rate_hz // TICKS_PER_S)

    @property
    def next_block_ns(self) -> int:
        """Stamp of the first scan of the next block [ns]."""
        return self._stamp(self._next_scan)

    @property
    def frequency_hz(self) -> float:
        """Commanded drive frequency [Hz] at the frontier; for a chirp, always its first frequency.

        For a random drive or a stream it is the value configured at the last start or reset, which has no effect.
        """
        return float(self._generator.frequency_hz)

    @property
    def target_amplitude(self) -> float:
        """Amplitude to which the drive ramps or has ramped: peak (rms for random), in A, m or V by `drive.kind`.

        It is the commanded value, or 0 after a stop, trip, command timeout or pluck. For a stream, whose samples set
        the amplitude, it is always 0.
        """
        return float(self._generator.target_amplitude)

    @property
    def latched(self) -> str | None:
        """Reason why the shaker is stopped until `clear_trip`, or None."""
        return self._latched

    @property
    def plucked(self) -> bool:
        """Return whether `pluck` has locked the inferior base, which lasts until the next reset."""
        return self._simulation.locked

    @property
    def simulation(self) -> Simulation:
        """Simulation of the mechanics, for diagnostics such as the energy balance; do not advance it.

        A call of `advance` or `reset` may replace the object, so get it again afterwards.
        """
        return self._simulation

    @property
    def is_driven(self) -> bool:
        """Return whether `target_amplitude` is not zero; for a stream, return whether its samples take effect now."""
        stream = self._generator.stream
        return self.target_amplitude != 0.0 if stream is None else stream.state is StreamState.PLAYING

    @property
    def takes_samples(self) -> bool:
        """Return whether samples of a stream drive the rig (`drive.waveform: stream`), instead of commands."""
        return self._generator.stream is not None

    @property
    def stream(self) -> Stream:
        """Stream that drives the rig.

        Raises:
            CommandError: the drive is not a stream.
        """
        if self._generator.stream is None:
            raise CommandError(
                f"the drive is {self._drive.waveform}, not a stream: set drive.waveform to stream and reset the rig"
            )
        return self._generator.stream

    def blocks_with_samples(self, most: int) -> int:
        """Return how many of the next blocks can be simulated with the samples of the stream that have arrived.

        Args:
            most: upper limit of the result. It is the result if no block waits for samples: the drive is no stream, the
                configuration does not ask to wait (`drive.stream_wait`), or the stream has ended or was stopped.
        """
        stream = self._generator.stream
        whole = stream.whole_ticks() if stream is not None and self._drive.stream_wait else None
        if whole is None:
            return most
        end_scan = whole * self.rate_hz // TICKS_PER_S
        return min(most, max(0, end_scan - self._next_scan) // self.config.daq.block_scans)

    def stream_state(self) -> Table:
        """Return the table of the topic `shaker/stream`: one row, stamped with the rig time of the next sample needed.

        Raises:
            CommandError: the drive is not a stream.
        """
        stream = self.stream
        buffered, playing = stream.buffered(), float(stream.state is StreamState.PLAYING)
        late, refused = self._late_samples, self._refused_blocks
        row = (0.0, stream.played, buffered, stream.capacity, playing, late, refused, stream.missing, stream.rate_hz)
        return Table(self.start_ns + stream.time_ns(stream.played), np.array([row], STREAM))

    def block_end_ns(self, blocks: int) -> int:
        """Return the rig time at which the next `blocks` blocks will be complete [ns].

        Args:
            blocks: number of blocks, of which the first is the next one that `advance` returns.
        """
        return self._stamp(self._next_scan + blocks * self.config.daq.block_scans)

    def info(self) -> Table:
        """Return the table of the topic `daq/info`, the calibration; its stamp is the time from which it applies."""
        if self._certificate is None:
            self._certificate = self._chain.info()
        rows, stamp = self._certificate.copy(), self._stamp(self._info_sample)
        rows["since_start"] = (stamp - self.start_ns) / NS_PER_S
        return Table(stamp, rows)

    # Time

    def advance(self, until_ns: int) -> list[Block]:
        """Simulate up to a rig time, and return the blocks that have become complete since the last call.

        A later call completes and returns a block that ends after `until_ns`.

        Args:
            until_ns: rig time [ns].

        Returns:
            Complete blocks, oldest first; may be empty. In a block, `scan` is the table of `daq/scan`. `number`,
            `first_scan` and `end_ns` say when it was measured. `impacts`, `faults` and `truth` are tables of the true
            events and motion, or None. `lost` says whether a fault withholds the scans.

        Raises:
            SimulationError: the motion cannot be simulated.
        """
        size = self.config.daq.block_scans
        elapsed = until_ns - self.start_ns
        ended = ((elapsed + 1) * self.rate_hz - 1) // NS_PER_S  # number of complete scans: the next one has begun
        complete = (ended - self._next_scan) // size
        blocks: list[Block] = []
        needed = max(elapsed // COMMAND_GRID_NS, self._ticks)
        if complete > 0:
            end_scan = self._next_scan + complete * size
            needed = max(needed, -(-end_scan * TICKS_PER_S // self.rate_hz))
        while True:
            # a contact that ends in the last tick of a block belongs to it: that tick must have been simulated
            while len(blocks) < complete and self._ticks * self.rate_hz >= (self._next_scan + size) * TICKS_PER_S:
                blocks.append(self._cut(size))
            if self._ticks >= needed:
                return blocks
            self._simulate(min(needed - self._ticks, BATCH_TICKS))

    def _simulate(self, ticks: int) -> None:
        """Simulate at most `ticks` ticks, and stop early when the drive or the scan clock changes.

        The drive changes at a trip of the interlock, a command timeout or an event of the stream. A fault can change
        the rate of the scan clock. The caller must call again for the remaining ticks.
        """
        self._time_out_if_due()  # immediately, if the timeout was shortened
        due = self._timeout_tick()
        if due is not None:
            ticks = min(ticks, due - self._ticks)
        if self._generator.stream is not None:
            ticks = min(ticks, self._generator.stream.ticks_until_event(self._ticks))
        ppm = self._chain.clock_ppm(self._ticks)
        if ticks > 1:
            ticks = next((k for k in range(1, ticks) if self._chain.clock_ppm(self._ticks + k) != ppm), ticks)
        tick_s = COMMAND_GRID_S * (1.0 + 1e-6 * (self.config.daq.clock_error_ppm + ppm))
        self._generator.set_tick(tick_s)
        before = (self._simulation.copy(), self._generator.copy(), self._interlock.copy()) if ticks > 1 else None
        motion = self._simulation.advance(self._generator.segments(ticks))
        trip = self._watch(motion, tick_s)
        if trip is not None and trip.tick < ticks - 1:  # after that tick the drive must already be ramping down
            assert before is not None
            self._simulation, self._generator, self._interlock = before
            ticks = trip.tick + 1
            motion = self._simulation.advance(self._generator.segments(ticks))
            trip = self._watch(motion, tick_s)
        self._truth.take(motion, tick_s)
        self._chain.acquire(motion, self._ticks, ticks, tick_s)
        self._ticks += ticks
        underrun = self._journal_stream()
        trip = trip or underrun  # if both occur in one tick, that of the interlock
        if trip is not None:
            self._trip(trip)
        else:
            self._time_out_if_due()

    def _journal_stream(self) -> Trip | None:
        """Write new events of the stream to the journal; return a trip if an underrun must stop the shaker, else None.

        An underrun stops the shaker only with `drive.on_underrun: trip`.
        """
        stream, trip = self._generator.stream, None
        if stream is None or not stream.events:
            return None
        happened, stream.events = stream.events, []
        for event, sample, text in happened:
            self._add_entry(InputKind.STREAM, name=event.value, value=float(sample), text=text)
            if event is Event.END and text == UNDERRUN and self._drive.on_underrun == "trip" and self._latched is None:
                trip = Trip(0, UNDERRUN, float(sample), 0.0)
        return trip

    def _cut(self, size: int) -> Block:
        """Return the next `size` scans as a block, with the true motion, impacts and faults during them.

        The rig forgets what it returns.
        """
        first = self._next_scan
        stamp = self._stamp(first)
        states, scans, is_monitored = self._truth.pop_states(first, size)
        impacts = self._truth.pop_impacts(first, size)
        faults = self._chain.fault_rows(first, size)
        block = Block(
            number=self._blocks,
            first_scan=first,
            end_ns=self._stamp(first + size),
            scan=Table(stamp, self._chain.read(size)),
            impacts=Table(stamp, impacts, FRAME_DAQ) if len(impacts) else None,
            monitor_states=states[is_monitored],
            monitor_scans=scans[is_monitored],
            truth=Table(stamp, states) if self._truth.every_scan and len(states) == size else None,
            faults=Table(stamp, faults) if len(faults) else None,
            lost=self._chain.block_lost(first, size),
        )
        self._next_scan += size
        self._blocks += 1
        return block

    # Inputs: commands and parameters act at the frontier and are journaled there; faults and samples at their own scans

    def accept(self, frequency_hz: float | None = None, amplitude: float | None = None) -> Table:
        """Apply a command to the drive at the frontier.

        A new frequency applies at once, and a new amplitude after a linear ramp of duration `shaker.ramp_s`. Each
        accepted call restarts the command timeout, even a call without values.

        Args:
            frequency_hz: new frequency [Hz], for a sine only; None leaves it unchanged.
            amplitude: new amplitude, peak (rms for random drive), in A, m or V by `drive.kind`, not for a stream. None
                leaves it unchanged.

        Returns:
            The table that is published on `shaker/applied`: one row with the first scan that the command acts on.

        Raises:
            CommandError: a value is out of range or not finite, the waveform does not accept it, the shaker is latched,
                or a pluck has locked the base. Nothing is changed.
        """
        self._refuse_if_stopped()
        if self._generator.stream is not None:
            raise CommandError(
                "the drive is a stream: it accepts no frequency or amplitude, only samples on shaker/waveform; a block "
                "without samples ends it"
            )
        if frequency_hz is not None:
            if self._drive.waveform != "sine":
                raise CommandError(
                    f"the drive is {self._drive.waveform}: it accepts no frequency, only an amplitude; for a frequency,"
                    " set drive.waveform to sine and reset the rig"
                )
            check_frequency(frequency_hz, self.config.shaker)
        if amplitude is not None:
            check_amplitude(amplitude, self._drive, self.config.shaker)
        if frequency_hz is not None:
            self._generator.set_frequency(frequency_hz)
            self._journal.add(self.frontier_sample, InputKind.COMMAND, name="frequency", value=frequency_hz)
        if amplitude is not None:
            self._generator.set_amplitude(amplitude)
            self._journal.add(self.frontier_sample, InputKind.COMMAND, name="current", value=amplitude)
        self._last_command_tick, self._timed_out = self._ticks, False
        return self._add_applied()

    def feed(self, first_sample: int, values: ArrayLike) -> int:
        """Store samples of the stream that drives the rig (`drive.waveform: stream`).

        Sample k is due k · 10⁹ // `drive.stream_rate_hz` ns after scan 0. It can be replaced until the simulation needs
        it: with `drive.stream_hold: first_order` up to one sample interval before its time. An empty array ends the
        stream at `first_sample`. Any other missing sample after the start of the stream is an underrun, to which the
        rig reacts as `drive.on_underrun` says.

        Args:
            first_sample: number of the first sample.
            values: samples [A, m or V by `drive.kind`], shape (n,).

        Returns:
            Number of samples that arrived after the simulation needed them; they have no effect.

        Raises:
            CommandError: a value is not finite or exceeds the shaker, the samples reach beyond `drive.stream_buffer_s`,
                the shaker is latched, a pluck has locked the base, or the drive is not a stream. Then none of the
                samples is stored.
        """
        stream = self.stream
        try:
            self._refuse_if_stopped()
            samples = np.array(values, np.float64)
            check_stream(samples, self._drive, self.config.shaker)
            late = stream.put(first_sample, samples)
        except CommandError:
            self._refused_blocks += 1
            raise
        self._late_samples += late
        return late

    def sample_at(self, stamp_ns: int) -> int:
        """Return the number of the stream's sample that is due at a rig time.

        Args:
            stamp_ns: rig time [ns].

        Raises:
            CommandError: the time is more than a quarter of the sample interval from the time of the nearest sample, or
                the drive is not a stream.
        """
        rate = self.stream.rate_hz
        sample = scan_index(stamp_ns, rate, self.start_ns)
        off_ns = stamp_ns - self.start_ns - self.stream.time_ns(sample)
        if abs(off_ns) * rate * 4 > NS_PER_S:
            self._refused_blocks += 1
            raise CommandError(
                f"the stamp of a block of samples must be the time of its first sample, {self.start_ns} ns + k/{rate} "
                f"s ± {0.25 / rate:.3g} s, got {stamp_ns} ns, which is {off_ns} ns off the nearest sample"
            )
        return sample

    def configure(self, changes: Mapping[str, object]) -> RigConfig:
        """Change configuration values at the frontier, all or none.

        The section `drive` and `daq.seed` apply at the next reset, other values at the frontier. After a change of the
        mechanics, the sphere rests at `sphere.start` again, and the energy account restarts. The mechanics are the
        sections structure, shaker, sphere, barriers and contact, except limits and ramps of the shaker. A line added to
        the planned faults starts a fault, whose `start_s` counts from the frontier. A removed line ends its fault.

        Args:
            changes: new values, `section.key` -> value, as in docs/reference/configuration.md.

        Returns:
            The new configuration.

        Raises:
            ConfigError: unknown key, bad value, bad combination, or a value fixed at start (`daq.rate_hz`,
                `daq.block_scans` and which instruments are present); nothing is changed.
        """
        config = from_flat(self.config, changes)
        changed = differences(config, self.config)
        if not changed.keys().isdisjoint(("daq.rate_hz", "daq.block_scans")):
            raise ConfigError("daq.rate_hz and daq.block_scans are fixed at start: create a new rig to change them")
        self.adopt(config, changed)
        return config

    def adopt(self, config: RigConfig, changed: Mapping[str, Value]) -> None:
        """Apply a complete configuration at the frontier, with the same effects as `configure`.

        Args:
            config: the new configuration. Its `daq.block_scans` must equal the present value, which is not checked.
            changed: the values in which `config` differs from the present configuration, by full name.

        Raises:
            ConfigError: the values contradict each other or cannot be simulated together, or change the scan rate or
                which instruments are present; nothing is changed.
        """
        mechanics = attrs.evolve(config, drive=self._drive)
        instruments = until_reset(self._chain.config, config)
        new_mechanics = any(is_mechanics(name) for name in changed)
        new_instruments = any(name.startswith(INSTRUMENT_SECTIONS) and name != PLANNED for name in changed)
        replan = self._planned_faults.replan(config.instruments.faults.planned, self.frontier_sample)
        if any(name.startswith("drive.") for name in changed):
            new_generator(config)  # applies at the next reset, but is checked here
        model = tried_model(mechanics) if new_mechanics else None  # checked here, before anything is changed
        if config.drive.kind != self._drive.kind:  # what the next reset would use is checked as well
            tried_model(config)
        if new_instruments:
            Chain(instruments)
        self._chain.reconfigure(instruments)  # always: the structure's mass and the fastest drive affect readings, too
        if model is not None:
            self._simulation.configure(mechanics, model)
        if "shaker.ramp_s" in changed:
            self._generator.set_ramp(config.shaker.ramp_s)
        self.config = config
        self._truth.configure(config.output.monitor_rate_hz, config.output.truth_scan)
        values = {name: value for name, value in deciding_samples(changed).items() if name != PLANNED}
        if values:
            self._add_entry(InputKind.PARAMETER, values=values)
        self._planned_faults.apply(replan, self._clear_if_there, self.inject)
        if new_instruments:
            self._info_sample, self._certificate = self.frontier_sample, None

    def reset(self) -> None:
        """Start again at the frontier with the present configuration: from scan 0, with all bodies at rest.

        The drive starts with its configured frequency and amplitude. Injected faults are removed, and planned faults
        start again. A base locked by `pluck` is released. Measured scans that no block contains yet are dropped, and so
        are the stored samples of a stream. Stamps continue, so none is used twice.

        Raises:
            CommandError: the shaker is latched; a reset must not clear an emergency stop.
            ConfigError: `drive.amplitude` exceeds the limits of the shaker that `configure` has set; nothing is
                changed.
        """
        if self._latched is not None:
            raise CommandError(f"cannot reset: {self._why_latched()}")
        self._begin(InputKind.RESET, self.frontier_ns)

    def pluck(self, displacement_m: float) -> None:
        """Start a free decay: lock the inferior base at zero, and release the superior base from a displacement.

        The release is at the frontier, from rest. The sphere then rests at `sphere.start`, and the drive amplitude
        becomes zero. Until a reset, the base stays locked, and commands and samples are refused. A further pluck is
        allowed. A pluck is also allowed while the shaker is latched.

        Args:
            displacement_m: displacement x_1 at the release [m], in the range of `pluck.displacement_m`.

        Raises:
            CommandError: the displacement is out of range.
        """
        try:
            Pluck(displacement_m=displacement_m)
        except ConfigError as error:
            raise CommandError(f"pluck: {error}") from error
        self._simulation.pluck(displacement_m)
        self._generator.set_amplitude(0.0)
        self._add_entry(InputKind.PLUCK, value=displacement_m)
        self._add_applied()

    def stop(self, reason: str = EMERGENCY) -> None:
        """Ramp the shaker to zero within `shaker.stop_ramp_s` and latch it until `clear_trip`: the emergency stop.

        The ramp begins at the frontier. A rig that is stopped before its first `advance` does not start to move.

        Args:
            reason: reason to report, by default "emergency stop"; it replaces the reason of an earlier stop or trip.
        """
        self._add_entry(InputKind.STOP)
        self._latch(reason)

    def clear_trip(self) -> None:
        """Release a shaker that `stop` or a trip has latched; it stays at zero until an amplitude or samples arrive."""
        self._add_entry(InputKind.CLEAR_TRIP)
        if self._latched is not None:
            self._latched, self._tripped = None, frozenset()
            self._interlock.reset()

    def inject(self, fault: Fault) -> int:
        """Plan an instrument fault, which acts from the scan `fault.start_sample` on.

        Args:
            fault: the fault; the scan with the number `start_sample` must not be measured yet.

        Returns:
            Number of the fault, for `clear_fault`. It counts from 1 and includes the planned faults, which come first.
            A reset restarts the count after the planned faults.

        Raises:
            CommandError: the rig does not have the fault's channel, or the fault starts at a scan that is already
                measured.
        """
        number = self._chain.inject(fault)
        self._journal.add(fault.start_sample, InputKind.FAULT, fault=fault)
        return number

    def clear_fault(self, number: int | None = None) -> None:
        """End instrument faults at the first scan that is not measured yet.

        Args:
            number: number of the fault, as returned by `inject`; None ends all faults, also planned ones. A fault that
                has not started yet never acts. The number of a fault that has already ended is allowed and has no
                effect.

        Raises:
            CommandError: no fault of this number was planned or injected since the start or reset.
        """
        self._chain.clear(number)
        self._add_entry(InputKind.CLEAR_FAULT, value=None if number is None else float(number))

    def take_applied(self) -> list[Table]:
        """Return the new tables for the topic `shaker/applied` since the last call, and drop them."""
        applied, self._applied = self._applied, []
        return applied

    # Inside

    @property
    def _drive(self) -> Drive:
        """Active drive configuration, which is that of the last start or reset; a reset makes `config.drive` active."""
        return self._simulation.config.drive

    def _begin(self, kind: InputKind, start_ns: int) -> None:
        config = self.config
        parts = new_generator(config), tried_model(config), Chain(config)  # an error leaves everything unchanged
        self._generator, model, self._chain = parts
        self._simulation = Simulation(config, account=True, model=model)
        self.start_ns = start_ns
        self._journal.restart(start_ns)
        self._ticks = 0
        self._next_scan = 0
        self._blocks = 0
        self._latched, self._tripped = None, frozenset()
        self._last_command_tick = 0
        self._timed_out = False
        self._late_samples = self._refused_blocks = 0
        self._info_sample = 0
        self._certificate = None
        self._interlock = Interlock()
        self._planned_faults = PlannedFaults(config.instruments.faults.planned, self.rate_hz)
        self._truth = Truth(self.rate_hz, config.output.monitor_rate_hz, config.output.truth_scan)
        self._add_entry(kind, text=impact_rig.__version__, values=not_default(config))
        self._add_applied()

    def _clear_if_there(self, number: int) -> None:
        if number in self._chain.fault_numbers():
            self.clear_fault(number)

    def _why_latched(self) -> str:
        return f"the shaker is latched by {self._latched}: call ~/clear_trip (in Python Rig.clear_trip) first"

    def _refuse_if_stopped(self) -> None:
        if self._latched is not None:
            raise CommandError(self._why_latched())
        if self.plucked:
            raise CommandError(
                "the inferior base is locked after a pluck, a free decay: before a command or samples, call ~/reset "
                "(in Python Rig.reset)"
            )

    def _watch(self, motion: Motion, tick_s: float) -> Trip | None:
        if self.plucked:
            return None
        return self._interlock.watch(motion, tick_s, self._drive, self.config.shaker, self._tripped)

    def _trip(self, trip: Trip) -> None:
        self._add_entry(InputKind.TRIP, name=trip.reason, value=trip.measured)
        self._tripped |= {trip.reason}
        self._latch(trip.message())

    def _latch(self, reason: str) -> None:
        self._latched = reason
        self._generator.stop(self.config.shaker.stop_ramp_s)
        self._add_applied()

    def _timeout_tick(self) -> int | None:
        """Return the number of the tick at whose start the command timeout passes; None if no timeout is pending.

        No timeout is pending if none is configured, if it has already passed, if the shaker is latched, or if the
        target amplitude is zero.
        """
        timeout = self.config.output.command_timeout_s
        if timeout <= 0 or self._timed_out or self._latched is not None or self.target_amplitude == 0:
            return None
        return self._last_command_tick + max(1, round(timeout * TICKS_PER_S))

    def _time_out_if_due(self) -> None:
        due = self._timeout_tick()
        if due is None or self._ticks < due:
            return
        self._timed_out = True
        self._add_entry(InputKind.TIMEOUT)
        self._generator.set_amplitude(0.0)
        self._add_applied()

    def _add_entry(self, kind: InputKind, **members: Any) -> None:
        self._journal.add(self.frontier_sample, kind, **members)

    def _add_applied(self) -> Table:
        sample = self.frontier_sample
        drive = self._generator
        row = (0.0, sample, drive.frequency_hz, drive.target_amplitude, drive.phase_rad)
        table = Table(self._stamp(sample), np.array([row], APPLIED))
        self._applied.append(table)
        return table

    def _stamp(self, sample: int) -> int:
        return stamp_ns(sample, self.rate_hz, self.start_ns)
