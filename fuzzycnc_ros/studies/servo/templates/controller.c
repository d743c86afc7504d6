{% if not scope %}/* {{ title }}
 *
 * Written by `fuzzycnc servo export` from {{ source }}.
 * machine file {{ machine_hash }}
 * controller   {{ controller_hash }}
 *
 * Position controller of one axis: reference and reading in, duty out, once per control period.
 * C99, no allocation, no global state, no library but <math.h>.  Compile with -ffp-contract=off:
 * then every duty is that of the Python controller, to the last bit.
 *
 *   {{ name }}_state axis;
 *   {{ name }}_reset(&axis, 0.0);
 *   duty = {{ name }}_step(&axis, reference, reading, velocity, acceleration);
 *
 * cc -DSELF_TEST -std=c99 -O2 -ffp-contract=off FILE -lm && ./a.out
 */
{% endif %}
#include <math.h>

/* ---- Constants ------------------------------------------------------------------------- */
{% include 'constants.c' %}
{% if law != 'pid' %}
/* The observer: of each state what the states, the disturbance, the duty and a difference add. */
#define STATES {{ rows | length }}
static const double DYNAMICS[STATES][STATES] = {
{%- for row in rows %}
    { {{ row.states | join(', ') }} },
{%- endfor %}
};
static const double DISTURBANCE[STATES] = { {{ rows | map(attribute='disturbance') | join(', ') }} };
static const double DUTY[STATES] = { {{ rows | map(attribute='duty') | join(', ') }} };
{%- if not tried %}
static const double GAIN[STATES] = { {{ rows | map(attribute='gain') | join(', ') }} };
{%- endif %}
{% endif %}
{%- if tried %}
/* What the settings decide.  The law takes it from the set in force: the tuned one, or a trial's. */
typedef struct {
{%- for item in tried %}
    double {{ item.name }}; /* {{ item.meaning }}{% if item.unit %} [{{ item.unit }}]{% endif %} */
{%- endfor %}
{%- if rows %}
    double GAIN[STATES]; /* what a difference adds to the states of the observer */
{%- endif %}
} {{ name }}_set;
static const {{ name }}_set TUNED = {
{%- for item in tried %}
    {{ item.value | number }},
{%- endfor %}
{%- if rows %}
    { {{ rows | map(attribute='gain') | join(', ') }} },
{%- endif %}
};
{%- for item in tried %}
#define {{ item.name }} s->set->{{ item.name }}
{%- endfor %}
{%- if rows %}
#define GAIN s->set->GAIN
{%- endif %}
{% endif %}
{%- if law == 'rules' and contracts %}
/* The rules: between neighbouring cuts of error and rate the surface is a + b x + c y + d x y. */
#define CUTS {{ cuts | length }}
static const double CUT[CUTS] = { {{ cuts | join(', ') }} };
static const double CELL[CUTS + 1][CUTS + 1][4] = {
{%- for row in cells %}
    {
{%- for cell in row %}
        { {{ cell | join(', ') }} },
{%- endfor %}
    },
{%- endfor %}
};
{% endif %}
/* Faults, in which the duty is zero until a reset. */
enum {
    {{ name }}_RUNS,
    {{ name }}_TOO_FAR,        /* reading and reference are further apart than the travel */
    {{ name }}_NOT_FINITE,     /* reading or reference */
    {{ name }}_JUMPED,         /* the reading has jumped */
    {{ name }}_SWINGS,         /* the loop is unstable */
    {{ name }}_RUNS_AWAY,      /* the axis runs away against its duty */
    {{ name }}_ODD_STEPS,      /* the reading moves in other steps than counts */
    {{ name }}_COARSE_STEPS,   /* the reading moves in steps of several counts */
    {{ name }}_DERIVATIVE      /* a derivative of the reference is not finite */
};

