// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Order of what the search of the site finds: the parameter's own page, the pages, then Python.
"use strict";

var Scorer = {
  score: ([docname, , , , score]) => {
    if (docname === "reference/parameters") return score + 10;
    return docname.startsWith("reference/api/") ? score - 30 : score;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
