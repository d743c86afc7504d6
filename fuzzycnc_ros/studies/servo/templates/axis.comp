/* {{ title }}
 *
 * Written by `fuzzycnc servo export --to hal` from {{ source }}.
 * machine file {{ machine_hash }}
 * controller   {{ controller_hash }}
 */
component {{ name }} "{{ title }}";

description """
machine file {{ machine_hash }}
controller {{ controller_hash }}

Takes the place of \\fBpid\\fR for one axis.  Add it to the servo thread behind motion-controller,
and behind what reads the feedback: then an enable that goes off, as at an emergency stop, ends the
output in the same period.

Each joint gets command and command\\-deriv from joint.N.motor\\-pos\\-cmd and joint.N.vel\\-cmd, enable
from joint.N.amp\\-enable\\-out, and gives fault to joint.N.amp\\-fault\\-in.

The pins and parameters that begin with trial are those of \\fBfuzzycnc servo tune
\\-\\-on\\-machine \\-\\-linuxcnc\\fR, which tries other settings of the law while its operator holds a key.  At
the first sign of growth, or where it falls silent, the exported ones are back in the same period.
""";

pin in bit enable "off: output is zero in the same period, and faults are cleared";
pin in float command "commanded position, for the end of the period that begins [units]";
pin in float command_deriv "commanded velocity there [units/s]";
pin in float feedback "position that is read now [units]";
pin in u32 machine_file "hash of the machine file in use; without output unless it is exported-from";
pin in bit hold = 1 "an enabling switch of the operator; off ends a trial in the same period";
pin in s32 trial "each new number is a sign of life, the first begins a trial; 0 ends it, -1 begins anew";

pin out float output "share of the drive's range, -1 to 1";
pin out float error "following error, as joint.N.f-error [units]";
pin out bit fault "the output is zero until enable has been off";
pin out s32 fault_code "why, also after that; the C below names the numbers";
pin out s32 trial_state "0 none, 1 it drives the axis, 2 done, 3 refused, then why it ended";

param r u32 exported_from = 0x{{ machine_hash[:8] }} "first digits of the machine file's hash";
param r u32 controller = 0x{{ controller_hash[:8] }} "first digits of the controller's hash";
param r u32 stream = {{ stream }} "key of the stream that has every period";
param rw float trial_gain "factor on the duty, as if the axis were stronger";
param rw float trial_error_max "following error at which it ends [m]";
param rw float trial_low "ends of the travel [m]";
param rw float trial_high;
param rw float trial_number-##[{{ numbers }}] "its settings, in the order of the set below";
param rw float unit = 0.001 "length of a unit of the machine [m]";

option singleton yes;
option data axis;
option extra_setup yes;
option extra_cleanup yes;
/* The C below has its own names; without fused multiplication it has the digits of Python. */
option no_convenience_defines yes;
option extra_compile_args "-ffp-contract=off";
function _ fp;
license "Apache-2.0";
author "The fuzzycnc authors";
;;

{% include 'controller.c' %}
{% include 'trial.c' %}
/* ---- What runs in the servo thread ------------------------------------------------------------ */

/* Faults that only HAL can have. */
enum {
    {{ name }}_OTHER_FILE = 100, /* exported from another machine file than that in use */
    {{ name }}_OTHER_PERIOD      /* the servo thread has another period */
};

/* Sign of life at which the controller begins anew at rest, as after an enable: so a replay does. */
enum { ANEW = -1 };

typedef struct {
    {{ name }}_state controller;
    trial tried;
    int runs;
    double command, command_deriv;            /* of the period before [m, m/s] */
    double reference, velocity, acceleration; /* where the axis is to be now [m, m/s, m/s2] */
} axis;

/* Take the axis over where it is found. */
static void take_over(axis *a, double position, double period)
{
    a->controller.set = &TUNED;
    {{ name }}_reset_at(&a->controller, position, 0.0);
    if (!isfinite(position))
        a->controller.fault = {{ name }}_NOT_FINITE;
    if (fabs(period - PERIOD) > 0.01 * PERIOD)
        a->controller.fault = {{ name }}_OTHER_PERIOD;
    a->reference = position;
    a->velocity = a->acceleration = 0.0;
    a->runs = 1;
}

/* A command says where the axis is to be at the end of the period that begins, and so the one
 * before where it is to be now.  Rounding at rest must not look like motion: friction would be fed
 * forward for it. */
static void lead(axis *a, double command_deriv)
{
    double acceleration = (command_deriv - a->command_deriv) / PERIOD;

    if (fabs(a->command - a->reference) <= 1e-12 &&
        fabs(a->command_deriv) + fabs(acceleration) * PERIOD <= 1e-9) {
        a->velocity = a->acceleration = 0.0;
        return;
    }
    a->reference = a->command;
    a->velocity = a->command_deriv;
    a->acceleration = acceleration;
}

