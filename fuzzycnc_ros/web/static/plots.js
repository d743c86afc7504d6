// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Tabs of plots: temperatures by cluster, error, offsets, axes. All share one range of time.

import {Chart} from './chart.js';
import {make, match, say} from './dom.js';
import {Stretch} from './history.js';
import {duration, moment} from './units.js';

const SPANS = [['10 min', 600], ['1 h', 3600], ['4 h', 14400], ['24 h', 86400]];
const COLOURS = ['line-1', 'line-2', 'line-3', 'line-4', 'line-5', 'line-6', 'line-7', 'line-8'];
/** Time [s] between two fetches of what views do not tell. */
const AGAIN = 5;
/** Share of the time that drawing may take: a thousand lines take seconds. */
const SHARE = 0.25;
const MICRO = 1e6;

/** Return values times a factor; what a row does not tell is undefined, which is no gap. */
function scaled(values, factor) {
  return values.map((value) => (value === null || value === undefined ? undefined : value * factor));
}

/** Return a line of a column, with its least and largest values where rows were merged. */
function line(stretch, name, {factor = 1, envelope = false, ...look}) {
  const column = stretch.columns.get(name);
  if (!column) return [];
  const bounds = envelope ? {low: scaled(column.min, factor), high: scaled(column.max, factor)} : {};
  return [{label: name, ...look, values: scaled(column.mean, factor), ...bounds}];
}

/** Return the names before a word in the columns, as in `Y predicted`. */
function owners(stretch, word) {
  return [...stretch.columns.keys()].filter((name) => name.endsWith(` ${word}`))
    .map((name) => name.slice(0, -word.length - 1));
}

function temperatures(stretch, view) {
  const clusters = view.sensors.clusters.map(({chosen, members}) => ({
    title: `Cluster of ${chosen}`, chosen, members}));
  const placed = new Set(clusters.flatMap(({members}) => members));
  const rest = [...stretch.columns.keys()].filter((name) => !placed.has(name));
  if (rest.length) {
    clusters.push({title: clusters.length ? 'In no cluster' : 'All sensors', chosen: null, members: rest});
  }
  return clusters.map(({title, chosen, members}) => ({
    title, unit: '°C', digits: 2,
    note: 'Thick: chosen as an input of the model. Dashed: not good, or another stands in.',
    lines: members.flatMap((name, place) => {
      const look = {colour: COLOURS[place % COLOURS.length], width: name === chosen ? 3 : 1.3};
      const [whole] = line(stretch, name, look);
      if (!whole) return [];
      const flags = stretch.flags.get(name);
      if (!flags?.includes(1)) return [whole];
      // The dashed stretch begins at the last good sample: else single ones would not be seen.
      const poor = (at) => flags[at] || flags[at + 1];
      return [
        {...whole, values: whole.values.map((value, at) => (flags[at] ? null : value))},
        {...whole, label: `${name} substituted`, dash: [3, 5],
          values: whole.values.map((value, at) => (poor(at) ? value : null))},
      ];
    }),
  }));
}

function error(stretch) {
  const charts = owners(stretch, 'predicted').map((name) => {
    const look = {factor: MICRO};
    const [predicted] = line(stretch, `${name} predicted`, {...look, colour: 'line-1', width: 2});
    const [band] = line(stretch, `${name} band`, look);
    if (band) {
      const around = (sign) => predicted.values.map((value, at) => (
        value === undefined || band.values[at] === undefined ? undefined
          : value + sign * band.values[at]));
      Object.assign(predicted, {low: around(-1), high: around(1)});
    }
    return {
      title: `Predicted error of ${name}`, unit: 'µm',
      note: 'Filled: the band in which 95 % of probes are expected. Points: probed.',
      lines: [predicted,
        ...line(stretch, `${name} probed`, {...look, colour: 'line-2', points: true})],
    };
  });
  const all = (word, look) => owners(stretch, word).flatMap((name, place) => (
    line(stretch, `${name} ${word}`, {...look, colour: COLOURS[place % COLOURS.length]})));
  return [...charts,
    {title: 'Residual: probed minus predicted', unit: 'µm', note: 'One point a probe.',
      lines: all('residual', {factor: MICRO, points: true, span: true})}];
}

