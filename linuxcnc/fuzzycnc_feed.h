/* Copyright The fuzzycnc authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Feed share from the place on a stored path, at the servo rate.
 *
 * The path is a chain of points [mm] with a share of the feed at each, linear in between.  The place
 * on it is followed from period to period: never backwards, no further than the tool has moved, and
 * only on parts that lead the way the tool goes, so that a crossing or another pass nearby is not
 * taken for it.  Where it is not known it is looked for on the line of the program that runs.
 * While it is not known, the share is the least of the table.
 *
 * The share is never above 1 and never below FUZZYCNC_FEED_LEAST, whatever is read or commanded.
 *
 * No libm, no allocation, no global state: the component includes it, and so does a test.
 */
#ifndef FUZZYCNC_FEED_H
#define FUZZYCNC_FEED_H

#define FUZZYCNC_FEED_LEAST 0.01 /* least share of a table, so that nothing ever stands still [-] */
#define FUZZYCNC_FEED_SLACK 0.02  /* way that may be gained beside the motion, as at corners [mm] */
#define FUZZYCNC_FEED_WALK 400    /* parts of the path that are looked at in a period at most */
#define FUZZYCNC_FEED_OTHER 0.1   /* time after which another line that runs is believed [s] */

typedef struct {
    double at[3];  /* [mm] */
    double share;  /* of the feed [-] */
    double length; /* way to the next point [mm]; 0 at the last one */
    int line;      /* of the program, of the motion from here to the next point */
} fuzzycnc_feed_point;

typedef struct {
    const fuzzycnc_feed_point *point;
    int count;         /* points; a path has at least two */
    int first, last;   /* least and largest line of the program that the path has */
    double least;      /* least share [-] */
    double close;      /* distance from the path up to which the tool is on it [mm] */
    double latency;    /* from a position to the effect of the share that it leads to [s] */
    double silence;    /* longest time between two heartbeats [s] */

    int part;          /* part of the path that the tool is on: from this point to the next */
    double along;      /* way on it [mm] */
    double before[3];  /* position of the period before [mm] */
    double unheard;    /* time since the last heartbeat [s] */
    double other;      /* time for which another line has been running [s] */
    int beat;          /* last heartbeat */
    int known;         /* whether `before` is one */
    int found;         /* whether the place is known */
    int next;          /* part that is looked at next while it is not */
    int armed;         /* whether the table is followed */
    int held;          /* whether it was given up while the program ran */
} fuzzycnc_feed;

typedef struct {
    int arm;           /* the program and its coordinates are those of the table, says the helper */
    int heartbeat;     /* changes as long as it says so */
    int idle;          /* no program runs */
    int line;          /* of the program that runs; 0 while nothing moves */
    double at[3];      /* commanded position in the coordinates of the program [mm] */
} fuzzycnc_feed_input;

static inline double fuzzycnc_feed_root(double value)
{
    double root = value > 1.0 ? value : 1.0;
    int turn;

    if (!(value > 0.0))
        return 0.0;
    for (turn = 0; turn < 60; turn++) {
        double now = 0.5 * (root + value / root);
        if (now >= root)
            break;
        root = now;
    }
    return root;
}

/* Square of the distance of a position from a part [mm^2].  `way` is that to the nearest point, not
 * before `from` [mm]; `onward` is how far a motion leads along the part [mm]. */
static inline double fuzzycnc_feed_near(const fuzzycnc_feed_point *part, const double *at,
                                        const double *moved, double from, double *way,
                                        double *onward)
{
    double along = 0.0, lead = 0.0, distance = 0.0, share = 0.0;
    int axis;

    for (axis = 0; axis < 3; axis++) {
        double step = part[1].at[axis] - part[0].at[axis];
        along += step * (at[axis] - part[0].at[axis]);
        lead += step * moved[axis];
    }
    *way = *onward = 0.0;
    if (part->length > 0.0) {
        *way = along / part->length;
        *onward = lead / part->length;
    }
    if (*way < from)
        *way = from;
    if (*way > part->length)
        *way = part->length;
    if (part->length > 0.0)
        share = *way / part->length;
    for (axis = 0; axis < 3; axis++) {
        double away = at[axis] - part[0].at[axis] - share * (part[1].at[axis] - part[0].at[axis]);
        distance += away * away;
    }
    return distance;
}

/* Follow the place from where it was; returns whether the tool is still on the path. */
static inline int fuzzycnc_feed_follow(fuzzycnc_feed *feed, const double *at, const double *moved,
                                       double step)
{
    double reach = 1.5 * step + FUZZYCNC_FEED_SLACK, gone = -feed->along, from = feed->along;
    double best = feed->close * feed->close, along = 0.0;
    int part = feed->part, end = part + FUZZYCNC_FEED_WALK, found = -1;

    for (; part < feed->count - 1 && part < end && gone <= reach; part++, from = 0.0) {
        double way, onward;
        double distance = fuzzycnc_feed_near(feed->point + part, at, moved, from, &way, &onward);
        /* a later part has to be nearer: where both are as near, it is the same place */
        if (onward >= -0.01 * step && gone + way <= reach && distance < best) {
            best = 0.999 * distance;
            found = part;
            along = way;
        }
        gone += feed->point[part].length;
    }
    if (found < 0) {
        double way, onward;
        /* none leads that way, as where a corner is rounded: is it where it was? */
        return fuzzycnc_feed_near(feed->point + feed->part, at, moved, feed->along, &way,
                                  &onward) <= feed->close * feed->close;
    }
    feed->part = found;
    feed->along = along;
    return 1;
}

