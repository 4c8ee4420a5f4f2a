// Copyright 2026 The impact_rig developers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.
#include "rig.h"
#include "impact_rig.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { NODES = 8, PIECE_TERMS = 14, SERIES_TERMS = 16, STRETCH = 512, STEPS = 501, TABULATED_PIECES = 3 };
enum { STATES = 1 << 14, IMPACTS = 1 << 11, PIECES = 1 << 14, SEGMENTS = 1 << 12, LEFT = 8, A_1 = 7, GRID_NS = 10000000 };
static const double PI = 3.141592653589793, TWO_PI = 6.283185307179586, SAME_S = 1e-9, SAME_INSTANT_S = 1e-12;

typedef struct { /* as snapshot.py writes it */
    char version[32];
    int64_t channels, modes, clock_period, clock_tick, most_per_tick, ramp_ticks;
    double tick_s, longest_s, joined_s, frequency_hz, lowest_hz, highest_hz, highest_amplitude, start, mass_kg, shortest_gap_m, longest_gap_m;
    int64_t quantity[IR_RIG_CHANNELS];
    char name[IR_RIG_CHANNELS][32], at_point[160], at_stages[160];
} setup;

typedef struct { /* all that goes on from tick to tick, but channels and modes */
    ir_state states[2];
    ir_flight flight;
    ir_contact_step step;
    ir_ledger ledger;
    ir_counts counts; /* of what is kept of the last call */
    int64_t tick, anchor_tick, ramp_first, ramp_ticks, impacts, ns; /* ns: time in the tick that `feed` has reached */
    int64_t first_tick, ticks, segments, open; /* of that, a tick that has only begun among them; open: some of it still has to be measured */
    double frequency_hz, anchor_phase, ramp_initial, ramp_target, half_gap, next_gap, begin, measured; /* of the kept motion: where pieces begin, up to where they are measured [s] */
    double left[IR_RIG_CHANNELS][LEFT];
    uint8_t left_clipped[IR_RIG_CHANNELS][LEFT];
} motion;

struct ir_rig {
    setup is;
    ir_parameters parameters;
    ir_system systems[2];
    ir_table table;
    motion now, fresh;
    ir_channel channels[IR_RIG_CHANNELS], fresh_channels[IR_RIG_CHANNELS];
    ir_sensor_mode *modes, *fresh_modes;
    void *at_point, *at_stages;
    int64_t room, layout[2 + IR_RIG_CHANNELS];
    ir_segment segments[SEGMENTS];
    ir_state history[STATES], steps[STEPS];
    ir_impact impacts[IMPACTS];
    int64_t first_state[SEGMENTS + 1], first_segment[IR_RIG_TICKS + 1], first_piece[IR_RIG_TICKS + 1];
    ir_flight flight;
    ir_contact_step step;
    double polynomials[IR_RIG_QUANTITIES * PIECE_TERMS], quantities[IR_RIG_QUANTITIES], powers[2 * PIECE_TERMS];
    double pulse[3], node_offset[NODES], node_values[IR_RIG_QUANTITIES * NODES];
    int64_t pulse_row[1], node_tick[NODES];
    int64_t break_tick[TABULATED_PIECES * STATES + 2], piece_tick[PIECES];
    double break_offset[TABULATED_PIECES * STATES + 2], start[PIECES], end[PIECES];
    double white[STRETCH], series[3 * SERIES_TERMS], first_and_spacing[2];
    double *coefficients, *kicks, *values, *scans;
    uint8_t *clipped;
};

#define MODEL(r) &(r)->parameters, 1, (r)->systems, 2, &(r)->table, 1, (r)->at_point, (r)->at_stages
#define MOVED(r) (r)->segments, (r)->now.segments, (r)->now.first_tick, (r)->first_segment, (r)->now.ticks + 1, (r)->history, \
    (r)->now.counts.states + 1, (r)->first_state, (r)->now.segments + 1
#define SAMPLING(r) &(r)->flight, 1, &(r)->step, 1, (r)->steps, STEPS, (r)->polynomials, IR_RIG_QUANTITIES, PIECE_TERMS, (r)->quantities, \
    IR_RIG_QUANTITIES, (r)->powers, 2, PIECE_TERMS, (r)->pulse, 3, (r)->pulse_row, 1, (r)->node_tick, NODES, (r)->node_offset, NODES, \
    (r)->node_values, IR_RIG_QUANTITIES, NODES
