/* Copyright The fuzzycnc authors */
/* SPDX-License-Identifier: Apache-2.0 */

/* The inner loop of axes.py: one axis, advanced in steps of 20 us.
 *
 * The chain, in order:
 *   duty + noise, clipped to [-1, 1]       held for one control period
 *   -> dead time                           ring of RING sub-steps
 *   -> valve (spool) lag, first order
 *   -> dead band, gain by direction
 *   -> force: F' = w (G u - B v1 - F)      current loop, R/L, or oil spring
 *   -> mass 1 -(gap, spring, damper)- mass 2, or one mass
 *   with viscous, Coulomb and Stribeck friction on each mass, gravity and
 *   two springy end stops on the load.
 *
 * Integration is semi-implicit (velocity first). Dry friction is an impulse
 * bounded by the friction cone, so that a mass really sticks.
 */

#include <math.h>
#include <stdint.h>

#define RING 512

typedef struct {
    /* Parameters. */
    double dt;
    double substeps;         /* sub-steps in one control period */
    double two_mass;         /* 0: one mass of mass1 + mass2 */
    double sensor_on_load;
    double mass1, mass2;
    double stiffness, damping, gap;
    double viscous1, viscous2;
    double coulomb1, coulomb2;
    double static_ratio;     /* breakaway force over Coulomb force */
    double stribeck_speed;
    double gain_pos, gain_neg, gain_scale;
    double dead_band;
    double back_force;       /* N per m/s lost in the actuator */
    double force_rate;       /* 1/s */
    double valve_rate;       /* 1/s, 0: no valve */
    double delay_steps;
    double gravity;          /* N on the load, signed */
    double limit;            /* end stops at +-limit, 0: none */
    double stop_stiffness, stop_damping;
    double count;
    double noise;            /* standard deviation, in duty */
    /* State. */
    double x1, v1, x2, v2;
    double spool, force;
    double time;
    double spare;            /* second normal deviate */
    double has_spare;
    /* Energy accounts, J. */
    double work_in, work_gravity, lost;
    uint64_t random;
    int64_t head;
    double ring[RING];
} axis_t;

static double uniform(axis_t *a)
{
    uint64_t z = (a->random += 0x9E3779B97F4A7C15ull);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
    z ^= z >> 31;
    return ((double)(z >> 11) + 0.5) * (1.0 / 9007199254740992.0);
}

static double normal(axis_t *a)
{
    if (a->has_spare != 0.0) {
        a->has_spare = 0.0;
        return a->spare;
    }
    const double r = sqrt(-2.0 * log(uniform(a)));
    const double p = 6.283185307179586 * uniform(a);
    a->spare = r * sin(p);
    a->has_spare = 1.0;
    return r * cos(p);
}

/* Dry friction limit (N) at a speed. */
static inline double dry(double coulomb, double ratio, double vs, double v)
{
    const double s = fabs(v) / vs;
    if (s > 4.0)
        return coulomb;
    return coulomb * (1.0 + (ratio - 1.0) * exp(-s * s));
}

/* New speed of a mass under an applied force, viscous and dry friction;
 * adds what friction took to *lost. */
static inline double advance(double v, double m, double applied, double b,
                             double limit, double dt, double *lost)
{
    double u = (v + dt * applied / m) / (1.0 + dt * b / m);
    const double most = limit * dt / m;
    if (u > most)
        u -= most;
    else if (u < -most)
        u += most;
    else
        u = 0.0;
    /* Impulse by friction = m (u - v) - applied dt, at the mean speed. */
    *lost -= (m * (u - v) - applied * dt) * 0.5 * (u + v);
    return u;
}