typedef struct {
    int fault, started, saturated, way;
    double share, duty, friction, error;
    /* what was read before, and what is expected of it */
    int has_last, has_aim, has_off, bad, bad_total, gap, fresh, against;
    double last, aim, off, slope, speed, answered;
    /* ends of the duty */
    int swings, since_end, end;
    /* counts */
    int changes, odd, kinds;
    long long divisor, bend, bend_before, kind[8];
    /* an error that swings */
    int grows, calm, side, length, last_length, halves, alike, driven, swing_length;
    double frequency, mean, reference, pace, change, peak, last_peak, first, swing_size;
{%- if law == 'pid' %}
    double rate_last, rate, integral;
{%- else %}
    double state[STATES], disturbance;
{%- endif %}
{%- if law == 'rules' %}
    /* what the observer saw of the disturbance in motion: backward, forward */
    int going, moved, count[2];
    double first_seen, seen[2];
    /* relief from stick-slip */
    int rest, has_reference, still, good, phase, side_before, has_moved, proven;
    double amplitude, held_reference, anchor, mean_error, mean_duty, duty_before, held;
{%- endif %}
{%- if tried %}
    const {{ name }}_set *set;
{%- endif %}
} {{ name }}_state;

/* ---- Small helpers ---------------------------------------------------------------------- */

static double between(double value, double low, double high)
{
    double least = low > value ? low : value;
    return high < least ? high : least;
}

static long long common_divisor(long long a, long long b)
{
    a = a < 0 ? -a : a;
    b = b < 0 ? -b : b;
    while (b) {
        long long rest = a % b;
        a = b;
        b = rest;
    }
    return a;
}

/* ---- The error swings, and grows ---------------------------------------------------------- */

static void swing_start_over({{ name }}_state *s)
{
    s->grows = 0;
    s->side = s->length = s->last_length = s->halves = s->alike = 0;
    s->peak = s->last_peak = s->first = 0.0;
    s->swing_length = 0;
    s->swing_size = 0.0;
    s->driven = 0;
}

/* End a half swing; with the one before it makes a swing, whatever the mean is off. */
static void swing_turn({{ name }}_state *s, int side)
{
    int length = s->length + s->last_length, before = s->swing_length;
    double size = s->peak + s->last_peak, smaller = s->swing_size;
    int alike = length < SWING_ALIKE * before && before < SWING_ALIKE * length;
    double stays = SWING_STAYS * smaller, least = 2.0 * SWING_LEAST;

    if (least > stays)
        stays = least;
    s->alike = alike && !s->driven && size >= stays ? s->alike + 1 : 0;
    if (s->driven || !alike || smaller == 0.0 || size < SWING_GROWS * smaller || length < 4) {
        s->halves = 0;
        s->first = size;
        s->grows = s->grows && size > SWING_DIES * smaller;
    } else {
        s->halves++;
        s->grows = s->halves >= SWING_HALVES && 0.5 * size >= SWING_LEAST &&
                   size >= SWING_GROWN * s->first;
        if (s->grows)
            s->frequency = 1.0 / (PERIOD * length);
    }
    s->swing_length = length;
    s->swing_size = size;
    s->last_length = s->length;
    s->last_peak = s->peak;
    s->side = side;
    s->length = 0;
    s->peak = 0.0;
    s->driven = 0;
}

static void swing_add({{ name }}_state *s, double error, double reference)
{
    double pace, change, size;

    s->mean += (error - s->mean) * SWING_SHARE;
    pace = reference - s->reference;
    change = pace - s->pace;
    s->reference = reference;
    s->pace = pace;
    if (s->calm) {
        s->calm--;
        return;
    }
    if (!(-SWING_STEADY < change && change < SWING_STEADY)) {
        if (change * s->change < 0.0)
            s->driven = 1;
        s->change = change;
    }
    size = error - s->mean;
    s->length++;
    if (s->side * size < 0.0 || !s->side)
        swing_turn(s, size > 0.0 ? 1 : -1);
    else if (fabs(size) > s->peak)
        s->peak = fabs(size);
}

/* ---- Can the feedback be right? ------------------------------------------------------------ */

static void divisor_restart({{ name }}_state *s)
{
    s->divisor = s->bend = s->bend_before = 0;
    s->changes = s->odd = s->kinds = 0;
}

static int swings_already(const {{ name }}_state *s)
{
    return s->frequency > 0.0 || s->swings >= ENDS_BEFORE_LOSS;
}

