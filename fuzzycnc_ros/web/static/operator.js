// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// The screen that an operator reads from three metres.

import {field, make, match, say} from './dom.js';
import {duration, micrometres, number, percent, rate, rpm, UNKNOWN} from './units.js';

export const STATES = {
  active: '●', holding: '◐', ramping: '▼', inactive: '○', expired: '◇', refused: '⊘', absent: '×',
};
const ARROWS = {up: '▲', down: '▼', steady: '■'};
const MOVES = {up: 'rising', down: 'falling', steady: 'steady'};
/** What holds an offset back, as an operator calls it. */
const LIMITS = {clamp: 'limit of size', slew: 'limit of rate', machine: 'limit of the machine itself'};
const ALARM_SIGNS = {warn: '▲', error: '✕'};
export const ALARM_WORDS = {warn: 'warning', error: 'error'};
/** Share of the limit from which the bar warns. */
const NEAR_LIMIT = 0.8;

/** Return in words what holds an offset back; empty where nothing does. */
export function limits(names) {
  return names.map((name) => LIMITS[name] ?? name).join(', ');
}

/** Return the time [s] in which the slowest axis is stable; null where one does not know. */
export function stableIn(view) {
  const times = view.axes.map((axis) => axis.stable_in);
  return times.length && times.every((time) => time !== null) ? Math.max(...times) : null;
}

/** Return what is said of the time in which something is stable. */
export function stable(seconds) {
  return seconds === 0 ? 'now' : duration(seconds);
}

/** Return the whole text of the state of the machine itself. */
function allowed(value) {
  return {true: 'allowed', false: 'refused'}[value] ?? UNKNOWN;
}

function buildAxis({axis}) {
  const pair = (label, name) => make('div', {},
    make('dt', {text: label}), make('dd', {data: {field: `${axis} ${name}`}}));
  const bar = make('div', {class: 'bar', role: 'meter', 'aria-valuemin': -100, 'aria-valuemax': 100,
    'aria-label': `${axis}: offset as a share of its limit`}, make('span', {class: 'fill'}));
  return make('article', {class: 'axis', 'aria-label': `Axis ${axis}`},
    make('h2', {text: axis}),
    make('p', {class: 'move', data: {field: `${axis} move`}}),
    make('p', {class: 'offset', data: {field: `${axis} offset`}}),
    bar,
    make('p', {class: 'share'}, make('span', {data: {field: `${axis} share`}}), ' of ',
      make('span', {data: {field: `${axis} limit`}})),
    make('p', {class: 'limited', data: {field: `${axis} limited`}}),
    make('dl', {},
      pair('rate', 'rate'), pair('predicted error', 'predicted'), pair('stable in about', 'stable'),
      pair('last probe', 'probe')));
}

function updateAxis(card, axis) {
  const put = (name, text) => field(card, `${axis.axis} ${name}`, text);
  put('offset', micrometres(axis.offset, {signed: true}));
  put('move', `${ARROWS[axis.arrow] ?? UNKNOWN} ${MOVES[axis.arrow] ?? 'unknown'}`);
  put('share', percent(axis.share, 1));
  put('limit', axis.limit === null ? UNKNOWN : `±${micrometres(axis.limit)}`);
  put('rate', rate(axis.rate));
  put('predicted', withBand(axis.predicted, axis.band));
  put('stable', stable(axis.stable_in));
  put('probe', axis.probe ? `${micrometres(axis.probe.measured, {signed: true})} measured, `
    + `${micrometres(axis.probe.predicted, {signed: true})} predicted, `
    + `${duration(axis.probe.age)} ago` : 'none');
  put('limited', axis.limited.length ? `✕ ${limits(axis.limited)}` : '');
  const bar = card.querySelector('.bar');
  const fill = bar.firstElementChild;
  const share = Math.min(axis.share ?? 0, 1);
  const signed = axis.offset < 0 ? -share : share;
  fill.style.left = `${50 + 50 * Math.min(signed, 0)}%`;
  fill.style.width = `${50 * share}%`;
  bar.setAttribute('aria-valuenow', number(100 * signed, 1).replace('\u2212', '-'));
  bar.dataset.level = axis.limited.length ? 'limit' : share >= NEAR_LIMIT ? 'near' : 'free';
}

