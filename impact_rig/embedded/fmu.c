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
/* A rig as a unit of FMI 2.0 and 3.0 co-simulation. fmu.py compiles this with rig.c, the kernels, and `snapshot.h`: the
 * bytes of the rig's snapshot, its token, and what drives it. The prototypes are those of the standards, https://fmi-standard.org.
 *
 * Value references: 0 time; inputs 1 frequency, 2 current (amplitude or sample); parameter 3 gap; outputs 10 … motion, 30 impacts, 40 … readings.
 */
#include "rig.h"
#include "snapshot.h"
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { OK, WARNING, DISCARD, ERROR };
enum { TIME, FREQUENCY, CURRENT, GAP, MOTION = 10, IMPACTS = 30, READINGS = 40 };
enum { SINE, ZERO_ORDER, FIRST_ORDER }; /* SNAPSHOT_DRIVE: sine, or samples that are held or joined by lines */
#define TICK 0.01 /* of the scan clock, by which time counts */
#define SAME 1e-6 /* ticks within which a step counts as whole ticks */
#define SAME_NS 0.01 /* a time counts as the whole ns before it, or so little after it */

typedef void (*log_3)(void *environment, int status, const char *category, const char *message);
typedef struct { /* of FMI 2.0 */
    void (*log)(void *environment, const char *name, int status, const char *category, const char *message, ...);
    void *allocate, *free, *step_finished, *environment;
} callbacks;
typedef struct { /* what a state keeps besides the rig's own; bytes of both */
    size_t size;
    double frequency, current, previous, gap, motion[IR_RIG_QUANTITIES], reading[IR_RIG_CHANNELS];
} values;
typedef struct {
    ir_rig *rig;
    values now, fresh;
    char name[64];
    log_3 log_3;
    const callbacks *callbacks;
    void *environment;
} unit;

__attribute__((format(printf, 3, 4))) static int tell(const unit *u, int status, const char *format, ...)
{
    char message[256];
    va_list given;
    va_start(given, format);
    vsnprintf(message, sizeof message, format, given);
    va_end(given);
    if (u->log_3) u->log_3(u->environment, status, "logStatusError", message);
    if (u->callbacks && u->callbacks->log) u->callbacks->log(u->callbacks->environment, u->name, status, "logStatusError", message);
    return status;
}

static unit *new_unit(const char *name, const char *token)
{
    unit *u = token && !strcmp(token, SNAPSHOT_TOKEN) ? calloc(1, sizeof *u) : 0;
    if (!u) return 0;
    snprintf(u->name, sizeof u->name, "%s", name ? name : "");
    u->rig = ir_rig_new(snapshot, sizeof snapshot);
    if (!u->rig) {
        free(u);
        return 0;
    }
    u->now.frequency = SNAPSHOT_FREQUENCY, u->now.gap = ir_rig_gap(u->rig);
    ir_rig_latest(u->rig, u->now.motion);
    u->fresh = u->now;
    return u;
}

static void free_unit(unit *u)
{
    if (!u) return;
    ir_rig_free(u->rig);
    free(u);
}

static int reset(unit *u)
{
    ir_rig_reset(u->rig);
    u->now = u->fresh;
    return ir_rig_set_gap(u->rig, u->now.gap) ? ERROR : OK;
}

static int get(const unit *u, const unsigned *reference, size_t count, double *to)
{
    for (size_t i = 0; i < count; i++) {
        unsigned r = reference[i];
        if (r == TIME) to[i] = (double)ir_rig_time_ns(u->rig) / 1e9;
        else if (r == FREQUENCY && SNAPSHOT_DRIVE == SINE) to[i] = u->now.frequency;
        else if (r == CURRENT) to[i] = u->now.current;
        else if (r == GAP) to[i] = u->now.gap;
        else if (r >= MOTION && r < MOTION + IR_RIG_QUANTITIES) to[i] = u->now.motion[r - MOTION];
        else if (r == IMPACTS) to[i] = (double)ir_rig_impacts(u->rig);
        else if (r >= READINGS && r < READINGS + ir_rig_channels(u->rig)) to[i] = u->now.reading[r - READINGS];
        else return tell(u, ERROR, "no variable has the value reference %u", r);
    }
    return OK;
}