function offsets(stretch) {
  return owners(stretch, 'requested').map((name) => {
    const limit = line(stretch, `${name} limit`, {factor: MICRO, colour: 'error', width: 1.5, dash: [8, 4]});
    return {
      title: `Offset of ${name}`, unit: 'µm', digits: 2,
      note: 'Filled: least and largest where samples were merged.',
      lines: [
        ...line(stretch, `${name} applied`, {factor: MICRO, colour: 'line-1', width: 2.5, envelope: true}),
        ...line(stretch, `${name} requested`, {factor: MICRO, colour: 'line-2', dash: [6, 4]}),
        ...limit.flatMap((item) => [item,
          {...item, label: `${name} limit below`, values: scaled(item.values, -1)}]),
      ],
    };
  });
}

function axes(stretch) {
  const all = (word, factor) => owners(stretch, word).flatMap((name, place) => line(stretch,
    `${name} ${word}`, {factor, colour: COLOURS[place % COLOURS.length], envelope: true}));
  return [
    {title: 'Positions of the axes', unit: 'mm', digits: 3, lines: all('position', 1e3)},
    {title: 'Following error', unit: 'µm', digits: 2, lines: all('following', MICRO)},
  ];
}

/** What views say of each series: values, flagged columns, and whether that is all. */
const INCREMENTS = {
  temperatures: ({sensors}) => ({
    values: sensors.values,
    flagged: [...sensors.substituted, ...sensors.missing].map(({name}) => name),
    whole: true,
  }),
  error: (view, stretch) => {
    const values = {};
    for (const {axis, predicted, band, probe} of view.axes) {
      values[`${axis} predicted`] = predicted;
      values[`${axis} band`] = band;
      if (probe?.age === 0) values[`${axis} probed`] = probe.measured;
    }
    // A probe brings a residual too, and channels need not be called as axes are.
    const told = owners(stretch, 'predicted').every((name) => `${name} predicted` in values);
    return {values, whole: told && view.axes.every(({probe}) => !probe || probe.age > AGAIN)};
  },
  compensation: (view) => ({
    values: Object.fromEntries(view.axes.flatMap(({axis, requested, offset, limit}) => [
      [`${axis} requested`, requested], [`${axis} applied`, offset], [`${axis} limit`, limit]])),
    whole: true,
  }),
  axes: ({servo}) => ({
    values: Object.fromEntries((servo?.axes ?? []).flatMap(({axis, position, error: following}) => [
      [`${axis} position`, position], [`${axis} following`, following]])),
    whole: true,
  }),
};
const LAYOUTS = {temperatures, error, compensation: offsets, axes};

/** The range of time that all tabs of plots show: the newest span, or a stretch that stays. */
export class Range extends EventTarget {
  span = 3600;
  fixed = null;

  /** Return begin and end [s]; `newest` is where a live range ends. */
  at(newest) {
    return this.fixed ?? [newest - this.span, newest];
  }

  /** Show a stretch, or the newest span where it is null. */
  set(fixed, span = this.span) {
    this.fixed = fixed;
    this.span = span;
    this.dispatchEvent(new Event('change'));
  }
}

/** Plots of one series, and the controls of their range. */
export class Plots {
  #stretch = null;
  #charts = new Map();
  #view = null;
  #fetchedAt = 0;
  /** Until when views are not drawn. */
  #rests = 0;
  #active = false;