/** Return a prediction [m] with its band [m]. */
export function withBand(predicted, band) {
  if (predicted === null) return UNKNOWN;
  const spread = band === null ? '' : `\u00a0±\u00a0${number(band * 1e6, 1)}`;
  return `${number(predicted * 1e6, 1, true)}${spread}\u00a0µm`;
}

/** Return when the next probe is due and why, and what the last one changed. */
export function probingText({due, reason, due_in: left, age, changes}) {
  const next = due ? `Probe due: ${reason}`
    : left === null ? 'No probe due' : `Next probe due in about ${duration(left)}`;
  const changed = changes.map(({channel, change}) => (
    `${channel} ${micrometres(change, {signed: true})}`)).join(', ');
  return age === null ? `${next}.` : `${next}. The last, ${duration(age)} ago, changed ${changed}.`;
}

/** Return the newest outcome of the probing cycle, or whether it is due. */
function cycleText(cycle) {
  return `Probing cycle: ${cycle.outcome || `${cycle.due ? 'due, ' : ''}${cycle.reason}`}.`;
}

/** Return the elements of one alarm. */
function buildAlarm(alarm) {
  return make('li', {class: 'alarm', data: {level: alarm.level}},
    make('p', {class: 'since quiet-text', 'aria-hidden': 'true'}), make('p', {class: 'what'}), make('p', {class: 'cause'}), make('p', {class: 'remedy'}));
}

function updateAlarm(row, alarm, stamp) {
  const [since, what, cause, remedy] = row.children;
  say(what, `${ALARM_SIGNS[alarm.level] ?? '▲'} ${ALARM_WORDS[alarm.level] ?? alarm.level}: `
    + `${alarm.name} (${alarm.node})`);
  say(cause, alarm.cause);
  say(remedy, alarm.remedy);
  say(since, alarm.since === null ? '' : `for ${duration(stamp - alarm.since)}`);
}

/** Return the key of an alarm: its causes may change their figures, it stays the same alarm. */
function alarmKey(alarm) {
  return JSON.stringify([alarm.level, alarm.node, alarm.name]);
}

/** Show a view. */
export function showOperator(panel, view) {
  const {state} = view;
  panel.querySelector('#state').dataset.state = state.compensation;
  say(panel.querySelector('#state-sign'), STATES[state.compensation] ?? '×');
  field(panel, 'compensation', state.compensation);
  field(panel, 'why', state.why);
  field(panel, 'machine state', state.machine);
  field(panel, 'offsets allowed', allowed(state.offsets_allowed));
  panel.querySelector('#simulated').hidden = !view.simulated;
  panel.querySelector('#recording').hidden = !view.recording?.active;
  field(panel, 'recording', view.recording?.bag ?? '');
  field(panel, 'stable', stable(stableIn(view)));
  field(panel, 'spindle', rpm(view.spindle));

  const axes = panel.querySelector('#axes');
  axes.dataset.count = view.axes.length;
  match(axes, view.axes, (axis) => axis.axis, buildAxis, updateAxis);

  const {alarms} = view;
  field(panel, 'alarm count', String(alarms.length));
  panel.querySelector('#no-alarms').hidden = alarms.length > 0;
  match(panel.querySelector('#alarms'), alarms, alarmKey, buildAlarm,
    (row, alarm) => updateAlarm(row, alarm, view.stamp));

  const {probing} = view;
  panel.querySelector('#probing').hidden = !probing;
  panel.querySelector('#probing-cycle').hidden = !probing?.cycle;
  field(panel, 'probing', probing ? probingText(probing) : '');
  field(panel, 'probing cycle', probing?.cycle ? cycleText(probing.cycle) : '');

  const {sensors} = view;
  field(panel, 'sensors ok', String(sensors.ok));
  field(panel, 'sensors substituted', String(sensors.substituted.length));
  field(panel, 'sensors missing', String(sensors.missing.length));
  for (const kind of ['substituted', 'missing']) {
    panel.querySelector(`.count.${kind}`).dataset.count = sensors[kind].length;
  }
  const lost = [
    ...sensors.missing.map(({name, why}) => ({kind: 'missing', text: `× ${name}: ${why}`})),
    ...sensors.substituted.map(({name, by}) => (
      {kind: 'substituted', text: `▨ ${name}: ${by} stands in`})),
  ];
  match(panel.querySelector('#lost'), lost, ({text}) => text,
    ({kind, text}) => make('li', {class: kind, text}));
}
