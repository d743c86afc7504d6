/* Copyright The fuzzycnc authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Offset along one axis, at the servo rate: offset + slope (x - reference), with its own limits.
 *
 * Offsets are in counts, lengths in units of the machine, times in seconds.  A line is kept as its
 * values at the two ends of the travel: where both change no faster than the rate limit, every
 * place between them does, and also where the size limit cuts the line.  Along the line the offset
 * follows the axis, as fast as an axis can move; a position that leaps further moves nothing at
 * once.
 *
 * No libm, no allocation, no global state: the component includes it, and so does a test.
 */
#ifndef FUZZYCNC_OFFSET_H
#define FUZZYCNC_OFFSET_H

typedef struct {
    double size;  /* largest offset [counts] */
    double rate;  /* fastest change at a fixed place [counts/s] */
    double slope; /* steepest line [counts/unit] */
    double speed; /* fastest motion of an axis; a faster one was none [units/s] */
} fuzzycnc_limits;

typedef struct {
    double min, max;    /* ends of the travel [units] */
    double low, high;   /* offsets in force there [counts] */
    double to_low, to_high; /* offsets that they go to [counts] */
    double position;    /* of the period before [units] */
    double value;       /* offset in force where the axis is [counts] */
    int known;          /* whether `position` is where the axis was */
} fuzzycnc_line;

static inline double fuzzycnc_within(double value, double most)
{
    return value > most ? most : value < -most ? -most : value;
}

static inline int fuzzycnc_finite(double value)
{
    return value - value == 0.0;
}

/* Whether the axis has a travel along which an offset may slope. */
static inline int fuzzycnc_slopes(const fuzzycnc_line *line)
{
    return line->max > line->min && line->max - line->min < 1e6;
}

/* Offset of the line in force at a place [counts]. */
static inline double fuzzycnc_at(const fuzzycnc_line *line, const fuzzycnc_limits *limits,
                                 double place)
{
    double share = fuzzycnc_slopes(line) ? (place - line->min) / (line->max - line->min) : 0.0;

    share = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
    return fuzzycnc_within(line->low + (line->high - line->low) * share, limits->size);
}

/* Go to a line from now on; too steep a one is cut. */
static inline void fuzzycnc_aim(fuzzycnc_line *line, const fuzzycnc_limits *limits, double offset,
                                double slope, double reference)
{
    double most = limits->size; /* a line that stays beyond the size limit is brought nearer */

    line->to_low = line->to_high = offset;
    if (fuzzycnc_slopes(line)) {
        slope = fuzzycnc_within(slope, limits->slope);
        most += limits->slope * (line->max - line->min);
        line->to_low += slope * (line->min - reference);
        line->to_high += slope * (line->max - reference);
    }
    line->to_low = fuzzycnc_within(line->to_low, most);
    line->to_high = fuzzycnc_within(line->to_high, most);
}

/* Have no offset, at once: the machine takes none. */
static inline void fuzzycnc_drop(fuzzycnc_line *line)
{
    line->low = line->high = line->to_low = line->to_high = line->value = 0.0;
    line->known = 0;
}

/* Go on by one period [s]; `tracks` says whether `position` is where the axis is commanded to be.
 * While it does not, as in joint mode, the offset stays as it is. */
static inline double fuzzycnc_step(fuzzycnc_line *line,
                                   const fuzzycnc_limits *limits, int tracks,
                                   double position, double period)
{
    double reach = limits->rate * period;
    double carried = line->value;
    double most = limits->size; /* not below what stands: a limit that sinks is no leap */
    double moved;

    if (most < carried)
        most = carried;
    if (most < -carried)
        most = -carried;
    tracks = tracks && fuzzycnc_finite(position);
    if (tracks && line->known) {
        moved = position - line->position;
        if (moved < 0.0)
            moved = -moved;
        if (moved <= limits->speed * period)
            carried += fuzzycnc_at(line, limits, position) - fuzzycnc_at(line, limits, line->position);
    }
    line->low += fuzzycnc_within(line->to_low - line->low, reach);
    line->high += fuzzycnc_within(line->to_high - line->high, reach);
    line->known = tracks;
    if (tracks) {
        line->position = position;
        carried = fuzzycnc_within(carried, most);
        line->value = carried + fuzzycnc_within(fuzzycnc_at(line, limits, position) - carried, reach);
    }
    return line->value;
}

#endif
