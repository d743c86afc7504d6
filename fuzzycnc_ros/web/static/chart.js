// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// One plot over time by uPlot, with a legend that keyboards reach and that tells the values.
/* global uPlot */

import {make, match, say} from './dom.js';
import {DATED, clock, moment, number, quantity} from './units.js';

const HEIGHT = 260;
/** Lines from which a plot is higher, and how high. */
const MANY = 12;
const HIGH = 460;
const FONT = '13px system-ui, sans-serif';
/** A step longer than this many of its neighbours is drawn as a pause. */
const PAUSE = 3;
/** How times are written along the axis: from which step on, as what, and with which date. */
const DATE = '{YYYY}-{MM}-{DD}';
const TIMES = [[86400, DATE], [60, '{HH}:{mm}', `\n${DATE}`], [1, '{HH}:{mm}:{ss}', `\n${DATE}`]]
  .map(([step, text, date = null]) => [step, text, date, date, date, null, null, null, 1]);
const cursors = uPlot.sync('time');

/** Return a colour of the style sheet as one that a canvas knows, with an opacity. */
function paint(name, opacity = 1) {
  const probe = make('span');
  probe.style.color = `var(--${name})`;
  document.body.append(probe);
  const [red, green, blue] = getComputedStyle(probe).color.match(/[\d.]+/g);
  probe.remove();
  return `rgba(${red}, ${green}, ${blue}, ${opacity})`;
}

/** Return between which neighbours of these times there is a pause, by the later one's place. */
function pauses(times) {
  const step = (at) => (at > 0 && at < times.length ? times[at] - times[at - 1] : 0);
  const found = [];
  for (let at = 1; at < times.length; at += 1) {
    // The past is coarser than the present: only neighbours tell what is usual.
    const usual = Math.max(step(at - 1), step(at + 1));
    if (usual > 0 && step(at) > PAUSE * usual) found.push(at);
  }
  return found;
}

/**
 * Return time and lists with a null where there is a pause, so that no line is drawn across it.
 *
 * In lists, undefined is what a row does not tell and a line passes over; null is a gap.
 */
function withPauses(time, lists) {
  const gaps = lists.map((list) => {
    const known = [...time.keys()].filter((at) => Number.isFinite(list[at]));
    return pauses(known.map((at) => time[at])).map((at) => [known[at - 1], known[at]]);
  });
  const extra = new Set(gaps.flat().filter(([from, to]) => to === from + 1).map(([, to]) => to));
  const stretched = (list, between, own) => list.flatMap((value, at) => (
    extra.has(at) ? [between(at), own(value, at)] : [own(value, at)]));
  return [
    stretched(time, (at) => (time[at] + time[at - 1]) / 2, (value) => value),
    ...lists.map((list, column) => {
      const blank = new Set();
      const cut = new Set();
      for (const [from, to] of gaps[column]) {
        for (let at = from + 1; at <= to; at += 1) cut.add(at);
        for (let at = from + 1; at < to; at += 1) blank.add(at);
      }
      return stretched(list, (at) => (cut.has(at) ? null : undefined),
        (value, at) => (blank.has(at) ? null : value));
    }),
  ];
}

/**
 * A plot.
 *
 * `lines` are {label, colour, width, dash, points, span, low, high}: `low` and `high` name what
 * bounds a filled band. A line takes its values from `show`, by its label.
 */
export class Chart {
  #plot = null;
  #data = [[]];
  #lines = [];
  #range = null;

