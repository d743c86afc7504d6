/* Copyright The fuzzycnc authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Table of feed shares on disk, for fuzzycnc_feed.h.  Text:
 *
 *   fuzzycnc-feed 1             version
 *   program <64 hex digits>     SHA-256 of the bytes of its part program
 *   <name> <value> ...          what the helper compares
 *   points <n>
 *   <line> <x> <y> <z> <share>  n times: line of the program [-], point [mm], share of the feed [-]
 */
#ifndef FUZZYCNC_FEED_TABLE_H
#define FUZZYCNC_FEED_TABLE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fuzzycnc_feed.h"

/* Read a table, before any thread uses it: it allocates.  Returns the number of its points, which
 * the caller frees, 0 if it is none; `id` becomes the first 32 bits of the hash. */
static inline int fuzzycnc_feed_read(const char *path, fuzzycnc_feed_point **points, unsigned *id)
{
    char word[80];
    FILE *file = fopen(path, "r");
    int version = 0, count = 0, index = 0;

    *points = NULL;
    if (!file)
        return 0;
    if (fscanf(file, "fuzzycnc-feed %d program %79s", &version, word) == 2 && version == 1 &&
        strlen(word) == 64 && sscanf(word, "%8x", id) == 1) {
        while (fscanf(file, "%79s", word) == 1 && strcmp(word, "points"))
            continue;
        if (fscanf(file, "%d", &count) != 1 || count < 2 || count > 50000000)
            count = 0;
        if (count)
            *points = malloc((size_t)count * sizeof **points);
        for (; *points && index < count; index++) {
            fuzzycnc_feed_point *one = *points + index;
            if (fscanf(file, "%d %lf %lf %lf %lf", &one->line, &one->at[0], &one->at[1],
                       &one->at[2], &one->share) != 5)
                break;
        }
    }
    fclose(file);
    return index == count ? count : 0;
}

#endif
