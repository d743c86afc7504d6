/* {{ title }}
 *
 * Written by `fuzzycnc servo export --to plant` from {{ source }}.
 * machine file {{ machine_hash }}
 */
component {{ name }} "{{ title }}";

description """
machine file {{ machine_hash }}

Stands for drive, axis and sensor in a LinuxCNC without hardware.  Add measure to the servo thread
ahead of motion\\-controller, and drive behind the controller of the axis.
""";

pin in float duty "share of the drive's range that is held, -1 to 1";
pin in float load "load against positive motion, as duty";
pin out float reading "position as the sensor gives it [units]";
pin out float position "true position of the slide [units]";
pin out float velocity "true velocity of the screw [units/s]";

param rw float gain_factor = 1.0 "what the gain has changed by against the machine file";
param rw float friction_factor = 1.0 "what friction has changed by";
param rw float noise = {{ noise }} "RMS of the sensor's noise [m]";
param rw u32 seed = 1 "what the noise is drawn from; not 0";
param rw float unit = 0.001 "length of a unit of the machine [m]";

option data axis;
/* The C below has its own names; without fused multiplication it has the digits of Python. */
option no_convenience_defines yes;
option extra_compile_args "-ffp-contract=off";
function measure fp;
function drive fp;
license "Apache-2.0";
author "The fuzzycnc authors";
;;

{% include 'plant.c' %}

/* ---- What runs in the servo thread ------------------------------------------------------------ */

typedef struct {
    {{ name }}_state plant;
    int begun;
} axis;

/* Normal to 3 standard deviations and a bit: the sum of twelve uniform numbers. */
static double normal(hal_u32_t *seed)
{
    double sum = -6.0;
    int draw;

    for (draw = 0; draw < 12; draw++) { /* xorshift [Marsaglia 2003] */
        *seed ^= *seed << 13;
        *seed ^= *seed >> 17;
        *seed ^= *seed << 5;
        sum += *seed / 4294967296.0;
    }
    return sum;
}

#define FUNCTION(name) static void name(struct __comp_state *hal, long period)

FUNCTION(measure)
{
    axis *a = hal->_data;

    (void)period;
    if (!a->begun)
        {{ name }}_begin(&a->plant, 0.0);
    a->begun = 1;
    *hal->reading = {{ name }}_measure(&a->plant, hal->noise * normal(&hal->seed)) / hal->unit;
    *hal->position = {{ name }}_position(&a->plant) / hal->unit;
    *hal->velocity = a->plant.velocity / hal->unit;
}

FUNCTION(drive)
{
    axis *a = hal->_data;

    (void)period;
    a->plant.gain_factor = hal->gain_factor;
    a->plant.friction_factor = hal->friction_factor;
    a->plant.load = *hal->load;
    {{ name }}_drive(&a->plant, *hal->duty);
}