#define BUFFERS(r) (r)->values, (r)->is.channels, (r)->room, (r)->clipped, (r)->is.channels, (r)->room, (r)->white, STRETCH, (r)->series, 3, \
    SERIES_TERMS, (r)->first_and_spacing, 2

static int take(const char **from, size_t *left, void *to, size_t size)
{
    if (*left < size) return 0;
    memcpy(to, *from, size);
    *from += size, *left -= size;
    return 1;
}

/* Put the sphere at its start; y stays. */
static void place(ir_rig *r)
{
    ir_state *s = r->now.states;
    double y[5];
    memcpy(y, s->y, sizeof y);
    if (s->phase == IR_CONTACT) {
        y[0] -= r->parameters.share * s->side * s->w * s->w;
        y[1] -= r->parameters.share * s->side * s->speed;
    }
    memset(s, 0, sizeof r->now.states);
    memset(&r->now.step, 0, sizeof r->now.step), memset(&r->now.ledger, 0, sizeof r->now.ledger);
    memcpy(s->y, y, sizeof y);
    s->d = r->is.start * r->parameters.half_gap;
    s->phase = r->parameters.friction_acceleration > 0.0 && r->parameters.sphere_present ? IR_ATTACHED : IR_FREE;
}

ir_rig *ir_rig_new(const void *snapshot, size_t bytes)
{
    const char *at = snapshot;
    ir_rig *r = calloc(1, sizeof *r);
    if (!r) return 0;
    if (!take(&at, &bytes, &r->is, sizeof r->is) || strcmp(r->is.version, impact_rig_version())
        || r->is.channels < 1 || r->is.channels > IR_RIG_CHANNELS || r->is.modes < 0 || r->is.modes > 1000) goto refused;
    int64_t n = r->is.channels;
    r->room = IR_RIG_TICKS * r->is.most_per_tick + 4;
    r->modes = calloc((size_t)r->is.modes + 1, sizeof *r->modes), r->fresh_modes = calloc((size_t)r->is.modes + 1, sizeof *r->modes);
    r->coefficients = calloc((size_t)n * PIECES * NODES, 8), r->kicks = calloc((size_t)n * PIECES, 8);
    r->values = calloc((size_t)(n * r->room), 8), r->clipped = calloc((size_t)(n * r->room), 1);
    r->scans = calloc((size_t)((n + 1) * r->room), 8);
    if (!r->modes || !r->fresh_modes || !r->coefficients || !r->kicks || !r->values || !r->clipped || !r->scans) goto refused;
    if (!take(&at, &bytes, &r->parameters, sizeof r->parameters) || !take(&at, &bytes, r->systems, sizeof r->systems)
        || !take(&at, &bytes, &r->table, sizeof r->table) || !take(&at, &bytes, r->fresh_channels, (size_t)n * sizeof *r->channels)
        || !take(&at, &bytes, r->fresh_modes, (size_t)r->is.modes * sizeof *r->modes) || bytes) goto refused;
    r->at_point = impact_rig_address(r->is.at_point), r->at_stages = impact_rig_address(r->is.at_stages);
    if (!r->at_point || !r->at_stages) goto refused;
    r->layout[0] = 8 * (n + 1);
    for (int64_t j = 0; j < n; j++) r->layout[2 + j] = 8 * (j + 1);
    r->fresh.frequency_hz = r->is.frequency_hz, r->fresh.ramp_ticks = r->is.ramp_ticks;
    ir_rig_reset(r);
    return r;
refused:
    ir_rig_free(r);
    return 0;
}

void ir_rig_free(ir_rig *r)
{
    if (!r) return;
    free(r->modes), free(r->fresh_modes), free(r->coefficients), free(r->kicks), free(r->values), free(r->clipped), free(r->scans);
    free(r);
}