/* Look for the place on parts of the line that runs, some of them in each period. */
static inline int fuzzycnc_feed_search(fuzzycnc_feed *feed, const double *at, const double *moved,
                                       double step, int line)
{
    double best = feed->close * feed->close, along = 0.0;
    int looked, found = -1;

    for (looked = 0; looked < FUZZYCNC_FEED_WALK; looked++) {
        const fuzzycnc_feed_point *part;
        double way, onward;

        if (feed->next >= feed->count - 1)
            feed->next = 0;
        part = feed->point + feed->next;
        if (part->line == line && step > 0.0) {
            double distance = fuzzycnc_feed_near(part, at, moved, 0.0, &way, &onward);
            if (onward >= 0.5 * step && distance < best) {
                best = 0.999 * distance;
                found = feed->next;
                along = way;
            }
        } else if (found >= 0) {
            break; /* the first pass that fits */
        }
        feed->next++;
    }
    if (found < 0)
        return 0;
    feed->part = found;
    feed->along = along;
    return 1;
}

/* Share of the table a way ahead of the place [-]. */
static inline double fuzzycnc_feed_ahead(const fuzzycnc_feed *feed, double ahead)
{
    const fuzzycnc_feed_point *part = feed->point + feed->part;
    const fuzzycnc_feed_point *last = feed->point + feed->count - 2;
    double left = feed->along + ahead;
    int looked;

    for (looked = 0; looked < FUZZYCNC_FEED_WALK && left >= part->length && part < last; looked++)
        left -= part++->length;
    if (left >= part->length)
        return part[1].share;
    return part->share + (part[1].share - part->share) * left / part->length;
}

/* Share of the feed for the next period [-]. */
static inline double fuzzycnc_feed_step(fuzzycnc_feed *feed, const fuzzycnc_feed_input *in,
                                        double period)
{
    double moved[3], square = 0.0, step, share;
    int axis;

    /* Does the helper still say that this is the program of the table? */
    feed->unheard += period;
    if (in->heartbeat != feed->beat) {
        feed->beat = in->heartbeat;
        feed->unheard = 0.0;
    }
    if (!in->arm || feed->unheard > feed->silence || feed->count < 2) {
        feed->held = (feed->held || feed->armed) && !in->idle;
        feed->armed = 0;
    } else if (in->idle) {
        feed->armed = 1; /* never while a program runs: where it is would not be known */
        feed->held = 0;
    }
    if (in->idle) {
        feed->found = 0;
        feed->next = 0;
        feed->held = 0;
    }

    for (axis = 0; axis < 3; axis++) {
        moved[axis] = feed->known ? in->at[axis] - feed->before[axis] : 0.0;
        square += moved[axis] * moved[axis];
    }
    /* A position that is none is not compared with the next one. */
    feed->known = square - square == 0.0 && in->at[0] - in->at[0] == 0.0 &&
                  in->at[1] - in->at[1] == 0.0 && in->at[2] - in->at[2] == 0.0;
    for (axis = 0; axis < 3; axis++)
        feed->before[axis] = in->at[axis];
    if (!feed->armed)
        return feed->held ? feed->least : 1.0;

    step = fuzzycnc_feed_root(square);
    if (!feed->known) {
        feed->found = 0;
    } else if (feed->found) {
        if (step > 0.0)
            feed->found = fuzzycnc_feed_follow(feed, in->at, moved, step);
        if (!in->line || in->line == feed->point[feed->part].line)
            feed->other = 0.0;
        else if (step > 0.0)
            feed->other += period;
        if (feed->other > FUZZYCNC_FEED_OTHER)
            feed->found = 0;
        if (!feed->found)
            feed->next = 0;
    } else {
        feed->found = fuzzycnc_feed_search(feed, in->at, moved, step, in->line);
        feed->other = 0.0;
    }
    if (!feed->found)
        /* lines that the path does not have, as the way to its start, are as they were written */
        return in->line && (in->line < feed->first || in->line > feed->last) ? 1.0 : feed->least;
    share = fuzzycnc_feed_ahead(feed, step / period * feed->latency);
    if (!(share >= feed->least))
        share = feed->least;
    return share > 1.0 ? 1.0 : share;
}

/* Take a table; returns whether it is one.  Its points stay where they are. */
static inline int fuzzycnc_feed_take(fuzzycnc_feed *feed, fuzzycnc_feed_point *point, int count)
{
    int index, axis;

    feed->point = point;
    feed->count = 0;
    feed->least = 1.0;
    for (index = 0; index < count; index++) {
        fuzzycnc_feed_point *one = point + index;
        double square = 0.0;
        for (axis = 0; axis < 3; axis++) {
            double step = index < count - 1 ? one[1].at[axis] - one->at[axis] : 0.0;
            if (!(one->at[axis] > -1e6 && one->at[axis] < 1e6))
                return 0;
            square += step * step;
        }
        one->length = fuzzycnc_feed_root(square);
        if (!(one->share >= FUZZYCNC_FEED_LEAST && one->share <= 1.0) || one->line < 1)
            return 0;
        if (one->share < feed->least)
            feed->least = one->share;
        if (!index || one->line < feed->first)
            feed->first = one->line;
        if (!index || one->line > feed->last)
            feed->last = one->line;
    }
    if (count < 2)
        return 0;
    feed->count = count;
    return 1;
}

static inline void fuzzycnc_feed_set(fuzzycnc_feed *feed, double close, double latency,
                                     double silence)
{
    feed->close = close;
    feed->latency = latency;
    feed->silence = silence;
}

static inline double fuzzycnc_feed_least(const fuzzycnc_feed *feed)
{
    return feed->count ? feed->least : 1.0;
}

static inline int fuzzycnc_feed_active(const fuzzycnc_feed *feed)
{
    return feed->armed;
}

static inline int fuzzycnc_feed_on_path(const fuzzycnc_feed *feed)
{
    return feed->found;
}

#endif
