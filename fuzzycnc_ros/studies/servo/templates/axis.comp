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
""";

pin in bit enable "off: output is zero in the same period, and faults are cleared";
pin in float command "commanded position, for the end of the period that begins [units]";
pin in float command_deriv "commanded velocity there [units/s]";
pin in float feedback "position that is read now [units]";
pin in u32 machine_file "hash of the machine file in use; without output unless it is exported-from";

pin out float output "share of the drive's range, -1 to 1";
pin out float error "following error, as joint.N.f-error [units]";
pin out bit fault "the output is zero until enable has been off";
pin out s32 fault_code "why, also after that; the C below names the numbers";

param r u32 exported_from = 0x{{ machine_hash[:8] }} "first digits of the machine file's hash";
param r u32 controller = 0x{{ controller_hash[:8] }} "first digits of the controller's hash";
param rw float unit = 0.001 "length of a unit of the machine [m]";

option singleton yes;
option data axis;
/* The C below has its own names; without fused multiplication it has the digits of Python. */
option no_convenience_defines yes;
option extra_compile_args "-ffp-contract=off";
function _ fp;
license "Apache-2.0";
author "The fuzzycnc authors";
;;

{% include 'controller.c' %}
/* ---- What runs in the servo thread ------------------------------------------------------------ */

/* Faults that only HAL can have. */
enum {
    {{ name }}_OTHER_FILE = 100, /* exported from another machine file than that in use */
    {{ name }}_OTHER_PERIOD      /* the servo thread has another period */
};

typedef struct {
    {{ name }}_state controller;
    int runs;
    double command, command_deriv;            /* of the period before [m, m/s] */
    double reference, velocity, acceleration; /* where the axis is to be now [m, m/s, m/s2] */
} axis;

/* Take the axis over where it is found. */
static void take_over(axis *a, double position, double period)
{
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

#define FUNCTION(name) static void name(struct __comp_state *hal, long period)

FUNCTION(_)
{
    axis *a = hal->_data;
    double position = *hal->feedback * hal->unit, command_deriv = *hal->command_deriv * hal->unit;

    if (!*hal->enable) {
        *hal->output = 0.0; /* the output first, then the state */
        *hal->error = 0.0;
        *hal->fault = 0;
        a->runs = 0;
    } else {
        if (!a->runs)
            take_over(a, position, period * 1e-9);
        else
            lead(a, command_deriv);
        if (*hal->machine_file != hal->exported_from)
            a->controller.fault = {{ name }}_OTHER_FILE;
        *hal->output = {{ name }}_step(&a->controller, a->reference, position, a->velocity,
                                       a->acceleration);
        *hal->error = (a->reference - position) / hal->unit;
        *hal->fault_code = a->controller.fault;
        *hal->fault = a->controller.fault != 0;
    }
    a->command = *hal->command * hal->unit;
    a->command_deriv = command_deriv;
}
