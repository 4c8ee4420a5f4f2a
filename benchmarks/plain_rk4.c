/* The benchmark problem as a plain fixed-step program: RK4, 2 us in contact, 1 ms in flight.
 *
 * What an engineer would write in an afternoon; built and run only by `make bench`. Prints seconds of wall time per run and the amplitude.
 * Contact starts and ends are found by bisection on the step length, the damping by the approach speed, floored like the simulator's.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static const double PI = 3.14159265358979323846;
static double m1, k1, c1, m, K, a, half_gap, omega, base, beta;
static int side; /* wall in contact, 0 in flight */

static void rates(double t, const double *s, double *d) {
    double xb = base * sin(omega * t), vb = base * omega * cos(omega * t), force = 0.0;
    if (side) {
        double depth = side * (s[2] - s[0]) - half_gap, speed = side * (s[3] - s[1]);
        if (depth > 0.0) {
            force = K * depth * sqrt(depth) * (1.0 + beta * speed);
            if (force < 0.0) force = 0.0;
        }
    }
    d[0] = s[1];
    d[1] = (-k1 * (s[0] - xb) - c1 * (s[1] - vb) + side * force) / m1;
    d[2] = s[3];
    d[3] = -side * force / m;
}

static void step(double t, double h, const double *s, double *out) {
    double p[4], q[4], r[4], w[4], x[4];
    rates(t, s, p);
    for (int i = 0; i < 4; i++) x[i] = s[i] + 0.5 * h * p[i];
    rates(t + 0.5 * h, x, q);
    for (int i = 0; i < 4; i++) x[i] = s[i] + 0.5 * h * q[i];
    rates(t + 0.5 * h, x, r);
    for (int i = 0; i < 4; i++) x[i] = s[i] + h * r[i];
    rates(t + h, x, w);
    for (int i = 0; i < 4; i++) out[i] = s[i] + h / 6.0 * (p[i] + 2.0 * q[i] + 2.0 * r[i] + w[i]);
}

int main(int argc, char **argv) {
    double gap = atof(argv[1]), end = atof(argv[2]), late = atof(argv[3]);
    (void)argc;
    m1 = 0.13;
    double wn = 2.0 * PI * 9.105;
    k1 = m1 * wn * wn;
    c1 = 2.0 * 0.0045 * m1 * wn;
    m = atof(argv[4]);
    K = atof(argv[5]);
    a = 8.0 * (1.0 - 0.35) / (5.0 * 0.35);
    half_gap = gap / 2.0;
    omega = 2.0 * PI * 9.1;
    base = 60e-6;
    double s[4] = {-6e-3, 0.0, -6e-3, 0.15}, n[4], t = 0.0, sum_s = 0.0, sum_c = 0.0, sum_w = 0.0;
    long impacts = 0;
    struct timespec begin, stop;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    while (t < end) {
        double h = side ? 2e-6 : 1e-3;
        step(t, h, s, n);
        if (!side) {
            double d = n[2] - n[0];
            if (fabs(d) > half_gap) {
                double low = 0.0, high = h;
                int wall = d > 0.0 ? 1 : -1;
                for (int i = 0; i < 50; i++) {
                    double mid = 0.5 * (low + high);
                    step(t, mid, s, n);
                    if (wall * (n[2] - n[0]) > half_gap) high = mid; else low = mid;
                }
                h = high;
                step(t, h, s, n);
                side = wall;
                double v = wall * (n[3] - n[1]);
                beta = a / (v > 1e-3 ? v : 1e-3);
                impacts++;
            }
        } else if (side * (n[2] - n[0]) < half_gap) {
            double low = 0.0, high = h;
            for (int i = 0; i < 50; i++) {
                double mid = 0.5 * (low + high);
                step(t, mid, s, n);
                if (side * (n[2] - n[0]) < half_gap) high = mid; else low = mid;
            }
            h = high;
            step(t, h, s, n);
            side = 0;
        }
        if (t >= late) { /* trapezoidal lock-in over whole cycles */
            double w = 0.5 * h;
            sum_s += w * (s[0] * sin(omega * t) + n[0] * sin(omega * (t + h)));
            sum_c += w * (s[0] * cos(omega * t) + n[0] * cos(omega * (t + h)));
            sum_w += h;
        }
        for (int i = 0; i < 4; i++) s[i] = n[i];
        t += h;
    }
    clock_gettime(CLOCK_MONOTONIC, &stop);
    double wall_s = (stop.tv_sec - begin.tv_sec) + 1e-9 * (stop.tv_nsec - begin.tv_nsec);
    printf("%.9f %.12g %ld\n", wall_s, 2.0 * sqrt(sum_s * sum_s + sum_c * sum_c) / sum_w, impacts);
    return 0;
}