/* A new gap acts with the next tick and puts the sphere at its start; frequency and current act in the next step. */
static int set(unit *u, const unsigned *reference, size_t count, const double *from)
{
    for (size_t i = 0; i < count; i++) {
        if (reference[i] == FREQUENCY && SNAPSHOT_DRIVE == SINE) u->now.frequency = from[i];
        else if (reference[i] == CURRENT) u->now.current = from[i];
        else if (reference[i] == GAP) {
            if (from[i] == u->now.gap) continue;
            if (ir_rig_set_gap(u->rig, from[i])) return tell(u, ERROR, SNAPSHOT_GAPS ", got %g m", from[i]);
            u->now.gap = from[i];
            if (ir_rig_time_ns(u->rig) == 0) ir_rig_latest(u->rig, u->now.motion);
        } else return tell(u, ERROR, "the variable with the value reference %u cannot be set: it is neither an input nor a parameter", reference[i]);
    }
    return OK;
}

static void keep_scan(unit *u, int64_t scans)
{
    int64_t channels = ir_rig_channels(u->rig);
    if (scans > 0) memcpy(u->now.reading, ir_rig_scans(u->rig) + (scans - 1) * (channels + 1) + 1, (size_t)channels * sizeof(double));
}

static int unsolved(const unit *u, int64_t error)
{
    return tell(u, ERROR, "the motion cannot be simulated: %s", error == IR_RIG_NO_ROOM ? "too many contacts and steps" : "a step of a contact has no solution, or makes no progress");
}

static int step(unit *u, double from, double length)
{
    double end = (from + length) / TICK, whole = nearbyint(end);
    int64_t scans = 0;
    if (SNAPSHOT_DRIVE != SINE) {
        int64_t until = (int64_t)floor((from + length) * 1e9 + SAME_NS);
        if (until <= ir_rig_time_ns(u->rig)) return tell(u, DISCARD, "a step must last at least 1 ns, got %g s", length);
        scans = ir_rig_feed(u->rig, until, SNAPSHOT_DRIVE == FIRST_ORDER ? u->now.previous : u->now.current, u->now.current);
        if (scans == IR_RIG_REFUSED) return tell(u, ERROR, SNAPSHOT_INPUTS ", got %g to %g", SNAPSHOT_DRIVE == FIRST_ORDER ? u->now.previous : u->now.current, u->now.current);
        if (scans < 0) return unsolved(u, scans);
        u->now.previous = u->now.current;
        keep_scan(u, scans);
    } else {
        int64_t ticks = (int64_t)whole - ir_rig_tick(u->rig);
        if (fabs(end - whole) > SAME || ticks < 1) return tell(u, DISCARD, "a step must end at a multiple of 10 ms after the present time, got an end at %.9g s", from + length);
        if (ir_rig_command(u->rig, u->now.frequency, u->now.current)) 
            return tell(u, ERROR, SNAPSHOT_INPUTS ", got %g Hz and %g", u->now.frequency, u->now.current);
        for (int64_t part; ticks > 0; ticks -= part) {
            part = ticks < IR_RIG_TICKS ? ticks : IR_RIG_TICKS;
            if ((scans = ir_rig_advance(u->rig, part)) < 0) return unsolved(u, scans);
            keep_scan(u, scans);
        }
    }
    return ir_rig_latest(u->rig, u->now.motion) ? unsolved(u, IR_RIG_UNSOLVED) : OK;
}

/* A sample before the first step is the value at time 0, from which the first line goes. */
static int begin(unit *u)
{
    u->now.previous = u->now.current;
    return OK;
}

static int save(unit *u, void **state)
{
    u->now.size = sizeof u->now + ir_rig_state_size(u->rig);
    void *room = realloc(*state, u->now.size);
    if (!room) return tell(u, ERROR, "no memory");
    *state = room;
    memcpy(*state, &u->now, sizeof u->now);
    ir_rig_save(u->rig, (char *)*state + sizeof u->now);
    return OK;
}

static int restore(unit *u, const void *state)
{
    memcpy(&u->now, state, sizeof u->now);
    ir_rig_restore(u->rig, (const char *)state + sizeof u->now);
    return OK;
}

static int free_state(void **state)
{
    free(*state);
    *state = 0;
    return OK;
}