void ir_rig_reset(ir_rig *r)
{
    r->now = r->fresh;
    r->now.half_gap = r->parameters.half_gap;
    memcpy(r->channels, r->fresh_channels, sizeof r->channels);
    memcpy(r->modes, r->fresh_modes, (size_t)r->is.modes * sizeof *r->modes);
    place(r);
}

static double amplitude_at(const motion *m, int64_t tick)
{
    double progress = tick < m->ramp_first + m->ramp_ticks ? (double)(tick - m->ramp_first) / (double)m->ramp_ticks : 1.0;
    return m->ramp_initial + (m->ramp_target - m->ramp_initial) * progress;
}

/* `FunctionGenerator.set_frequency` and `set_amplitude`, of what has changed. */
int ir_rig_command(ir_rig *r, double frequency_hz, double amplitude)
{
    motion *m = &r->now;
    if (!(frequency_hz >= r->is.lowest_hz && frequency_hz <= r->is.highest_hz && amplitude >= 0.0 && amplitude <= r->is.highest_amplitude))
        return IR_RIG_REFUSED;
    if (frequency_hz != m->frequency_hz) {
        double cycles = m->frequency_hz * r->is.tick_s * (double)(m->tick - m->anchor_tick);
        m->anchor_phase = fmod(m->anchor_phase + TWO_PI * fmod(cycles, 1.0), TWO_PI);
        m->anchor_tick = m->tick, m->frequency_hz = frequency_hz;
    }
    if (amplitude != m->ramp_target) {
        m->ramp_initial = r->is.ramp_ticks ? amplitude_at(m, m->tick) : amplitude;
        m->ramp_target = amplitude, m->ramp_first = m->tick, m->ramp_ticks = r->is.ramp_ticks;
    }
    return IR_RIG_OK;
}

int ir_rig_set_gap(ir_rig *r, double gap_m)
{
    if (!(gap_m >= r->is.shortest_gap_m && gap_m <= r->is.longest_gap_m)) return IR_RIG_REFUSED;
    r->now.next_gap = 0.0;
    if (r->now.ns) { /* with the next tick */
        r->now.next_gap = gap_m;
        return IR_RIG_OK;
    }
    r->now.half_gap = r->parameters.half_gap = gap_m / 2.0;
    place(r);
    return IR_RIG_OK;
}

/* Forget what is kept of the last call. */
static void forget(motion *m)
{
    memset(&m->counts, 0, sizeof m->counts);
    m->ticks = m->segments = m->open = 0;
}

/* Move through the segments from `first` on. */
static int move(ir_rig *r, int64_t first)
{
    motion *m = &r->now;
    int64_t result[2], impacts = m->counts.impacts;
    if (ir_physics_event_loop_run(MODEL(r), r->segments, m->segments, m->first_tick, first, m->states, 2, &m->flight, 1, &m->step, 1, &m->ledger, 1,
            &m->counts, 1, r->history, STATES, r->impacts, IMPACTS, r->first_state, m->segments + 1, r->first_segment, m->ticks + 1, 0, result)) return IR_RIG_UNSOLVED;
    m->impacts += m->counts.impacts - impacts;
    return result[0] == 0 ? IR_RIG_OK : result[0] == IR_NEED_ROOM ? IR_RIG_NO_ROOM : IR_RIG_UNSOLVED;
}

/* Cut the motion into pieces, where it begins and ends, too [s]; return their number, or an error. Those before do not count. */
static int64_t cut(ir_rig *r, double end)
{
    const motion *m = &r->now;
    int64_t breaks, pieces, given = m->begin > 0.0;
    if (given) r->break_tick[0] = m->tick, r->break_offset[0] = m->begin;
    if (ir_physics_sampling_refine(MOVED(r), r->break_tick + given, TABULATED_PIECES * STATES, r->break_offset + given, TABULATED_PIECES * STATES, &breaks)) return IR_RIG_UNSOLVED;
    breaks += given;
    if (end < r->is.tick_s) r->break_tick[breaks] = m->tick, r->break_offset[breaks++] = end;
    if (m->ticks * ((int64_t)ceil(r->is.tick_s / r->is.longest_s) + 1) + 2 * breaks > PIECES) return IR_RIG_NO_ROOM;
    if (ir_instruments_pieces__cut(r->break_tick, breaks, r->break_offset, breaks, m->first_tick, r->is.tick_s, r->is.longest_s, r->is.joined_s,
            r->first_piece, m->ticks + 1, r->start, PIECES, r->end, PIECES, r->piece_tick, PIECES, r->is.tick_s, &pieces)) return IR_RIG_UNSOLVED;
    return pieces;
}