/* Count a bad reading; give up after too many in a row. */
static int refuse({{ name }}_state *s, int fault)
{
    s->bad++;
    s->bad_total++;
    if (s->has_last)
        s->last += s->slope;
    if (s->bad > BAD_MAX)
        s->fault = swings_already(s) ? {{ name }}_SWINGS : fault;
    return 0;
}

/* Judge whether the reading still moves in single counts. */
static void judge_counts({{ name }}_state *s, double counts, double bend_counts)
{
    long long whole = (long long)rint(counts), bend = (long long)rint(bend_counts);
    int kind, steady, swings;

    if (fabs(counts - (double)whole) > 0.25) {
        s->odd++;
        if (s->odd > BAD_MAX)
            s->fault = {{ name }}_ODD_STEPS;
        return;
    }
    s->divisor = common_divisor(s->divisor, whole);
    if (s->divisor == 1) {
        divisor_restart(s);
        return;
    }
    steady = bend == s->bend;
    swings = bend == s->bend_before;
    s->bend_before = s->bend;
    s->bend = bend;
    if (steady || !whole)
        return;
    s->changes += swings ? 1 : COUNT_IRREGULAR;
    for (kind = 0; kind < s->kinds && s->kind[kind] != whole; kind++)
        ;
    if (kind == s->kinds && s->kinds < COUNT_KINDS)
        s->kind[s->kinds++] = whole;
    if (s->changes >= COUNT_CHANGES && s->kinds >= COUNT_KINDS)
        s->fault = {{ name }}_COARSE_STEPS;
}

/* Judge whether the axis gains speed against the duty that it answers to. */
static void judge_direction({{ name }}_state *s, double change)
{
    double before = s->speed, speed = before + (change - before) * SPEED_SHARE;
    double pushed = s->answered * DIRECTION;
    int against = 0;

    s->speed = speed;
    if (pushed > LOAD)
        against = speed < before && speed < -STILL_CHANGE;
    else if (pushed < -LOAD)
        against = speed > before && speed > STILL_CHANGE;
    s->against = against ? s->against + 1 : 0;
    if (s->against >= RUNAWAY_PERIODS)
        s->fault = swings_already(s) ? {{ name }}_SWINGS : {{ name }}_RUNS_AWAY;
}

/* Whether a reading can be used. */
static int accepts({{ name }}_state *s, double reference, double position)
{
    double error = reference - position, change, surprise, room;
    int gap;

    if (!(-ERROR_MAX <= error && error <= ERROR_MAX)) {
        if (isfinite(error))
            return refuse(s, {{ name }}_TOO_FAR);
        s->gap++;
        return refuse(s, {{ name }}_NOT_FINITE);
    }
    if (!s->has_aim || fabs(reference - s->aim) > LEAP)
        s->swings = s->end = 0; /* a new target throws the duty about, too */
    s->aim = reference;
    s->has_aim = 1;
    if (!s->has_last) {
        s->last = position;
        s->has_last = 1;
    }
    change = position - s->last;
    surprise = change - s->slope;
    room = JUMP * (1 + s->gap) * (1 + s->gap);
    if (s->fresh) {
        room += LEAP; /* nothing is known of the speed yet */
        s->fresh--;
    }
    if (!(-room <= surprise && surprise <= room) ||
        (s->has_off && fabs(position - s->off - s->slope) <= JUMP)) {
        s->off = position;
        s->has_off = 1;
        return refuse(s, {{ name }}_JUMPED);
    }
    gap = s->gap;
    if (gap) { /* its mean since the last reading */
        change = (change + s->slope * gap) / (gap + 1);
        s->fresh = 2;
    }
    s->last = position;
    s->slope = change;
    s->has_off = 0;
    s->bad = s->gap = 0;
    if (PER_COUNT != 0.0 && !gap && (change != 0.0 || surprise != 0.0))
        judge_counts(s, change * PER_COUNT, surprise * PER_COUNT);
    swing_add(s, error, reference);
    judge_direction(s, change);
    return !s->fault;
}

