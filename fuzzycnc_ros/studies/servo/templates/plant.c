#include <math.h>
#include <string.h>

/* ---- Constants ------------------------------------------------------------------------- */
{% include 'constants.c' %}

typedef struct {
    double gain_factor, friction_factor; /* what has changed against the machine file [-] */
    double load;                         /* against positive motion, as duty [-] */
    double screw, slide, velocity;       /* [m, m, m/s] */
    double held[HELD];                   /* duties of the last periods, the oldest first */
{%- if model == 'lags' %}
    double amplifier, torque, sensed;
{%- else %}
    double lagged, swing, swing_rate;
{%- endif %}
} {{ name }}_state;

/* ---- Elementary functions --------------------------------------------------------------- */

{% include 'exponential.c' %}
{%- if model == 'mass' %}
{% include 'logarithm.c' %}
{%- endif %}
{%- if periodic %}
{% include 'sine.c' %}
{%- endif %}
/* ---- The axis ----------------------------------------------------------------------------- */

static double between(double value, double low, double high)
{
    double least = low > value ? low : value;
    return high < least ? high : least;
}

/* The duty that drives in this period: dead time of the drive. */
static double delayed({{ name }}_state *s, double duty)
{
    duty = isfinite(duty) ? between(duty, -DUTY_MAX, DUTY_MAX) : 0.0;
    memmove(s->held, s->held + 1, (HELD - 1) * sizeof duty);
    s->held[HELD - 1] = duty;
    return DELAY_PART != 0.0 ? DELAY_PART * s->held[0] + (1.0 - DELAY_PART) * s->held[HELD > 1]
                             : s->held[0];
}

/* Backlash: the slide moves with the screw where it is taken along. */
static void take_along({{ name }}_state *s)
{
    double play = 0.5 * BACKLASH;

    s->slide = BACKLASH != 0.0 ? between(s->slide, s->screw - play, s->screw + play) : s->screw;
}

/* Rest at a position [m]. */
static void {{ name }}_begin({{ name }}_state *s, double position)
{
    static const {{ name }}_state fresh = {.gain_factor = 1.0, .friction_factor = 1.0};

    *s = fresh;
    s->screw = s->slide = position;
{%- if model == 'lags' %}
    s->sensed = position;
{%- endif %}
}

/* Return the true position of the slide [m]. */
static double {{ name }}_position(const {{ name }}_state *s)
{
    return s->slide{% if model == 'mass' %} + s->swing{% endif %};
}

/* Return the reading [m] with a noise [m]. */
static double {{ name }}_measure(const {{ name }}_state *s, double noise)
{
{%- if model == 'lags' %}
    double position = s->sensed;
{%- else %}
    double position = (ENCODER ? s->screw : s->slide) + s->swing;
{%- endif %}

    if (ENCODER)
        position -= {% if periodic %}PERIODIC_ERROR * sine(TURN * position) + {% endif %}PITCH_ERROR * position;
    position += noise;
    return COUNT != 0.0 ? rint(position / COUNT) * COUNT : position;
}

/* Hold a duty for one period. */
{%- if model == 'lags' %}
static void {{ name }}_drive({{ name }}_state *s, double duty)
{
    double asked = DIRECTION * delayed(s, duty), gain = GAIN * s->gain_factor;
    double coulomb = s->friction_factor * COULOMB, breakaway = s->friction_factor * BREAKAWAY;
    int substep;

    for (substep = 0; substep < SUBSTEPS; substep++) {
        double amplifier = s->amplifier, torque = s->torque, velocity = s->velocity;
        double seen = ENCODER ? s->screw : s->slide, push, ratio;

        s->amplifier += (asked - s->amplifier) * AMPLIFY;
        s->torque += (0.5 * (amplifier + s->amplifier) - s->torque) * BUILD;
        push = 0.5 * (torque + s->torque) - s->load;
        if (breakaway > 0.0) {
            if (velocity != 0.0) {
                ratio = velocity / STRIBECK_VELOCITY;
                push -= copysign(coulomb + (breakaway - coulomb) * exponential(-ratio * ratio),
                                 velocity);
            } else {
                push -= fabs(push) <= breakaway ? push : copysign(breakaway, push);
            }
        }
        s->velocity = gain * push + (velocity - gain * push) * KEEP;
        if (breakaway > 0.0 && velocity * s->velocity < 0.0)
            s->velocity = 0.0;
        s->screw += HALF_STEP * (velocity + s->velocity);
        take_along(s);
        s->sensed += (0.5 * (seen + (ENCODER ? s->screw : s->slide)) - s->sensed) * SENSE;
    }
}
{%- else %}
static void {{ name }}_drive({{ name }}_state *s, double duty)
{
    double before = s->velocity, velocity = before, left = PERIOD, acting = delayed(s, duty), force;

    if (DRIVE_LAG != 0.0) {
        double away = s->lagged - acting;
        s->lagged = acting + away * DRIVE_KEEP;
        acting = acting + away * (1.0 - DRIVE_KEEP) * DRIVE_LAG / PERIOD;
    }
    force = DIRECTION * s->gain_factor * FORCE_MAX * acting;
    force -= OFFSET + s->load * FORCE_MAX;
    while (left > 0.0) { /* up to each stop, at which it sticks or turns round */
        int forward = velocity > 0.0 || (velocity == 0.0 && force > 0.0);
        double sign = forward ? 1.0 : -1.0;
        double viscous = s->friction_factor * (forward ? VISCOUS_FORWARD : VISCOUS_BACKWARD);
        double coulomb = s->friction_factor * (forward ? COULOMB_FORWARD : COULOMB_BACKWARD);
        double breakaway = BREAKAWAY_RATIO * s->friction_factor *
                           (forward ? COULOMB_FORWARD : COULOMB_BACKWARD);
        double steady, lag, time, keep;

        if (velocity == 0.0 && fabs(force) <= breakaway)
            break;
        if (STRIBECK_VELOCITY != 0.0) {
            double ratio = velocity / STRIBECK_VELOCITY;
            coulomb += (breakaway - coulomb) * exponential(-ratio * ratio);
        }
        steady = (force - sign * coulomb) / viscous;
        lag = MASS / viscous;
        time = left;
        if (sign * velocity > 0.0 && 0.0 > sign * steady) {
            double whole = 1.0 - velocity / steady, part = -velocity / steady;
            double stop = lag * (natural_log(whole) + (part - (whole - 1.0)) / whole);
            if (stop <= left)
                time = stop;
        }
        keep = exponential(-time / lag);
        s->screw += steady * time + (velocity - steady) * lag * (1.0 - keep);
        take_along(s);
        velocity = time < left ? 0.0 : steady + (velocity - steady) * keep;
        left -= time;
    }
{%- if swings %}
    {
        double swing = s->swing, rate = s->swing_rate, change = velocity - before;
        s->swing = {{ swings[0] }} * swing + {{ swings[1] }} * rate + {{ swings[4] }} * change;
        s->swing_rate = {{ swings[2] }} * swing + {{ swings[3] }} * rate + {{ swings[5] }} * change;
    }
{%- endif %}
    s->velocity = velocity;
}
{%- endif %}
