// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// A stretch of the past of one machine: fetched once, then continued by what views say.

import {refusal} from './answers.js';

/** Rows that are asked for; a screen has hardly more columns. */
const POINTS = 1000;
/** Rows from which a live stretch is fetched anew, coarser. */
const ROWS_MAX = 3 * POINTS;

export class Stretch {
  /** Rows that came while a stretch is being fetched; null while none is. */
  #waiting = null;
  #turn = 0;

  constructor(machine, series) {
    this.machine = machine;
    this.series = series;
    this.clear();
  }

  clear() {
    this.time = [];
    /** @type {Map<string, {min: number[], max: number[], mean: number[]}>} */
    this.columns = new Map();
    this.flags = new Map();
  }

  /** Fetch what happened between two stamps [s]; a later call makes an earlier one void. */
  async load(begin, end) {
    this.#turn += 1;
    const turn = this.#turn;
    this.#waiting = [];
    const query = new URLSearchParams({series: this.series, begin, end, points: POINTS});
    try {
      const answer = await fetch(`/history/${encodeURIComponent(this.machine)}?${query}`);
      if (!answer.ok) throw new Error(await refusal(answer));
      const {time, columns, flags} = await answer.json();
      if (turn !== this.#turn) return false;
      this.time = time;
      this.columns = new Map(Object.entries(columns));
      this.flags = new Map(Object.entries(flags));
    } finally {
      if (turn === this.#turn) {
        for (const item of this.#waiting) this.#add(item);
        this.#waiting = null;
      }
    }
    return true;
  }

  /** Continue by a row from a view: values and names of flagged columns at a stamp [s]. */
  append(stamp, values, flagged = []) {
    if (this.#waiting) this.#waiting.push({stamp, values, flagged});
    else this.#add({stamp, values, flagged});
  }

  /** Drop what lies before a stamp [s]. */
  forget(begin) {
    const count = this.time.findIndex((time) => time >= begin);
    if (count <= 0) return;
    this.time.splice(0, count);
    for (const column of this.columns.values()) {
      for (const values of Object.values(column)) values.splice(0, count);
    }
    for (const flags of this.flags.values()) flags.splice(0, count);
  }

  /** Whether so many rows have come that it should be fetched anew. */
  get long() {
    return this.time.length > ROWS_MAX;
  }

  #add({stamp, values, flagged}) {
    if (stamp < this.time.at(-1)) return;
    const told = stamp === this.time.at(-1);  // then what a view says is put into that row
    const count = this.time.length - (told ? 1 : 0);
    const blank = (value) => new Array(this.time.length).fill(value);
    for (const name of Object.keys(values)) {
      if (!this.columns.has(name)) {
        this.columns.set(name, {min: blank(null), max: blank(null), mean: blank(null)});
      }
    }
    for (const name of flagged) if (!this.flags.has(name)) this.flags.set(name, blank(0));
    this.time[count] = stamp;
    for (const [name, column] of this.columns) {
      for (const list of Object.values(column)) list[count] = values[name] ?? list[count] ?? null;
    }
    for (const [name, flags] of this.flags) flags[count] = flagged.includes(name) ? 1 : 0;
  }
}