/* Note the duty that is held from now on; judge whether it swings from end to end. */
static void applied({{ name }}_state *s, double duty)
{
    int end = duty >= FULL_DUTY ? 1 : duty <= -FULL_DUTY ? -1 : 0;

    s->answered += (duty - s->answered) * ANSWER_SHARE;
    s->since_end++;
    if (!end) {
        if (s->since_end > END_PERIODS)
            s->swings = s->end = 0;
        return;
    }
    if (end == -s->end) {
        s->swings = s->since_end <= END_PERIODS ? s->swings + 1 : 0;
        if (s->swings >= ENDS_MAX)
            s->fault = {{ name }}_SWINGS;
    }
    s->end = end;
    s->since_end = 0;
}

/* Take gain back where less of it is stable; else give up. */
static void take_back({{ name }}_state *s)
{
    static const int settles[] = { {{ settles | join(', ') }} }; /* at 1/2, 1/4, 1/8 of it */
    int step = s->share == 1.0 ? 0 : s->share == 0.5 ? 1 : s->share == 0.25 ? 2 : -1;

    if (KEEPS_GAIN || step < 0 || !settles[step]) {
        s->fault = {{ name }}_SWINGS;
        return;
    }
    s->share = 0.5 * s->share;
    swing_start_over(s);
}

/* Coulomb friction that a moving reference will meet; it stays until the axis has arrived. */
static double reference_friction({{ name }}_state *s, double velocity, double acceleration)
{
    double motion = velocity != 0.0 ? velocity : acceleration;

    if (motion != 0.0)
        s->way = motion > 0.0 ? 1 : -1;
    else if (s->way && s->error * s->way <= 0.0)
        s->way = 0;
    return s->way > 0 ? FRICTION_FORWARD : s->way < 0 ? -FRICTION_BACKWARD : 0.0;
}

{%- if law == 'rules' %}
/* ---- Relief from stick-slip: hold where it is good, dither loose where it is not ---------------- */

enum { OFF, HOLDING, DITHERING };

static void relief_reset({{ name }}_state *s, double position)
{
    s->rest = OFF;
    s->amplitude = 0.0;
    s->anchor = position;
    s->still = s->good = s->phase = s->side_before = 0;
    s->has_moved = s->proven = 0;
    s->mean_error = s->mean_duty = s->duty_before = s->held = 0.0;
}

/* Give the axis back to the controller. */
static void relief_leave({{ name }}_state *s)
{
    s->rest = OFF;
    s->amplitude = 0.0;
    s->still = 0;
}

static void relief_release({{ name }}_state *s)
{
    if (s->has_reference)
        relief_leave(s);
    s->has_reference = 0;
}

/* Decide what to do with an axis that has been still for a while. */
static void relief_judge({{ name }}_state *s)
{
    double error = fabs(s->mean_error);
    int side, slipped = 0;

    if (s->still == STILL_COUNT)
        s->duty_before = s->mean_duty;
    if (!s->proven) {
        if (fabs(s->mean_duty - s->duty_before) <= PROOF)
            return;
        s->proven = 1;
        side = error <= LOOSE_ERROR ? 0 : s->mean_error > 0.0 ? 1 : -1;
        slipped = side * s->side_before < 0;
        s->side_before = side;
    }
    if (error <= HOLD_ERROR) {
        s->rest = HOLDING;
        s->held = s->mean_duty;
    } else if (LOOSE_ERROR < error && error < ZONE && AMPLITUDE_MAX != 0.0 &&
               (slipped || s->still >= PATIENCE)) {
        s->rest = DITHERING;
        s->amplitude = START_AMPLITUDE;
        s->good = 0;
    }
}

/* The next value of the square wave. */
static double relief_wave({{ name }}_state *s)
{
    s->phase = (s->phase + 1) % (2 * HALF_WAVE);
    return s->phase < HALF_WAVE ? s->amplitude : -s->amplitude;
}

