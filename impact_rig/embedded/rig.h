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
/* A rig without Python: the sine drive, the motion, the instruments. It runs the kernels in the order in which
 * `rig.core` runs them, so readings and motion have the bits of the rig in Python. snapshot.py writes what it is made of.
 */
#ifndef IR_RIG_H
#define IR_RIG_H
#include <stddef.h>
#include <stdint.h>

enum { IR_RIG_QUANTITIES = 12, IR_RIG_CHANNELS = 8, IR_RIG_TICKS = 25 };
enum { IR_RIG_OK = 0, IR_RIG_REFUSED = -1, IR_RIG_UNSOLVED = -2, IR_RIG_NO_ROOM = -3 }; /* errors */
typedef struct ir_rig ir_rig;

ir_rig *ir_rig_new(const void *snapshot, size_t bytes); /* 0: not a snapshot of this version, or no memory */
void ir_rig_free(ir_rig *rig);
void ir_rig_reset(ir_rig *rig); /* at rest, as when it was new; the gap stays */

/* Commands act from the next tick of 10 ms on; a value out of the rig's limits gives REFUSED and changes nothing. An
 * unchanged frequency or amplitude is no command. A new gap puts the sphere at its start. */
int ir_rig_command(ir_rig *rig, double frequency_hz, double amplitude);
int ir_rig_set_gap(ir_rig *rig, double gap_m);

/* Simulate 1 … IR_RIG_TICKS ticks; return how many scans are complete, or an error. */
int64_t ir_rig_advance(ir_rig *rig, int64_t ticks);
/* Simulate with samples instead of commands: the drive goes on a straight line `from` … `to` until a time of the scan clock. In the middle
 * of a tick the next call must feed, too, and a new gap waits for the next tick. Return how many scans of the last 10 ms are complete, or an error. */
int64_t ir_rig_feed(ir_rig *rig, int64_t until_ns, double from, double to);
/* Those scans: a word of status bits and a reading [SI] of each channel, 1 + channels numbers a row. */
const double *ir_rig_scans(const ir_rig *rig);
int64_t ir_rig_channels(const ir_rig *rig);
const char *ir_rig_channel_name(const ir_rig *rig, int64_t channel);
/* The motion at `offset_s` in a tick of the last call, `tick` counted from 0 in that call: x_b x_1 x_2 v_b v_1 v_2 a_b a_1 a_2 current
 * force_left force_right [SI]. Before the first call, tick 0 gives the state at rest. Other ticks give REFUSED. */
int ir_rig_sample(ir_rig *rig, int64_t tick, double offset_s, double out[IR_RIG_QUANTITIES]);
int ir_rig_latest(ir_rig *rig, double out[IR_RIG_QUANTITIES]); /* at the end of the last call */

/* Contact `number` that ended in the last call: tick, offset [s], wall, approach and separation [m/s], peak force [N]; 0: no such. */
int ir_rig_contact(const ir_rig *rig, int64_t number, double out[6]);

int64_t ir_rig_tick(const ir_rig *rig);
int64_t ir_rig_time_ns(const ir_rig *rig); /* since the reset, of the scan clock */
double ir_rig_tick_s(const ir_rig *rig);
double ir_rig_gap(const ir_rig *rig);
int64_t ir_rig_impacts(const ir_rig *rig); /* contacts that have ended since the reset */
/* Everything that decides the future, for as many bytes; how many differs from state to state. */
size_t ir_rig_state_size(const ir_rig *rig);
void ir_rig_save(ir_rig *rig, void *state);
void ir_rig_restore(ir_rig *rig, const void *state);
#endif