  constructor({title, unit, digits = 1, zoom, note = ''}) {
    Object.assign(this, {unit, digits, zoom});
    this.heading = make('h3', {text: title});
    this.note = make('p', {class: 'note', text: note});
    this.at = make('span', {class: 'at'});
    this.keys = make('ul', {class: 'keys', 'aria-label': `Lines of ${title}`});
    this.place = make('div', {class: 'plot', role: 'img', 'aria-label': `${title} [${unit || '–'}] over time`});
    this.element = make('figure', {class: 'chart'}, this.heading, this.place,
      make('figcaption', {}, this.at, this.keys, this.note));
    this.observer = new ResizeObserver(() => this.#resize());
    this.observer.observe(this.place);
    this.repaint = () => this.#build();
    document.addEventListener('theme', this.repaint);
  }

  remove() {
    this.observer.disconnect();
    document.removeEventListener('theme', this.repaint);
    this.#drop();
    this.element.remove();
  }

  /** Show lines: each {label, colour, ..., values, low, high} parallel to `time`. */
  show(time, lines, range) {
    const shape = JSON.stringify(lines.map(({values, low, high, ...rest}) => [rest, Boolean(low)]));
    const lists = lines.flatMap(({values, low, high}) => (low ? [values, low, high] : [values]));
    this.#data = withPauses(time, lists);
    this.#range = range;
    if (shape !== this.shape) {
      this.shape = shape;
      this.#lines = lines.map(({values, low, high, ...rest}) => ({...rest, band: Boolean(low)}));
      this.#build();
    } else {
      this.#plot?.setData(this.#data, false);
      this.#scale();
    }
    this.#tell(this.#plot?.cursor.idx ?? null);
  }

  #build() {
    this.#drop();
    if (!this.#lines.length || !this.place.clientWidth) return;
    const series = [{}];
    const bands = [];
    for (const line of this.#lines) {
      const stroke = paint(line.colour);
      line.at = series.length;
      series.push({
        label: line.label, stroke, width: line.width ?? 1.5, dash: line.dash, spanGaps: Boolean(line.span),
        points: {show: line.points ?? false, size: 8, fill: stroke},
        ...(line.points && !line.span ? {paths: () => null} : {}),
      });
      if (line.band) {
        const edge = {stroke: paint(line.colour, 0), points: {show: false}};
        bands.push({series: [series.length + 1, series.length], fill: paint(line.colour, 0.2)});
        series.push({...edge, label: `${line.label} low`}, {...edge, label: `${line.label} high`});
      }
    }
    const axis = {stroke: paint('muted'), grid: {stroke: paint('grid'), width: 1},
      ticks: {stroke: paint('grid')}, font: FONT};
    this.#plot = new uPlot({
      width: this.place.clientWidth, height: this.#height, series, bands,
      legend: {show: false},
      scales: {x: {time: true}},
      cursor: {
        // Cursors go along; what is drawn with the mouse concerns the plot under it alone.
        sync: {key: cursors.key, filters: {pub: (type) => /^mouse(move|leave)$/.test(type)}},
        drag: {x: true, y: false, setScale: false},
        focus: {prox: 24}, bind: {dblclick: () => () => this.zoom(null)},
      },
      focus: {alpha: 0.3},
      axes: [{...axis, values: this.#data[0][0] < DATED ? (plot, ticks) => ticks.map(clock) : TIMES}, {...axis, size: 64, label: this.unit || ' ', labelFont: FONT, labelSize: 22,
        values: (plot, ticks) => ticks.map((value) => (
          String(Number(value.toPrecision(6))).replace('-', '\u2212')))}],
      hooks: {
        setCursor: [(plot) => this.#tell(plot.cursor.idx ?? null)],
        setSelect: [(plot) => {
          const {left, width} = plot.select;
          if (width < 8) return;
          const [begin, end] = [left, left + width].map((place) => plot.posToVal(place, 'x'));
          plot.setSelect({left: 0, width: 0, top: 0, height: 0}, false);
          this.zoom([begin, end]);
        }],
      },
    }, this.#data, this.place);
    this.#scale();
    match(this.keys, this.#lines, ({label}) => label, (line) => this.#key(line));
  }

  #key(line) {
    const look = line.points ? 'points' : line.dash ? 'dashed' : 'solid';
    const swatch = make('span', {class: `swatch ${look}`, 'aria-hidden': 'true'});
    swatch.style.borderColor = `var(--${line.colour})`;
    const button = make('button', {type: 'button', 'aria-pressed': 'true', class: 'quiet'},
      swatch, make('span', {class: 'name', text: line.label}), make('span', {class: 'value'}));
    button.addEventListener('click', () => {
      const shown = button.getAttribute('aria-pressed') !== 'true';
      button.setAttribute('aria-pressed', String(shown));
      const own = this.#lines.find(({label}) => label === line.label);
      for (let at = own.at; at <= own.at + (own.band ? 2 : 0); at += 1) {
        this.#plot.setSeries(at, {show: shown});
      }
    });
    const focus = (on) => this.#plot?.setSeries(on ? this.#lines.find(({label}) => label === line.label).at : null, {focus: on});
    button.addEventListener('pointerenter', () => focus(true));
    button.addEventListener('pointerleave', () => focus(false));
    return make('li', {}, button);
  }

  /** Tell the values at a row, without one the newest of each line. */
  #tell(row) {
    const time = this.#data[0];
    say(this.at, row === null ? 'newest' : moment(time[row]));
    [...this.keys.children].forEach((key, place) => {
      const line = this.#lines[place];
      if (!line?.at) return;
      const values = this.#data[line.at];
      const value = row === null ? values.findLast((item) => Number.isFinite(item)) : values[row];
      say(key.querySelector('.value'), this.unit ? quantity(value, this.unit, this.digits) : number(value, this.digits));
    });
  }

  #scale() {
    const time = this.#data[0];
    const [min, max] = this.#range ?? [time[0], time.at(-1)];
    if (min < max) this.#plot?.setScale('x', {min, max});
  }

  get #height() {
    return this.#lines.length > MANY ? HIGH : HEIGHT;
  }

  #resize() {
    if (!this.#plot) this.#build();
    else if (this.place.clientWidth) this.#plot.setSize({width: this.place.clientWidth, height: this.#height});
  }

  #drop() {
    this.#plot?.destroy();
    this.#plot = null;
  }
}