/* What impacts that take no time add to the structure's velocity at the start of pieces `from` … `to` [m/s]: `chain._kicks`. */
static int64_t kick(ir_rig *r, int64_t from, int64_t to)
{
    const motion *m = &r->now;
    int64_t found = 0, pieces = to - from;
    for (int64_t i = 0; i < m->counts.impacts; i++) found += r->impacts[i].duration == 0.0;
    if (!found) return 0;
    memset(r->kicks, 0, (size_t)(r->is.channels * pieces) * 8);
    for (int64_t i = 0; i < m->counts.impacts; i++) {
        const ir_impact *blow = r->impacts + i;
        int64_t tick = blow->tick - m->first_tick;
        if (blow->duration != 0.0 || tick < 0 || tick >= m->ticks) continue;
        int64_t piece = r->first_piece[tick];
        while (piece + 1 < r->first_piece[tick + 1] && r->start[piece + 1] <= blow->offset + SAME_S) piece++;
        if (piece < from || piece >= to) continue;
        for (int64_t j = 0; j < r->is.channels; j++)
            if (r->is.quantity[j] == A_1) r->kicks[j * pieces + piece - from] += (double)blow->wall * blow->impulse / r->is.mass_kg;
    }
    return pieces;
}

/* Let the instruments measure pieces `first` … `to`; of a contact's pieces the ones from `from` on decide them, too. */
static int measure(ir_rig *r, int64_t from, int64_t first, int64_t to)
{
    const motion *m = &r->now;
    int64_t n = r->is.channels, pieces = to - from, result, kicked;
    if (ir_physics_sampling_fit(MODEL(r), MOVED(r), r->is.quantity, n, r->piece_tick + from, pieces, r->start + from, pieces, r->end + from, pieces,
            r->coefficients, n, pieces, NODES, SAMPLING(r), &result) || !result) return IR_RIG_UNSOLVED;
    kicked = kick(r, from, to);
    if (m->ticks == 1) r->first_piece[0] = first - from, r->first_piece[1] = pieces;
    return ir_instruments_channel_respond(r->modes, r->is.modes, r->channels, n, r->is.clock_period, r->is.clock_tick, r->first_piece, m->ticks + 1,
            r->start + from, pieces, r->end + from, pieces, r->piece_tick + from, pieces, r->is.tick_s, r->coefficients, n, pieces, NODES,
            r->kicks, n, kicked, BUFFERS(r)) || ir_instruments_channel_digitise(r->channels, n, BUFFERS(r)) ? IR_RIG_UNSOLVED : IR_RIG_OK;
}

/* Make scans of what all channels have finished; return their number, or an error. */
static int64_t take_scans(ir_rig *r, int64_t ticks)
{
    int64_t n = r->is.channels, result;
    if (ir_instruments_conversion_take_rows(r->channels, n, (uint64_t *)r->values, n, r->room, r->clipped, n, r->room, (uint8_t *)r->scans,
            8 * (n + 1) * (ticks * r->is.most_per_tick + 4), r->layout, 2 + n, &result)) return IR_RIG_UNSOLVED;
    return result;
}

static int64_t failed(ir_rig *r, int64_t error)
{
    forget(&r->now); /* a call that fails leaves no motion to ask for */
    return error;
}

int64_t ir_rig_advance(ir_rig *r, int64_t ticks)
{
    motion *m = &r->now;
    int64_t result, pieces;
    if (ticks < 1 || ticks > IR_RIG_TICKS || m->ns) return IR_RIG_REFUSED;
    forget(m), m->begin = 0.0;
    if (ir_physics_function_generator_fill_sine(r->segments, ticks, m->tick, m->ramp_first, m->ramp_initial, m->ramp_target, m->ramp_ticks,
            r->is.tick_s, m->frequency_hz, m->tick - m->anchor_tick, m->anchor_phase)) return IR_RIG_UNSOLVED;
    m->first_tick = m->tick, m->ticks = m->segments = ticks;
    if ((result = move(r, 0)) < 0 || (pieces = result = cut(r, r->is.tick_s)) < 0 || (result = measure(r, 0, 0, pieces)) < 0) return failed(r, result);
    m->tick += ticks;
    return take_scans(r, ticks);
}