  constructor(panel, series, range) {
    Object.assign(this, {series, range});
    this.shown = make('p', {class: 'range-text', role: 'status', data: {field: 'range'}});
    this.trouble = make('p', {class: 'trouble', role: 'alert'});
    this.place = make('div', {class: 'charts'});
    panel.append(this.#controls(), this.trouble, this.place);
    range.addEventListener('change', () => this.#active && this.#load());
  }

  /** Begin or end to fetch and draw: only the tab that is seen does. */
  activate(active) {
    this.#active = active;
    if (active && this.#view) this.#load();
  }

  /** Take a view of the machine that is shown. */
  take(view) {
    const other = view.machine !== this.#view?.machine;
    const anew = !other && view.stamp < this.#view?.stamp;
    this.#view = view;
    if (!this.#active || view.stamp === null) return;
    if (other || anew || !this.#stretch) {
      this.#load();
      return;
    }
    if (this.range.fixed || view.silent) return;
    const whole = this.#append();
    if (this.#stretch.long || (!whole && performance.now() - this.#fetchedAt > AGAIN * 1000)) this.#load();
    else if (performance.now() > this.#rests) this.#draw();
  }

  /** Continue by the newest view; return whether it tells all of the series. */
  #append() {
    const {stamp} = this.#view;
    const {values, flagged, whole} = INCREMENTS[this.series](this.#view, this.#stretch);
    this.#stretch.append(stamp, values, flagged);
    this.#stretch.forget(this.range.at(stamp)[0]);
    return whole;
  }

  async #load() {
    const {machine, stamp} = this.#view;
    if (stamp === null) return;
    if (this.#stretch?.machine !== machine) this.#stretch = new Stretch(machine, this.series);
    this.#fetchedAt = performance.now();
    try {
      if (await this.#stretch.load(...this.range.at(stamp))) {
        say(this.trouble, '');
        // The past is kept with fewer digits: the newest row is the one of the view.
        if (!this.range.fixed && !this.#view.silent) this.#append();
        this.#draw();
      }
    } catch (fault) {
      say(this.trouble, `The past could not be read: ${fault.message}`);
    }
  }

  #draw() {
    this.#rest();
    const [begin, end] = this.range.at(this.#view.stamp);
    this.live.setAttribute('aria-pressed', String(!this.range.fixed));
    say(this.shown, `${moment(begin)} to ${moment(end)}, ${duration(end - begin)}`
      + `${this.range.fixed ? ', stands still' : ''}`);
    const layout = LAYOUTS[this.series](this.#stretch, this.#view);
    for (const [title, chart] of this.#charts) {
      if (!layout.some((item) => item.title === title)) {
        chart.remove();
        this.#charts.delete(title);
      }
    }
    match(this.place, layout, ({title}) => title, ({title, lines, ...look}) => {
      const chart = new Chart({title, ...look, zoom: (fixed) => this.range.set(fixed)});
      this.#charts.set(title, chart);
      return chart.element;
    });
    for (const {title, lines} of layout) {
      const chart = this.#charts.get(title);
      chart.element.dataset.empty = String(!lines.length);
      chart.show(this.#stretch.time, lines, [begin, end]);
    }
    Object.assign(this.place.dataset, {rows: this.#stretch.time.length, view: this.#view.sequence});
  }

  /** Rest in proportion to the time until what is now drawn can be seen. */
  #rest() {
    const begun = performance.now();
    this.#rests = Infinity;
    const seen = () => { this.#rests = begun + (performance.now() - begun) / SHARE; };
    requestAnimationFrame(() => requestAnimationFrame(seen));
  }

  #controls() {
    const button = (text, label, act) => {
      const element = make('button', {type: 'button', text, 'aria-label': label});
      element.addEventListener('click', act);
      return element;
    };
    const move = (factor, shift) => () => {
      const [begin, end] = this.range.at(this.#view?.stamp ?? 0);
      const half = (end - begin) / 2;
      const middle = begin + half + shift * half;
      this.range.set([middle - factor * half, middle + factor * half]);
    };
    this.live = button('● Live', 'Live: follow the newest data', () => this.range.set(null));
    const span = make('select', {'aria-label': 'Span of time of live plots'},
      ...SPANS.map(([text, value]) => make('option', {value, text, selected: value === this.range.span})));
    span.addEventListener('change', () => this.range.set(null, Number(span.value)));
    this.range.addEventListener('change', () => { span.value = String(this.range.span); });
    return make('div', {class: 'range', role: 'group', 'aria-label': 'Range of time'},
      this.live, span,
      button('◀', 'Earlier', move(1, -1)), button('▶', 'Later', move(1, 1)),
      button('+', 'Zoom in', move(0.5, 0)), button('\u2212', 'Zoom out', move(2, 0)), this.shown);
  }
}
