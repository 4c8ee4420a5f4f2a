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

/* The strongest plain C program known for the benchmark problem: fixed-step RK4, written for speed, not beauty.
 *
 * Problem: structure 0.13 kg, 9.105 Hz, zeta 0.0045; base 60 um sin(2 pi 9.1 t); sphere 1.0524 g between walls at +-g/2;
 * F = K d^1.5 (1 + a d'/v0) >= 0, K = 4.403e9 N/m^1.5, a = 8(1-e)/(5e), e = 0.35, v0 = approach speed floored at 1 mm/s.
 * Start x1 = -6 mm at rest, sphere at x1 with +0.15 m/s. Entry by bisecting the RK4 flight step, exit when d <= 0.
 *
 *   gcc -O3 -march=native -o peer_rk4 peer_rk4.c -lm
 *   ./peer_rk4 GAP_M END_S [DT_CONTACT_S DT_FLIGHT_S REPETITIONS]      e.g. ./peer_rk4 6e-3 60 2e-6 1e-3 5
 *
 * Prints JSON: amp (lock-in over the last third [m]; reference 3.480829866e-3 at 6 mm), wall (best of the repetitions [s]),
 * ipc (impacts per cycle above 1 mm/s), steps. Speed = END_S / wall.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const double M1 = 0.13, FN = 9.105, ZE = 0.0045, FD = 9.1, YB = 60e-6, MS = 1.0524e-3, KC = 4.403e9, ER = 0.35, VF = 1e-3;
static const double PI = 3.14159265358979323846;
static double W, K1, C1, AD;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* y = x1, v1, d, d' with d the sphere's position relative to the structure */
static inline void rates(double t, const double *y, double *r, double side, double half, double a_over_v0, int contact) {
    double F = 0;
    if (contact) {
        double depth = side * y[2] - half;
        if (depth > 0) {
            F = KC * depth * sqrt(depth) * (1 + a_over_v0 * side * y[3]);
            if (F < 0) F = 0;
        }
    }
    double a1 = (K1 * (YB * sin(W * t) - y[0]) + C1 * (YB * W * cos(W * t) - y[1]) + side * F) / M1;
    r[0] = y[1];
    r[1] = a1;
    r[2] = y[3];
    r[3] = -side * F / MS - a1;
}

static inline void step(double t, const double *y, double h, double *o, double side, double half, double a_over_v0, int contact) {
    double k1[4], k2[4], k3[4], k4[4], z[4];
    int i;
    rates(t, y, k1, side, half, a_over_v0, contact);
    for (i = 0; i < 4; i++) z[i] = y[i] + .5 * h * k1[i];
    rates(t + .5 * h, z, k2, side, half, a_over_v0, contact);
    for (i = 0; i < 4; i++) z[i] = y[i] + .5 * h * k2[i];
    rates(t + .5 * h, z, k3, side, half, a_over_v0, contact);
    for (i = 0; i < 4; i++) z[i] = y[i] + h * k3[i];
    rates(t + h, z, k4, side, half, a_over_v0, contact);
    for (i = 0; i < 4; i++) o[i] = y[i] + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    double wn = 2 * PI * FN;
    W = 2 * PI * FD;
    K1 = M1 * wn * wn;
    C1 = 2 * ZE * M1 * wn;
    AD = 8 * (1 - ER) / (5 * ER);
    double gap = atof(argv[1]), half = gap / 2, end = atof(argv[2]);
    double dc = argc > 3 ? atof(argv[3]) : 2e-6, df = argc > 4 ? atof(argv[4]) : 1e-3, best = 1e9;
    int repetitions = argc > 5 ? atoi(argv[5]) : 5;
    for (int rep = 0; rep < repetitions; rep++) {
        double began = now();
        double y[4] = {-6e-3, 0, 0, 0.15}, z[4], t = 0, late = end * 2 / 3, spacing = 1 / (100 * FD), ts = late, c = 0, s = 0;
        double side = 1, a_over_v0 = 0;
        long j = 0, impacts = 0, steps = 0, n = lround((end - late) * FD) * 100;
        int contact = 0;
        while (t < end) {
            double h = contact ? dc : df;
            step(t, y, h, z, side, half, a_over_v0, contact);
            steps++;
            if (!contact && fabs(z[2]) >= half) {
                double lo = 0, hi = h;
                for (int i = 0; i < 40 && hi - lo > 1e-12; i++) {
                    double mid = .5 * (lo + hi);
                    step(t, y, mid, z, side, half, a_over_v0, 0);
                    steps++;
                    if (fabs(z[2]) >= half) hi = mid;
                    else lo = mid;
                }
                h = hi;
                step(t, y, h, z, side, half, a_over_v0, 0);
                contact = 1;
                side = z[2] > 0 ? 1 : -1;
                double v = side * z[3];
                a_over_v0 = AD / (v > VF ? v : VF);
                if (t + h >= late && v >= 1e-3) impacts++;
            } else if (contact && side * z[2] - half <= 0)
                contact = 0;
            while (j < n && ts <= t + h) { /* cubic Hermite sample for the lock-in */
                double q = (ts - t) / h, q2 = q * q, q3 = q2 * q;
                double x = (2 * q3 - 3 * q2 + 1) * y[0] + (q3 - 2 * q2 + q) * h * y[1] + (3 * q2 - 2 * q3) * z[0] + (q3 - q2) * h * z[1];
                c += x * cos(W * ts);
                s += x * sin(W * ts);
                j++;
                ts = late + j * spacing;
            }
            t += h;
            memcpy(y, z, sizeof y);
        }
        double wall = now() - began;
        if (wall < best) best = wall;
        if (rep == repetitions - 1)
            printf("{\"amp\":%.9e,\"ipc\":%.5f,\"wall\":%.5f,\"steps\":%ld}\n", 2 * hypot(c, s) / j, impacts / ((end - late) * FD), best, steps);
    }
    return 0;
}