/* Go on dithering, until the axis is where it should be or is pulled far away. */
static double relief_dither({{ name }}_state *s, double wanted)
{
    if (fabs(s->mean_error) > 2.0 * ZONE) {
        relief_leave(s);
        return wanted;
    }
    s->held += (wanted - s->held) * MEAN_SHARE;
    if (fabs(s->mean_error) <= REACHED_ERROR) {
        s->good++;
        if (s->good >= SETTLED)
            s->rest = HOLDING;
    } else {
        s->good = 0;
        s->amplitude += AMPLITUDE_GROWTH;
        if (AMPLITUDE_MAX < s->amplitude)
            s->amplitude = AMPLITUDE_MAX;
    }
    return wanted + relief_wave(s);
}

/* The duty to command at a reference that stands still. */
static double relief_duty({{ name }}_state *s, double reference, double position, double wanted,
                          double last)
{
    double away;

    if (!s->has_reference || reference != s->held_reference) {
        relief_reset(s, position);
        s->held_reference = reference;
        s->has_reference = 1;
        return wanted;
    }
    s->mean_duty += (last - s->mean_duty) * MEAN_SHARE;
    s->mean_error += (reference - position - s->mean_error) * MEAN_SHARE;
    away = position - s->anchor;
    if (-STILL_BAND <= away && away <= STILL_BAND) {
        s->still++;
    } else {
        s->anchor = position;
        s->still = 0;
        s->has_moved = 1;
        s->proven = 0;
    }
    if (s->rest == OFF) {
        if (s->still >= STILL_COUNT && s->has_moved)
            relief_judge(s);
        return wanted;
    }
    if (s->rest == DITHERING)
        return relief_dither(s, wanted);
    if (fabs(s->mean_error) > LOOSE_ERROR) {
        relief_leave(s);
        return wanted;
    }
    s->amplitude = 0.0 > s->amplitude - AMPLITUDE_DECAY ? 0.0 : s->amplitude - AMPLITUDE_DECAY;
    return s->held + relief_wave(s);
}
{% endif %}
/* ---- The law -------------------------------------------------------------------------------- */
{% if law == 'pid' %}
static void law_restart({{ name }}_state *s, double position, double duty)
{
    s->rate_last = position;
    s->rate = 0.0;
    s->integral = duty;
}

static double law_wanted({{ name }}_state *s, double reference, double position, double velocity,
                         double acceleration)
{
    double change, rate;

    if (FRICTION_KNOWN)
        s->friction = reference_friction(s, velocity, acceleration);
    if (SENSOR_LAG != 0.0)
        reference -= SENSOR_LAG * velocity;
    s->error = reference - position;
    change = (position - s->rate_last) * FREQUENCY;
    s->rate_last = position;
    s->rate += (change - s->rate) * RATE_SHARE;
    rate = velocity - s->rate;
    return PROPORTIONAL * s->error + DERIVATIVE * rate + s->integral + velocity * PER_VELOCITY +
           acceleration * PER_ACCELERATION + s->friction;
}

static void law_commit({{ name }}_state *s, double duty, double position)
{
    double size = fabs(s->error), growth = INTEGRAL * s->error;

    (void)position;
    if (size <= DEAD_ZONE || (size > INTEGRAL_BAND && fabs(s->rate) > STUCK_SPEED))
        return;
    if (!s->saturated || growth * duty < 0.0)
        s->integral += growth;
}

static void law_bridge({{ name }}_state *s, double duty)
{
    (void)duty;
    s->rate_last += s->rate * PERIOD;
}
{% else %}
/* Predict one period further; without a reading nothing is corrected. */
static void predict({{ name }}_state *s, double duty, double reading, int corrects)
{
    double next[STATES], difference = reading - s->state[STATES - 1];
    int row, column;

    for (row = 0; row < STATES; row++) {
        next[row] = DYNAMICS[row][0] * s->state[0];
        for (column = 1; column <= row; column++)
            next[row] += DYNAMICS[row][column] * s->state[column];
        next[row] += DISTURBANCE[row] * s->disturbance;
        next[row] += DUTY[row] * duty;
        next[row] += (corrects ? GAIN[row] : 0.0) * difference;
    }
    s->disturbance += (corrects ? DISTURBANCE_GAIN : 0.0) * difference;
    for (row = 0; row < STATES; row++)
        s->state[row] = next[row];
}

