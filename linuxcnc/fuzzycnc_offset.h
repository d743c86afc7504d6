/* Copyright The fuzzycnc authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Offset along one axis, at the servo rate: offset + slope (x - reference), with its own limits.
 *
 * Offsets are in counts, lengths in units of the machine, times in seconds.  A line is kept as its
 * values at the two ends of the travel: where both stay within the size limit and change no faster
 * than the rate limit, every place between them does.  Along the line the offset follows the axis,
 * as fast as an axis can move; a position that leaps further moves nothing at once.
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
static inline double fuzzycnc_at(const fuzzycnc_line *line, double place)
{
    if (!fuzzycnc_slopes(line))
        return line->low;
    if (place <= line->min)
        return line->low;
    if (place >= line->max)
        return line->high;
    return line->low + (line->high - line->low) * ((place - line->min) / (line->max - line->min));
}

/* Go to a line from now on; too steep a one is cut, and so are ends beyond the size limit. */
static inline void fuzzycnc_aim(fuzzycnc_line *line, const fuzzycnc_limits *limits,
                                double offset, double slope, double reference)
{
    double steep = fuzzycnc_slopes(line) ? fuzzycnc_within(slope, limits->slope) : 0.0;
    line->to_low = fuzzycnc_within(offset + steep * (line->min - reference), limits->size);
    line->to_high = fuzzycnc_within(offset + steep * (line->max - reference), limits->size);
    if (!fuzzycnc_slopes(line))
        line->to_low = line->to_high = fuzzycnc_within(offset, limits->size);
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
    double moved;

    tracks = tracks && fuzzycnc_finite(position);
    if (tracks && line->known) {
        moved = position - line->position;
        if (moved < 0.0)
            moved = -moved;
        if (moved <= limits->speed * period)
            carried += fuzzycnc_at(line, position) - fuzzycnc_at(line, line->position);
    }
    line->low += fuzzycnc_within(line->to_low - line->low, reach);
    line->high += fuzzycnc_within(line->to_high - line->high, reach);
    line->known = tracks;
    if (tracks) {
        line->position = position;
        line->value = carried + fuzzycnc_within(fuzzycnc_at(line, position) - carried, reach);
        line->value = fuzzycnc_within(line->value, limits->size);
    }
    return line->value;
}

#endif