static size_t size_of(const void *state) { return ((const values *)state)->size; }

static int serialise(const unit *u, const void *state, char *to, size_t size)
{
    if (size < size_of(state)) return tell(u, ERROR, "a serialised state needs %zu bytes, got a buffer of %zu bytes", size_of(state), size);
    memcpy(to, state, size_of(state));
    return OK;
}

static int deserialise(const unit *u, const char *from, size_t size, void **state)
{
    size_t held = 0;
    if (size >= sizeof held) memcpy(&held, from, sizeof held); /* bytes have no alignment */
    if (held < sizeof(values) || size < held) return tell(u, ERROR, "the bytes are not a state that this FMU has serialised: they are damaged, or of another FMU");
    void *room = realloc(*state, held);
    if (!room) return tell(u, ERROR, "no memory");
    *state = room;
    memcpy(*state, from, held);
    return OK;
}

/* FMI 3.0 */

const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path, bool visible, bool logging, bool events, bool early,
    const unsigned *required, size_t count, void *environment, log_3 log, void *intermediate)
{
    (void)path, (void)visible, (void)events, (void)early, (void)required, (void)count, (void)intermediate;
    unit *u = new_unit(name, token);
    if (u) u->environment = environment, u->log_3 = logging ? log : 0;
    return u;
}
void *fmi3InstantiateModelExchange(void) { return 0; }
void *fmi3InstantiateScheduledExecution(void) { return 0; }
void fmi3FreeInstance(unit *u) { free_unit(u); }
int fmi3SetDebugLogging(unit *u, bool on, size_t count, const char *const *categories) { return (void)u, (void)on, (void)count, (void)categories, OK; }
int fmi3EnterInitializationMode(unit *u, bool has, double tolerance, double start, bool ends, double stop)
{
    return (void)has, (void)tolerance, (void)ends, (void)stop, start == 0.0 ? OK : tell(u, ERROR, "the time must start at 0 s, got %g s", start);
}
int fmi3ExitInitializationMode(unit *u) { return begin(u); }
int fmi3Terminate(unit *u) { return (void)u, OK; }
int fmi3Reset(unit *u) { return reset(u); }
int fmi3GetFloat64(unit *u, const unsigned *reference, size_t count, double *to, size_t values) { return values == count ? get(u, reference, count, to) : ERROR; }
int fmi3SetFloat64(unit *u, const unsigned *reference, size_t count, const double *from, size_t values) { return values == count ? set(u, reference, count, from) : ERROR; }
int fmi3DoStep(unit *u, double from, double length, bool no_set, bool *event, bool *terminate, bool *early, double *last)
{
    int status = step(u, from, length);
    (void)no_set, *event = *terminate = *early = false, *last = (double)ir_rig_time_ns(u->rig) / 1e9;
    return status;
}
int fmi3GetFMUState(unit *u, void **state) { return save(u, state); }
int fmi3SetFMUState(unit *u, const void *state) { return restore(u, state); }
int fmi3FreeFMUState(unit *u, void **state) { return (void)u, free_state(state); }
int fmi3SerializedFMUStateSize(unit *u, const void *state, size_t *size) { return (void)u, *size = size_of(state), OK; }
int fmi3SerializeFMUState(unit *u, const void *state, char *to, size_t size) { return serialise(u, state, to, size); }
int fmi3DeserializeFMUState(unit *u, const char *from, size_t size, void **state) { return deserialise(u, from, size, state); }
#define NOT_HERE(name) int name(void) { return ERROR; } /* the unit has no variable of such a type, and no such mode */
#define NO_TYPE(type) NOT_HERE(fmi3Get##type) NOT_HERE(fmi3Set##type)
NO_TYPE(Float32) NO_TYPE(Int8) NO_TYPE(UInt8) NO_TYPE(Int16) NO_TYPE(UInt16) NO_TYPE(Int32) NO_TYPE(UInt32) NO_TYPE(Int64) NO_TYPE(UInt64)
NO_TYPE(Boolean) NO_TYPE(String) NO_TYPE(Binary) NO_TYPE(Clock) NO_TYPE(IntervalDecimal) NO_TYPE(IntervalFraction) NO_TYPE(ShiftDecimal)
NO_TYPE(ShiftFraction) NOT_HERE(fmi3GetNumberOfVariableDependencies) NOT_HERE(fmi3GetVariableDependencies) NOT_HERE(fmi3GetDirectionalDerivative)
NOT_HERE(fmi3GetAdjointDerivative) NOT_HERE(fmi3EnterConfigurationMode) NOT_HERE(fmi3ExitConfigurationMode) NOT_HERE(fmi3EvaluateDiscreteStates)
NOT_HERE(fmi3UpdateDiscreteStates) NOT_HERE(fmi3EnterEventMode) NOT_HERE(fmi3EnterStepMode) NOT_HERE(fmi3GetOutputDerivatives)
NOT_HERE(fmi3ActivateModelPartition) NOT_HERE(fmi3EnterContinuousTimeMode) NOT_HERE(fmi3CompletedIntegratorStep) NOT_HERE(fmi3SetTime)
NOT_HERE(fmi3SetContinuousStates) NOT_HERE(fmi3GetContinuousStateDerivatives) NOT_HERE(fmi3GetEventIndicators) NOT_HERE(fmi3GetContinuousStates)
NOT_HERE(fmi3GetNominalsOfContinuousStates) NOT_HERE(fmi3GetNumberOfEventIndicators) NOT_HERE(fmi3GetNumberOfContinuousStates)