/* Force between the masses; *spring is its elastic part. A gap only pushes. */
static inline double joint(const axis_t *a, double *spring)
{
    const double d = a->x1 - a->x2;
    const double half = 0.5 * a->gap;
    const double damper = a->damping * (a->v1 - a->v2);
    *spring = 0.0;
    if (half == 0.0) {
        *spring = a->stiffness * d;
        return *spring + damper;
    }
    if (d > half) {
        *spring = a->stiffness * (d - half);
        return fmax(0.0, *spring + damper);
    }
    if (d < -half) {
        *spring = a->stiffness * (d + half);
        return fmin(0.0, *spring + damper);
    }
    return 0.0;
}

static inline double end_stop(const axis_t *a, double x, double v)
{
    if (a->limit <= 0.0)
        return 0.0;
    if (x > a->limit)
        return fmin(0.0, a->stop_stiffness * (a->limit - x) - a->stop_damping * v);
    if (x < -a->limit)
        return fmax(0.0, a->stop_stiffness * (-a->limit - x) - a->stop_damping * v);
    return 0.0;
}

double axis_true(const axis_t *a)
{
    return (a->two_mass != 0.0 && a->sensor_on_load != 0.0) ? a->x2 : a->x1;
}

double axis_measured(const axis_t *a)
{
    return a->count * floor(axis_true(a) / a->count + 0.5);
}

double axis_step(axis_t *a, double duty)
{
    const int n = (int)a->substeps;
    const int64_t delay = (int64_t)a->delay_steps;
    const double dt = a->dt;
    const double fa = 1.0 - exp(-a->force_rate * dt);
    const double va = a->valve_rate > 0.0 ? 1.0 - exp(-a->valve_rate * dt) : 1.0;
    const double whole = a->mass1 + a->mass2;

    if (a->noise > 0.0)
        duty += a->noise * normal(a);
    duty = duty > 1.0 ? 1.0 : (duty < -1.0 ? -1.0 : duty);

    for (int i = 0; i < n; i++) {
        a->ring[a->head & (RING - 1)] = duty;
        const double late = a->ring[(a->head - delay) & (RING - 1)];
        a->head++;
        a->spool += va * (late - a->spool);
        double u = 0.0;
        if (a->spool > a->dead_band)
            u = a->gain_pos * (a->spool - a->dead_band);
        else if (a->spool < -a->dead_band)
            u = a->gain_neg * (a->spool + a->dead_band);
        a->force += fa * (a->gain_scale * u - a->back_force * a->v1 - a->force);

        const double v1 = a->v1, v2 = a->v2;
        if (a->two_mass != 0.0) {
            double spring;
            const double f = joint(a, &spring);
            const double e = end_stop(a, a->x2, v2);
            a->v1 = advance(v1, a->mass1, a->force - f, a->viscous1,
                            dry(a->coulomb1, a->static_ratio, a->stribeck_speed, v1),
                            dt, &a->lost);
            a->v2 = advance(v2, a->mass2, f + a->gravity + e, a->viscous2,
                            dry(a->coulomb2, a->static_ratio, a->stribeck_speed, v2),
                            dt, &a->lost);
            a->x1 += dt * a->v1;
            a->x2 += dt * a->v2;
            const double mid1 = 0.5 * (v1 + a->v1), mid2 = 0.5 * (v2 + a->v2);
            a->lost += dt * (f - spring) * (mid1 - mid2);
            a->work_in += dt * a->force * mid1;
            a->work_gravity += dt * a->gravity * mid2;
        } else {
            const double e = end_stop(a, a->x1, v1);
            a->v1 = advance(v1, whole, a->force + a->gravity + e,
                            a->viscous1 + a->viscous2,
                            dry(a->coulomb1 + a->coulomb2, a->static_ratio,
                                a->stribeck_speed, v1),
                            dt, &a->lost);
            a->x1 += dt * a->v1;
            a->v2 = a->v1;
            a->x2 = a->x1;
            const double mid = 0.5 * (v1 + a->v1);
            a->work_in += dt * a->force * mid;
            a->work_gravity += dt * a->gravity * mid;
        }
    }
    a->time += n * dt;
    return axis_measured(a);
}

uint64_t axis_size(void)
{
    return sizeof(axis_t);
}