static double in_tick(const ir_rig *r, int64_t ns) { return (double)ns / GRID_NS * r->is.tick_s; }

/* A part of `feed` within one tick. Pieces that a later break could lengthen wait for the next call. */
static int64_t feed(ir_rig *r, int64_t ns, double level, double growth)
{
    motion *m = &r->now;
    if (!m->ns) m->measured = 0.0;
    if (!m->open) {
        forget(m);
        if (m->next_gap) ir_rig_set_gap(r, m->next_gap);
        m->begin = m->measured, m->first_tick = m->tick, m->ticks = 1, m->counts.ticks = m->ns > 0, r->first_segment[0] = 0;
    }
    if (m->segments == SEGMENTS) return IR_RIG_NO_ROOM;
    r->segments[m->segments++] = (ir_segment){.duration = in_tick(r, ns), .phase = PI / 2.0, .amplitude = level, .growth = growth, .begin = in_tick(r, m->ns)};
    int64_t status = move(r, m->segments - 1);
    if (status < 0) return status;
    m->ns += ns;
    int whole = m->ns == GRID_NS;
    double end = in_tick(r, m->ns);
    int64_t pieces = cut(r, end), from = 0, first, to, s = m->segments - 1;
    if (pieces < 0) return pieces;
    while (s && r->segments[s].begin > m->measured) s--;
    while (from < pieces && r->start[from] < r->segments[s].begin) from++;
    for (first = from; first < pieces && r->start[first] < m->measured;) first++;
    for (to = first; to < pieces && (whole || (r->end[to] <= end + SAME_INSTANT_S && end - r->start[to] > r->is.joined_s));) to++;
    if (to > first) {
        if ((status = measure(r, from, first, to)) < 0) return status;
        m->measured = r->end[to - 1];
        if (!whole) for (int64_t j = 0; j < r->is.channels; j++) r->channels[j].due += r->is.clock_tick;
    }
    m->open = !whole && m->measured < end;
    for (int64_t i = 0; i < m->counts.impacts; i++) m->open |= !whole && r->impacts[i].duration == 0.0 && r->impacts[i].offset + SAME_S >= end;
    if (whole) m->tick++, m->ns = 0;
    return take_scans(r, 1);
}

int64_t ir_rig_feed(ir_rig *r, int64_t until_ns, double from, double to)
{
    motion *m = &r->now;
    int64_t since = ir_rig_time_ns(r), scans = 0, length;
    if (until_ns <= since || !(fabs(from) <= r->is.highest_amplitude && fabs(to) <= r->is.highest_amplitude)) return IR_RIG_REFUSED;
    double rise = to - from, whole = (double)(until_ns - since);
    for (int64_t at = since; at < until_ns; at += length) {
        length = until_ns - at < GRID_NS - m->ns ? until_ns - at : GRID_NS - m->ns;
        int64_t found = feed(r, length, from + rise * ((double)(at - since) / whole), rise / (whole / GRID_NS * r->is.tick_s));
        if (found < 0) return failed(r, found);
        if (found) scans = found;
    }
    return scans;
}

const double *ir_rig_scans(const ir_rig *r) { return r->scans; }
int64_t ir_rig_channels(const ir_rig *r) { return r->is.channels; }
const char *ir_rig_channel_name(const ir_rig *r, int64_t channel) { return r->is.name[channel]; }
int64_t ir_rig_tick(const ir_rig *r) { return r->now.tick; }
int64_t ir_rig_time_ns(const ir_rig *r) { return r->now.tick * GRID_NS + r->now.ns; }
double ir_rig_tick_s(const ir_rig *r) { return r->is.tick_s; }
double ir_rig_gap(const ir_rig *r) { return 2.0 * r->now.half_gap; }
int64_t ir_rig_impacts(const ir_rig *r) { return r->now.impacts; }