static void observer_restart({{ name }}_state *s, double position, double duty)
{
{%- for value in rest %}
    s->state[{{ loop.index0 }}] = {{ value }};
{%- endfor %}
    s->disturbance = duty;
}
{% if law == 'cascade' %}
static void law_restart({{ name }}_state *s, double position, double duty)
{
    observer_restart(s, position, duty);
}

static double law_wanted({{ name }}_state *s, double reference, double position, double velocity,
                         double acceleration)
{
    double asked;

    (void)position;
    if (FRICTION_KNOWN)
        s->friction = reference_friction(s, velocity, acceleration);
    s->error = reference - s->state[POSITION];
    asked = velocity + between(POSITION_GAIN * s->error, -VELOCITY_MAX, VELOCITY_MAX);
    return VELOCITY_GAIN * (asked - s->state[VELOCITY]) + asked * PER_VELOCITY +
           acceleration * PER_ACCELERATION + s->disturbance + s->friction;
}
{% else %}
{% if contracts %}
{% include 'exponential.c' %}
{% include 'logarithm.c' %}
/* Power of a number from 0 to 1. */
static double power(double x, double y)
{
    if (x > 0.0)
        return exponential(y * natural_log(x));
    return x == 0.0 && y >= 0.0 ? (y == 0.0 ? 1.0 : 0.0) : NAN;
}

/* A number on its universe, which shrinks with it. */
static double contracted(double value, double per_range, double exponent, double floor)
{
    double x = value * per_range;

    x = x > 1.0 ? 1.0 : x < -1.0 ? -1.0 : x;
    return x / (power(fabs(x), exponent) + floor);
}

static int cell_of(double x)
{
    int cell = 0;

    while (cell < CUTS && !(x < CUT[cell]))
        cell++;
    return cell;
}

static double surface(const {{ name }}_state *s, double error, double rate)
{
    double x = contracted(error, PER_ERROR, ERROR_EXPONENT, ERROR_FLOOR);
    double y = contracted(rate, PER_RATE, RATE_EXPONENT, RATE_FLOOR);
    const double *cell = CELL[cell_of(x)][cell_of(y)];
{% if not tried %}
    (void)s;
{%- endif %}
    return OUTPUT_SCALE * (cell[0] + cell[1] * x + (cell[2] + cell[3] * x) * y);
}
{% else %}
static double surface(const {{ name }}_state *s, double error, double rate)
{
{%- if not tried %}
    (void)s;
{%- endif %}
    return ERROR_GAIN * error + RATE_GAIN * rate;
}
{% endif %}
static void law_restart({{ name }}_state *s, double position, double duty)
{
    s->error = 0.0;
    s->going = 0;
    s->moved = s->count[0] = s->count[1] = 0;
    s->first_seen = duty;
    observer_restart(s, position, duty);
    relief_reset(s, position);
    s->has_reference = 0;
}

/* Set off with what was seen of the disturbance in motion, and see what there is to see: at rest
 * friction takes whatever force there is. */
static void learn({{ name }}_state *s, double velocity)
{
    int forward = s->way > 0, known = s->count[forward] ? forward : !forward;
    double slowest = s->way * velocity, seen = s->way * s->state[VELOCITY], share;

    if (!s->going)
        s->disturbance = between(s->count[known] ? s->seen[known] : s->first_seen,
                                 s->disturbance - HIDDEN, s->disturbance + HIDDEN);
    if (seen < slowest)
        slowest = seen;
    if (!(slowest > MOVING && s->going == s->way)) {
        s->moved = 0;
        return;
    }
    s->moved++;
    if (s->moved <= SETTLE_PERIODS)
        return;
    if (!s->count[forward])
        s->seen[forward] = s->disturbance;
    s->count[forward]++;
    share = 1.0 / s->count[forward];
    if (SEEN_SHARE > share)
        share = SEEN_SHARE;
    s->seen[forward] += (s->disturbance - s->seen[forward]) * share;
}

