// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
component fuzzycnc_feed "Feed share from the place on a stored path, for motion.adaptive-feed";

description """
Finds the place of the tool on the path of a part program from its commanded positions, and writes
the share of the feed that a table has there, ahead of time by the latency of the control.  The table
is that of `fuzzycnc schedule --as adaptive`, the program has \\fBM52 P1\\fR.  It is read when the
component is loaded: \\fBloadrt fuzzycnc_feed table=\\fIFILE\\fR.

The share is never above 1 and never 0.  It is 1 until a helper (`fuzzycnc linuxcnc feed`) has armed
the component while no program runs.  Where the place is not known, and when the helper is silent
while a program runs, it is the least share of the table until the place is found or the program
ends.
""";

pin in bit arm "the program and its coordinates are those of the table";
pin in bit heartbeat "changes as long as the helper says so";
pin in bit idle "no program runs: halui.program.is-idle";
pin in s32 program-line "motion.program-line";
pin in float position-#[3] "axis.L.pos-cmd of X, Y and Z [units]";
pin in float offset-#[3] "where zero of the program is [units]";

pin out float share = 1.0 "for motion.adaptive-feed [-]";
pin out bit active "the table is followed";
pin out bit on-path "the place on the path is known";
pin out bit lost "the share is the least of the table, since the place is not known or the helper is silent";
pin out float least-share = 1.0 "least share of the table [-]";
pin out s32 points "points of the table; 0 without one";
pin out u32 table_id "first 32 bits of the hash of its program";

param rw float unit = 1.0 "length of a unit of the machine [mm]";
param rw float distance_max = 0.02 "distance from the path up to which the tool is on it [mm]";
param rw float lead = 0.001 "from a position to the effect of the share [s]";
param rw float timeout = 0.5 "longest time between two heartbeats [s]";

variable fuzzycnc_feed feed;
variable unsigned hash;

option singleton yes;
option extra_setup yes;
option extra_cleanup yes;
include "fuzzycnc_feed_table.h";
function _ fp;
license "Apache-2.0";
author "The fuzzycnc authors";
;;

static char *table = "";
RTAPI_MP_STRING(table, "file of `fuzzycnc schedule --as adaptive`");
static fuzzycnc_feed_point *points_read;

EXTRA_SETUP() {
    int count;

    (void)prefix;
    (void)extra_arg;
    feed.unheard = 1e9; /* nobody has spoken yet */
    if (!table[0])
        return 0;
    count = fuzzycnc_feed_read(table, &points_read, &hash);
    if (!fuzzycnc_feed_take(&feed, points_read, count)) {
        hash = 0;
        rtapi_print_msg(RTAPI_MSG_ERR,
                        "fuzzycnc_feed: %s: expected a table of fuzzycnc schedule but found none; "
                        "the share is 1 until one is loaded\n", table);
    }
    return 0; /* no table keeps a machine from starting */
}

EXTRA_CLEANUP() {
    free(points_read);
}

FUNCTION(_) {
    fuzzycnc_feed_input in = {arm, heartbeat, idle, program_line, {0.0, 0.0, 0.0}};
    int axis;

    for (axis = 0; axis < 3; axis++)
        in.at[axis] = unit * (position(axis) - offset(axis));
    fuzzycnc_feed_set(&feed, distance_max, lead, timeout);
    points = feed.count;
    least_share = fuzzycnc_feed_least(&feed);
    table_id = hash;
    share = fuzzycnc_feed_step(&feed, &in, fperiod);
    active = fuzzycnc_feed_active(&feed);
    on_path = active && fuzzycnc_feed_on_path(&feed);
    lost = !idle && share <= least_share && !on_path && points > 0;
}
