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
/* A rig without Python: drive, motion and instruments. It runs the kernels in the order in which `rig.core` runs them, so
 * readings and motion have the same bits as those of the rig in Python. snapshot.py writes the snapshot that it starts from.
 */
#ifndef IR_RIG_H
#define IR_RIG_H
#include <stddef.h>
#include <stdint.h>

enum { IR_RIG_QUANTITIES = 12, IR_RIG_CHANNELS = 8, IR_RIG_TICKS = 25 };
enum { IR_RIG_OK = 0, IR_RIG_REFUSED = -1, IR_RIG_UNSOLVED = -2, IR_RIG_NO_ROOM = -3 }; /* errors */
typedef struct ir_rig ir_rig;

ir_rig *ir_rig_new(const void *snapshot, size_t bytes); /* a rig at rest; 0 if this is no snapshot of this version, or without memory */
void ir_rig_free(ir_rig *rig);
void ir_rig_reset(ir_rig *rig); /* start again at rest, at tick 0; the gap stays */

/* Commands act from the next tick (10 ms) on. A value beyond the rig's limits returns IR_RIG_REFUSED and changes nothing. An
 * unchanged frequency or amplitude counts as no command. A new gap puts the sphere at its start. */
int ir_rig_command(ir_rig *rig, double frequency_hz, double amplitude);
int ir_rig_set_gap(ir_rig *rig, double gap_m);

/* Simulate 1 … IR_RIG_TICKS ticks; return the number of scans that this call completed, or an error. */
int64_t ir_rig_advance(ir_rig *rig, int64_t ticks);
/* Simulate with samples instead of commands: the drive follows a straight line from `from` to `to` until the time `until_ns` of the scan
 * clock. If that is within a tick, the next call must be this function, too, and a new gap waits for the next tick. Return the number of
 * completed scans of the last 10 ms, or an error. */
int64_t ir_rig_feed(ir_rig *rig, int64_t until_ns, double from, double to);
/* The scans that the last call completed. A row has 1 + channels elements of 8 bytes: a word of status bits, then a reading [SI] per channel. */
const double *ir_rig_scans(const ir_rig *rig);
int64_t ir_rig_channels(const ir_rig *rig);
const char *ir_rig_channel_name(const ir_rig *rig, int64_t channel);
/* The motion at `offset_s` after the begin of a tick of the last call, `tick` counted from 0 in that call: x_b x_1 x_2 v_b v_1 v_2 a_b a_1
 * a_2 current force_left force_right [SI]. Before the first call, tick 0 gives the state at rest. Other ticks return IR_RIG_REFUSED. */
int ir_rig_sample(ir_rig *rig, int64_t tick, double offset_s, double out[IR_RIG_QUANTITIES]);
int ir_rig_latest(ir_rig *rig, double out[IR_RIG_QUANTITIES]); /* the motion at the end of the last call */

/* Contact `number`, counted from 0, of those that ended in the last call: tick and offset [s] of its start, wall (-1 left, 1 right),
 * approach and separation speed [m/s], peak force [N]. Return 0 if there is no such contact. */
int ir_rig_contact(const ir_rig *rig, int64_t number, double out[6]);

int64_t ir_rig_tick(const ir_rig *rig);    /* number of ticks simulated since the start or reset */
int64_t ir_rig_time_ns(const ir_rig *rig); /* time of the scan clock since the start or reset */
double ir_rig_tick_s(const ir_rig *rig);   /* duration of a tick in the time of the motion [s] */
double ir_rig_gap(const ir_rig *rig);      /* total gap [m] */
int64_t ir_rig_impacts(const ir_rig *rig); /* number of contacts that have ended since the start or reset */
/* Save and restore everything that decides the future of a rig. A state has ir_rig_state_size bytes, a number that changes from state to
 * state. A rig can restore states of rigs from the same snapshot. */
size_t ir_rig_state_size(const ir_rig *rig);
void ir_rig_save(ir_rig *rig, void *state);
void ir_rig_restore(ir_rig *rig, const void *state);
#endif
