// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
component fuzzycnc_offset "Offsets along axes for the external offsets of LinuxCNC";

description """
Works out offset + slope * (position - reference) for up to nine axes in every servo period, keeps
its own limits, and goes to zero when nobody speaks.  Offsets are in counts, lengths in units of the
machine.  \\fBnames=\\fR one name, \\fBpersonality=\\fR number of axes.

A set of numbers is taken as a whole: write offset, slope and reference of all axes, limit and valid\\-for,
then another number to \\fBsequence\\fR; write the next one when \\fBacknowledged\\fR has that
number.  A set that is not finite is never taken.
""";

pin in bit heartbeat "changes as long as somebody speaks";
pin in bit enable "off: nobody speaks any more, go to zero now";
pin in bit rezero "hold the registers at zero";
pin in bit machine_on;
pin in bit homed;
pin in bit teleop "position is that of the axis in this mode";
pin in bit coordinated "and in this one; in neither, as in joint mode, offsets stay as they are";
pin in bit on "eoffset-enable; while it is off offsets stay as they are";
pin in s32 sequence "number of the set; another one says that all of it is written";
pin in float limit "largest offset of this set, if it is below size-max [counts]";
pin in float valid_for "how long to follow this set without another one [s]";

pin in float offset-#[9 : personality] "at the reference [counts]";
pin in float slope-#[9 : personality] "[counts/unit]";
pin in float reference-#[9 : personality] "position at which the slope has no effect [units]";
pin in float position-#[9 : personality] "commanded, without the offset [units]";
pin in float request-#[9 : personality] "eoffset-request [units]";
pin in float scale-#[9 : personality] "eoffset-scale [units/count]";

pin out s32 counts-#[9 : personality] "for eoffset-counts";
pin out float low-#[9 : personality] "offset in force at the lower end of the travel [counts]";
pin out float high-#[9 : personality] "offset in force at the upper end of the travel [counts]";
pin out float base-#[9 : personality] "request that counts of zero would mean [counts]";
pin out s32 acknowledged "number of the set that was taken last";
pin out bit following "that set is followed";
pin out bit alive "somebody speaks";
pin out bit ready "the machine takes offsets";
pin out bit tracking "offsets follow the axes";
pin out bit clear "for eoffset-clear";

param rw float size_max = 10000 "largest offset [counts]";
param rw float rate_max = 1000 "fastest change at a fixed place [counts/s]";
param rw float slope_max = 50 "steepest line [counts/unit]";
param rw float speed_max = 1000 "fastest motion of an axis; a faster one was none [units/s]";
param rw float hold_time = 10 "how long to stand without somebody who speaks [s]";
param rw float min-#[9 : personality] "lower end of the travel [units]";
param rw float max-#[9 : personality] "upper end; no slope where it is not above the lower one";

variable fuzzycnc_line lines[9];
variable double bound;
variable double silence = 1e9;
variable double age;
variable double validity;
variable int heard;
variable int seen;

include "fuzzycnc_offset.h";
function _ fp;
license "Apache-2.0";
author "The fuzzycnc authors";
;;

FUNCTION(_) {
    fuzzycnc_limits limits = {bound, rate_max, slope_max, speed_max};
    int axis, finite;

    /* Is the machine ready, does somebody speak? */
    ready = machine_on && homed;
    clear = !ready || rezero;
    tracking = ready && on && (teleop || coordinated);
    silence += fperiod;
    if (heartbeat != heard) {
        heard = heartbeat;
        silence = 0.0;
    }
    alive = enable && silence <= hold_time;
    age += fperiod;
    if (clear || !alive || age > validity)
        following = 0; /* a heartbeat alone brings no old set back */

    /* Another number: a period later all of the set is there. */
    if (sequence != seen) {
        seen = sequence;
    } else if (seen != acknowledged) {
        finite = fuzzycnc_finite(valid_for) && limit >= 0.0;
        for (axis = 0; axis < personality; axis++)
            finite = finite && fuzzycnc_finite(offset(axis)) && fuzzycnc_finite(slope(axis)) &&
                     fuzzycnc_finite(reference(axis));
        if (finite) {
            acknowledged = seen;
            following = alive && !clear;
            age = 0.0;
            validity = valid_for;
            limits.size = bound = limit < size_max ? limit : size_max;
            for (axis = 0; axis < personality; axis++) {
                lines[axis].min = min(axis);
                lines[axis].max = max(axis);
                fuzzycnc_aim(&lines[axis], &limits, offset(axis), slope(axis), reference(axis));
            }
        }
    }

    for (axis = 0; axis < personality; axis++) {
        fuzzycnc_line *line = &lines[axis];
        /* The controller has taken the counts of the period before by now. */
        base(axis) = scale(axis) > 0.0 ? request(axis) / scale(axis) - counts(axis) : 0.0;
        if (clear)
            fuzzycnc_drop(line);
        else if (!following)
            line->to_low = line->to_high = 0.0;
        fuzzycnc_step(line, &limits, tracking, position(axis), fperiod);
        counts(axis) = (int)(line->value < 0.0 ? line->value - 0.5 : line->value + 0.5);
        low(axis) = line->low;
        high(axis) = line->high;
    }
}
