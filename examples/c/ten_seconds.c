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

/* Ten seconds of the rig without Python: cc ten_seconds.c impact_rig.o -lm; the file is written by write_model.py.
 */
#include "impact_rig.h"
#include <stdio.h>

enum { SEGMENTS = 1000, STATES = 1 << 17, IMPACTS = 1 << 12 };
static ir_parameters parameters[1];
static ir_system systems[2];
static ir_table table[1];
static ir_state states[2], history[STATES];
static ir_segment segments[SEGMENTS];
static ir_flight flight[1];
static ir_contact_step step[1];
static ir_ledger ledger[1];
static ir_counts counts[1];
static ir_impact impacts[IMPACTS];
static int64_t first_state[SEGMENTS + 1], first_segment[SEGMENTS + 1], result[2];
#define READ(what) (fread(what, sizeof what, 1, file) == 1)

int main(int count, char **words)
{
    FILE *file = count == 2 ? fopen(words[1], "rb") : 0;
    if (!file || !READ(parameters) || !READ(systems) || !READ(table) || !READ(states) || !READ(segments)) return 1;
    void *one = impact_rig_address("force.impact_rig.physics.contact.hunt_crossley._hertz_damped.at_point");
    void *at_stages = impact_rig_address("force.impact_rig.physics.contact.hunt_crossley._hertz_damped.at_stages");
    int32_t status = ir_physics_event_loop_run(
        parameters, 1, systems, 2, table, 1, one, at_stages, segments, SEGMENTS, 0, 0, states, 2, flight, 1, step, 1,
        ledger, 1, counts, 1, history, STATES, impacts, IMPACTS, first_state, SEGMENTS + 1, first_segment, SEGMENTS + 1, 0, result);
    printf("%d %lld %lld %a\n", (int)status, (long long)result[0], (long long)counts->impacts, states[0].y[0]);
    for (int64_t i = 0; i < counts->impacts; i++) printf("%lld %a %a\n", (long long)impacts[i].tick, impacts[i].offset, impacts[i].impulse);
    return status;
}