static double law_wanted({{ name }}_state *s, double reference, double position, double velocity,
                         double acceleration)
{
    int moves = velocity != 0.0 || acceleration != 0.0;
    double wanted;

    if (FRICTION_KNOWN) {
        s->friction = reference_friction(s, velocity, acceleration);
        if (moves)
            learn(s, velocity);
        s->going = moves ? s->way : 0;
    }
    s->error = reference - s->state[POSITION];
    wanted = surface(s, s->error, velocity - s->state[VELOCITY]) + s->disturbance + s->friction;
    if (moves) {
        if (RELIEVES)
            relief_release(s);
        return wanted + velocity * PER_VELOCITY + acceleration * PER_ACCELERATION;
    }
    return RELIEVES ? relief_duty(s, reference, position, wanted, s->duty) : wanted;
}
{% endif %}
static void law_commit({{ name }}_state *s, double duty, double position)
{
    predict(s, duty - s->friction, position, 1);
}

static void law_bridge({{ name }}_state *s, double duty)
{
    predict(s, duty - s->friction, 0.0, 0);
}
{% endif %}
/* ---- What a program calls --------------------------------------------------------------------- */

static void begin({{ name }}_state *s, double position)
{
    s->friction = 0.0;
    s->way = 0;
    s->started = 1;
    law_restart(s, position, s->duty);
}

/* Start anew and clear faults; the duty has held the axis so far.  It begins where the first
 * reading says. */
{{ scope }}void {{ name }}_reset({{ name }}_state *s, double duty)
{
    static const {{ name }}_state fresh = {0};
{%- if tried %}
    const {{ name }}_set *set = s->set;
{%- endif %}

    *s = fresh;
{%- if tried %}
    s->set = set;
{%- endif %}
    s->duty = between(duty, -DUTY_MAX, DUTY_MAX);
    s->share = 1.0;
    s->fresh = s->calm = 2;
}

/* The same at a position at which the axis rests. */
{{ scope }}void {{ name }}_reset_at({{ name }}_state *s, double position, double duty)
{
    {{ name }}_reset(s, duty);
    s->last = position;
    s->has_last = 1;
    begin(s, position);
}

/* Return the duty for the next period; 0 after a fault. */
{{ scope }}double {{ name }}_step({{ name }}_state *s, double reference, double position,
                       double velocity, double acceleration)
{
    double wanted, duty, last = s->duty;

    if (s->fault)
        return s->duty = 0.0;
    if (!accepts(s, reference, position)) {
        if (s->fault || !s->started)
            s->duty = 0.0;
        else
            law_bridge(s, s->duty);
        return s->duty;
    }
    if (!s->started)
        begin(s, position);
    if (s->grows || (s->share < 1.0 && s->alike >= SWING_LASTS))
        take_back(s);
    if (s->share < 1.0) /* as on an axis of less gain */
        position = reference - s->share * (reference - position);
    wanted = law_wanted(s, reference, position, velocity, acceleration);
    duty = wanted > DUTY_MAX ? DUTY_MAX : wanted < -DUTY_MAX ? -DUTY_MAX : wanted;
    if (duty - last > DUTY_CHANGE_MAX)
        duty = last + DUTY_CHANGE_MAX;
    else if (last - duty > DUTY_CHANGE_MAX)
        duty = last - DUTY_CHANGE_MAX;
    s->saturated = duty != wanted;
    if (duty != duty) {
        s->fault = {{ name }}_DERIVATIVE;
        duty = 0.0;
    }
    s->duty = duty;
    applied(s, duty);
    law_commit(s, duty, position);
    return duty;
}

{%- if not scope %}
#ifdef SELF_TEST
#include <stdio.h>

/* reference [m], reading [m], velocity [m/s], acceleration [m/s2], duty [-] */
static const double recorded[][5] = {
{%- for row in recorded %}
    { {{ row | join(', ') }} },
{%- endfor %}
};

int main(void)
{
    {{ name }}_state axis;
    int step, steps = (int)(sizeof recorded / sizeof recorded[0]), wrong = 0;

    {{ name }}_reset(&axis, 0.0);
    for (step = 0; step < steps; step++) {
        const double *r = recorded[step];
        if ({{ name }}_step(&axis, r[0], r[1], r[2], r[3]) != r[4])
            wrong++;
    }
    printf("%d of %d duties differ from those of the controller that this was exported from\n",
           wrong, steps);
    return wrong != 0;
}
#endif
{%- endif %}