/* FMI 2.0 */

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *name, int type, const char *token, const char *path, const callbacks *functions, int visible, int logging)
{
    (void)path, (void)visible;
    unit *u = type == 1 ? new_unit(name, token) : 0; /* co-simulation */
    if (u && logging) u->callbacks = functions;
    return u;
}
void fmi2FreeInstance(unit *u) { free_unit(u); }
int fmi2SetDebugLogging(unit *u, int on, size_t count, const char *const *categories) { return (void)u, (void)on, (void)count, (void)categories, OK; }
int fmi2SetupExperiment(unit *u, int has, double tolerance, double start, int ends, double stop)
{
    return (void)has, (void)tolerance, (void)ends, (void)stop, start == 0.0 ? OK : tell(u, ERROR, "the time must start at 0 s, got %g s", start);
}
int fmi2EnterInitializationMode(unit *u) { return (void)u, OK; }
int fmi2ExitInitializationMode(unit *u) { return begin(u); }
int fmi2Terminate(unit *u) { return (void)u, OK; }
int fmi2Reset(unit *u) { return reset(u); }
int fmi2GetReal(unit *u, const unsigned *reference, size_t count, double *to) { return get(u, reference, count, to); }
int fmi2SetReal(unit *u, const unsigned *reference, size_t count, const double *from) { return set(u, reference, count, from); }
int fmi2DoStep(unit *u, double from, double length, int no_set) { return (void)no_set, step(u, from, length); }
int fmi2CancelStep(unit *u) { return (void)u, ERROR; }
int fmi2GetFMUstate(unit *u, void **state) { return save(u, state); }
int fmi2SetFMUstate(unit *u, const void *state) { return restore(u, state); }
int fmi2FreeFMUstate(unit *u, void **state) { return (void)u, free_state(state); }
int fmi2SerializedFMUstateSize(unit *u, const void *state, size_t *size) { return (void)u, *size = size_of(state), OK; }
int fmi2SerializeFMUstate(unit *u, const void *state, char *to, size_t size) { return serialise(u, state, to, size); }
int fmi2DeSerializeFMUstate(unit *u, const char *from, size_t size, void **state) { return deserialise(u, from, size, state); }
NOT_HERE(fmi2GetInteger) NOT_HERE(fmi2SetInteger) NOT_HERE(fmi2GetBoolean) NOT_HERE(fmi2SetBoolean) NOT_HERE(fmi2GetString)
NOT_HERE(fmi2SetString) NOT_HERE(fmi2GetDirectionalDerivative) NOT_HERE(fmi2SetRealInputDerivatives) NOT_HERE(fmi2GetRealOutputDerivatives)
NOT_HERE(fmi2GetStatus) NOT_HERE(fmi2GetRealStatus) NOT_HERE(fmi2GetIntegerStatus) NOT_HERE(fmi2GetBooleanStatus) NOT_HERE(fmi2GetStringStatus)