/* Drive the axis by a trial for a period; at its end the tuned settings do, in the same one. */
static double drive_trial(axis *a, double position)
{
    trial *t = &a->tried;
    int moves = a->velocity != 0.0 || a->acceleration != 0.0;
    double duty = t->gain * {{ name }}_step(&t->controller, a->reference, position, a->velocity,
                                            a->acceleration);

    duty = between(duty, -DUTY_MAX, DUTY_MAX);
    if (t->controller.fault && t->controller.fault != {{ name }}_SWINGS)
        a->controller.fault = t->controller.fault;
    if (a->controller.fault) {
        t->state = GIVEN_UP;
        return 0.0;
    }
    if (t->ends == TRIED)
        t->ends = t->sign ? trial_judge(t, a->reference - position, position, duty, moves) : LET_GO;
    if (t->ends == TRIED || !isfinite(position))
        return duty;
    t->state = t->ends;
    {{ name }}_reset_at(&a->controller, position, t->state == DONE ? duty : t->held);
    if (t->state == DONE)
        return duty;
    return {{ name }}_step(&a->controller, a->reference, position, a->velocity, a->acceleration);
}

/* Begin a trial of an axis that rests, as the parameters say. */
static void begin_trial(axis *a, const struct __comp_state *hal, double position)
{
    trial *t = &a->tried;
    double *into = (double *)&t->set;
    int number, rests = a->velocity == 0.0 && a->acceleration == 0.0;

    for (number = 0; number < (int)(sizeof t->set / sizeof *into); number++)
        into[number] = hal->trial_number[number];
    t->gain = hal->trial_gain;
    t->error_max = hal->trial_error_max;
    t->low = hal->trial_low;
    t->high = hal->trial_high;
    t->state = REFUSED;
    if (!KEEPS_GAIN && rests && !a->controller.fault && t->gain > 0.0 && t->error_max > 0.0 &&
        t->low <= position && position <= t->high)
        trial_begin(t, position, a->controller.duty);
}

/* What is read of every period: enable, command, its velocity, reading, output, sign of life and
 * state of a trial, in SI. */
static hal_stream_t samples;

static void record(int enable, const axis *a, double position, double output)
{
    union hal_stream_data row[7];

    row[0].b = enable;
    row[1].f = a->command;
    row[2].f = a->command_deriv;
    row[3].f = position;
    row[4].f = output;
    row[5].s = a->tried.sign;
    row[6].s = a->tried.state;
    if (hal_stream_writable(&samples)) /* nobody has to read it */
        hal_stream_write(&samples, row);
}

static int extra_setup(struct __comp_state *hal, char *prefix, long extra_arg)
{
    (void)hal;
    (void)prefix;
    (void)extra_arg;
    return hal_stream_create(&samples, comp_id, {{ stream }}, 16000, "bffffss");
}

static void extra_cleanup(void)
{
    if (samples.fifo)
        hal_stream_destroy(&samples);
}

#define FUNCTION(name) static void name(struct __comp_state *hal, long period)

FUNCTION(_)
{
    axis *a = hal->_data;
    trial *t = &a->tried;
    double position = *hal->feedback * hal->unit, command_deriv = *hal->command_deriv * hal->unit;
    int sign = *hal->hold ? *hal->trial : 0, before = t->sign;

    t->sign = sign;
    t->silent = sign == before ? t->silent + 1 : 0;
    if (!*hal->enable) {
        *hal->output = 0.0; /* the output first, then the state */
        *hal->error = 0.0;
        *hal->fault = 0;
        a->runs = 0;
        if (t->state == TRIED)
            t->state = GIVEN_UP;
    } else {
        if (!a->runs)
            take_over(a, position, period * 1e-9);
        else
            lead(a, command_deriv);
        if (sign == ANEW && before != ANEW && a->velocity == 0.0 && a->acceleration == 0.0) {
            position = a->reference;
            {{ name }}_reset_at(&a->controller, position, 0.0);
        }
        if (*hal->machine_file != hal->exported_from)
            a->controller.fault = {{ name }}_OTHER_FILE;
        if (t->state == TRIED)
            *hal->output = drive_trial(a, position);
        else
            *hal->output = {{ name }}_step(&a->controller, a->reference, position, a->velocity,
                                           a->acceleration);
        if (t->state != TRIED && !before && sign > 0)
            begin_trial(a, hal, position);
        *hal->error = (a->reference - position) / hal->unit;
        *hal->fault_code = a->controller.fault;
        *hal->fault = a->controller.fault != 0;
    }
    a->command = *hal->command * hal->unit;
    a->command_deriv = command_deriv;
    *hal->trial_state = t->state;
    record(*hal->enable, a, position, *hal->output);
}