int ir_rig_sample(ir_rig *r, int64_t tick, double offset_s, double out[IR_RIG_QUANTITIES])
{
    static const int64_t all[IR_RIG_QUANTITIES] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};
    const motion *m = &r->now;
    int64_t at = m->first_tick + tick, result;
    if (m->ticks == 0 && tick == 0) { /* at rest, or just restored: where all stands */
        const ir_state *s = m->states;
        memset(out, 0, IR_RIG_QUANTITIES * sizeof *out);
        out[0] = s->y[2], out[1] = s->y[0], out[2] = s->y[0] + s->d, out[3] = s->y[3], out[4] = s->y[1], out[5] = s->y[1] + s->d_rate;
        return IR_RIG_OK;
    }
    if (tick < 0 || tick >= m->ticks) return IR_RIG_REFUSED;
    if (ir_physics_sampling_sample(MODEL(r), MOVED(r), SAMPLING(r), (int64_t *)all, IR_RIG_QUANTITIES, &at, 1, &offset_s, 1, out,
            IR_RIG_QUANTITIES, 1, &result) || !result) return IR_RIG_UNSOLVED;
    return IR_RIG_OK;
}

int ir_rig_latest(ir_rig *r, double out[IR_RIG_QUANTITIES])
{
    const motion *m = &r->now;
    return ir_rig_sample(r, m->ticks ? m->ticks - 1 : 0, m->ns ? in_tick(r, m->ns) : r->is.tick_s, out);
}

int ir_rig_contact(const ir_rig *r, int64_t number, double out[6])
{
    if (r->now.ticks == 0 || number < 0 || number >= r->now.counts.impacts) return 0;
    const ir_impact *one = r->impacts + number;
    out[0] = (double)one->tick, out[1] = one->offset, out[2] = one->wall;
    out[3] = one->approach_speed, out[4] = one->separation_speed, out[5] = one->peak_force;
    return 1;
}

/* Copy the parts of a state to `to` (`save`) or from `from`; return their size. Of the motion only what still waits to be measured. */
static size_t copy_state(ir_rig *r, char *to, const char *from)
{
    const motion *m = &r->now;
    size_t size = 0, open = m->open != 0;
    const struct { void *at; size_t bytes; } parts[] = {
        {&r->now, sizeof r->now}, {r->channels, sizeof r->channels}, {r->modes, (size_t)r->is.modes * sizeof *r->modes},
        {r->segments, open * (size_t)m->segments * sizeof *r->segments}, {r->first_state, open * (size_t)(m->segments + 1) * 8},
        {r->history, open * (size_t)(m->counts.states + 1) * sizeof *r->history}, {r->impacts, open * (size_t)m->counts.impacts * sizeof *r->impacts},
    };
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
        if (to) memcpy(to + size, parts[i].at, parts[i].bytes);
        if (from) memcpy(parts[i].at, from + size, parts[i].bytes);
        size += parts[i].bytes;
    }
    return size;
}

size_t ir_rig_state_size(const ir_rig *r) { return copy_state((ir_rig *)r, 0, 0); }

/* Readings that wait for other channels are part of the state; they stand at the beginning of the buffers. */
void ir_rig_save(ir_rig *r, void *state)
{
    for (int64_t j = 0; j < r->is.channels; j++) {
        memcpy(r->now.left[j], r->values + j * r->room, sizeof r->now.left[j]);
        memcpy(r->now.left_clipped[j], r->clipped + j * r->room, sizeof r->now.left_clipped[j]);
    }
    copy_state(r, state, 0);
}

void ir_rig_restore(ir_rig *r, const void *state)
{
    memcpy(&r->now, state, sizeof r->now); /* it tells how large the other parts are */
    copy_state(r, 0, state);
    for (int64_t j = 0; j < r->is.channels; j++) {
        memcpy(r->values + j * r->room, r->now.left[j], sizeof r->now.left[j]);
        memcpy(r->clipped + j * r->room, r->now.left_clipped[j], sizeof r->now.left_clipped[j]);
    }
    r->parameters.half_gap = r->now.half_gap;
    if (!r->now.open) forget(&r->now);
    r->first_segment[0] = 0, r->first_segment[1] = r->now.segments;
}
