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

/* What the compiled kernels need besides libm's floor and ceil, and where C programs find them. */
#include <stdint.h>

typedef struct {
    const char *name;
    void *address;
} export;

/* made by build.py */
extern const export kernel_exports[];
extern const char kernel_version[];

const char *impact_rig_version(void) { return kernel_version; }

void *impact_rig_address(const char *name)
{
    for (const export *one = kernel_exports; one->name; one++) {
        const char *a = one->name, *b = name;
        while (*a && *a == *b) a++, b++;
        if (*a == *b) return one->address;
    }
    return 0;
}

/* What Numba's code calls: frexp, exactly, without libm. */
double numba_frexp(double x, int *exponent)
{
    union { double number; uint64_t bits; } v = {x};
    int k = (int)(v.bits >> 52 & 0x7ff);
    *exponent = 0;
    if (x == 0.0 || k == 0x7ff) return x;
    if (k == 0) { /* denormal */
        v.number = x * 0x1p64;
        k = (int)(v.bits >> 52 & 0x7ff) - 64;
    }
    *exponent = k - 1022;
    v.bits = (v.bits & 0x800fffffffffffffu) | 0x3fe0000000000000u;
    return v.number;
}

/* What no kernel reaches: calls of functions without an address, and arrays that have an owner. */
void numba_gil_ensure(void *state) { (void)state, __builtin_trap(); }
void numba_gil_release(void *state) { (void)state, __builtin_trap(); }
void NRT_MemInfo_call_dtor(void *owner) { (void)owner, __builtin_trap(); }
void *numba_unpickle(const void *data, int size, const void *hash) { (void)data, (void)size, (void)hash, __builtin_trap(); }
