// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Tabs of tables: offsets, model and nodes, feeds and axes, bags, shop.

import {refusal} from './answers.js';
import {field, make, match, row, say, table} from './dom.js';
import {limits, STATES, stable, stableIn} from './operator.js';
import {
  bytes, duration, micrometres, millimetres, moment, number, percent, quantity, UNKNOWN,
} from './units.js';

const LEVELS = {ok: '✓ ok', warn: '▲ warning', error: '✕ error', stale: '× silent'};

/** Make a table whose rows are items; `columns` are [label, text of an item, is it text?]. */
function sheet(caption, columns) {
  const headings = columns.map(([label, , isText]) => ({label, numeric: !isText}));
  const element = table(caption, headings);
  return {
    element: make('div', {class: 'sheet', tabindex: 0, role: 'region', 'aria-label': caption}, element),
    show(items, key) {
      match(element.tBodies[0], items, key,
        () => row(headings),
        (line, item) => columns.forEach(([, tell], place) => say(line.cells[place], tell(item))));
      element.parentElement.dataset.empty = String(!items.length);
    },
  };
}

/** Make a list of facts: [label, text of a view]. */
function facts(title, entries) {
  const list = make('dl', {class: 'facts'}, ...entries.map(([label]) => make('div', {},
    make('dt', {text: label}), make('dd', {data: {field: label}}))));
  const none = make('p', {class: 'quiet-text'});
  return {
    element: make('section', {class: 'card'}, make('h3', {text: title}), none, list),
    show(value, otherwise) {
      list.hidden = value === null;
      say(none, value === null ? otherwise : '');
      if (value !== null) for (const [label, tell] of entries) field(list, label, tell(value));
    },
  };
}

/** Values at both ends and the middle of an axis whose error slopes, each with its band. */
function alongTravel(along, name, band = null) {
  if (!along) return UNKNOWN;
  return along.position.map((place, at) => {
    const spread = band === null ? '' : ` ± ${micrometres(along[band][at], {digits: 1})}`;
    return `${millimetres(place)}: ${micrometres(along[name][at], {signed: true, digits: 1})}${spread}`;
  }).join(', ');
}

/** The table above the plots of offsets. */
export function buildOffsets(panel) {
  const axes = sheet('Offsets now', [
    ['axis', ({axis}) => axis, true],
    ['requested', ({requested}) => micrometres(requested, {signed: true, digits: 2})],
    ['in force', ({offset}) => micrometres(offset, {signed: true, digits: 2})],
    ['limit', ({limit}) => (limit === null ? UNKNOWN : `±${micrometres(limit)}`)],
    ['share of the limit', ({share}) => percent(share, 1)],
    ['slope', ({slope}) => quantity(slope === null ? null : slope * 1e6, 'µm/m', 2, true)],
    ['reference position', ({reference_position: place}) => millimetres(place)],
    ['error along the travel', ({along}) => alongTravel(along, 'error', 'band')],
    ['offset along the travel', ({along}) => alongTravel(along, 'offset')],
    ['limited by', ({limited}) => limits(limited) || 'nothing', true],
  ]);
  panel.prepend(axes.element);
  return (view) => axes.show(view.axes, ({axis}) => axis);
}

/** The model, its shadow, and the nodes. */
export function buildModel(panel) {
  const model = facts('Model in use', [
    ['name', ({name}) => name || UNKNOWN],
    ['file', ({file}) => file || UNKNOWN],
    ['hash', ({hash}) => hash || UNKNOWN],
    ['prediction', ({valid, why}) => (valid === false ? `✕ not valid: ${why}` : '✓ valid')],
    ['domain', ({in_domain: inside}) => (inside ? '✓ inside its training range' : '▲ outside its training range')],
    ['distance from training', ({distance}) => number(distance, 2)],
    ['trained on', ({runs}) => runs.join(', ') || UNKNOWN],
    ['error on held-out runs (rms)', ({held_out: left}) => Object.entries(left)
      .map(([channel, rms]) => `${channel} ${micrometres(rms, {digits: 2})}`).join(', ') || UNKNOWN],
  ]);
  const shadow = facts('Shadow model', [
    ['model', ({name}) => name],
    ['differs by', ({difference}) => Object.entries(difference)
      .map(([axis, by]) => `${axis} ${micrometres(by, {signed: true, digits: 2})}`).join(', ') || UNKNOWN],
  ]);
  const nodes = sheet('Nodes', [
    ['node', ({name}) => name, true],
    ['state', ({lifecycle}) => lifecycle || UNKNOWN, true],
    ['health', ({level}) => LEVELS[level] ?? level, true],
    ['rate', ({rate: each}) => quantity(each, '1/s', 2)],
    ['latency', ({latency}) => quantity(latency === null ? null : latency * 1e3, 'ms', 1)],
    ['trouble', ({trouble}) => trouble.join('; ') || 'none', true],
  ]);
  panel.append(make('div', {class: 'cards'}, model.element, shadow.element), nodes.element);
  return (view) => {
    model.show(view.model, 'No model is in use, or the predictor does not run.');
    shadow.show(view.model?.shadow ?? null, 'No other model runs beside the one in use.');
    nodes.show(view.nodes, ({name}) => name);
  };
}

/** Feeds, axes and soft material, above the plots of the axes. */
export function buildMotion(panel) {
  const feeds = facts('Feeds', [
    ['path', ({path}) => path || UNKNOWN],
    ['status', ({status, reason}) => (reason ? `${status}: ${reason}` : status) || UNKNOWN],
    ['place on the path', ({arc_length: place}) => millimetres(place)],
    ['feed', ({feed}) => quantity(feed === null ? null : feed * 6e4, 'mm/min')],
    ['override', ({override}) => percent(override)],
    ['method', ({method}) => method || UNKNOWN],
    ['tolerance', ({tolerance}) => micrometres(tolerance)],
  ]);
  const servo = facts('Axes', [
    ['controllers', ({status, reason}) => (reason ? `${status}: ${reason}` : status) || UNKNOWN],
    ['missed deadlines', ({missed}) => number(missed)],
  ]);
  const soft = facts('Soft material', [
    ['pattern', ({path}) => path || UNKNOWN],
    ['material', ({material}) => material || UNKNOWN],
    ['thickness', ({thickness}) => millimetres(thickness, 2)],
    ['model', ({model}) => model.slice(0, 12) || 'none: passed on as it is'],
    ['stitches', ({stitches}) => number(stitches)],
    ['not compensated in full', ({flagged}) => number(flagged)],
    ['largest offset', ({offset_max: largest}) => millimetres(largest)],
  ]);
  const axes = sheet('Axes now', [
    ['axis', ({axis}) => axis, true],
    ['position', ({position}) => millimetres(position)],
    ['velocity', ({velocity}) => quantity(velocity === null ? null : velocity * 6e4, 'mm/min', 1, true)],
    ['error', ({error}) => micrometres(error, {signed: true, digits: 2})],
    ['duty', ({saturated}) => (saturated ? '✕ at its limit' : '✓ free'), true],
  ]);
  panel.prepend(make('div', {class: 'cards'}, feeds.element, servo.element, soft.element), axes.element);
  return (view) => {
    feeds.show(view.feeds, 'feedrate_scheduler does not run at this machine.');
    servo.show(view.servo, 'servo_controller does not run at this machine.');
    soft.show(view.soft, 'deformation_compensator does not run at this machine.');
    axes.show(view.servo?.axes ?? [], ({axis}) => axis);
  };
}

const BAGS = [
  {label: 'bag'}, {label: 'begin'}, {label: 'duration', numeric: true},
  {label: 'size', numeric: true}, {label: 'complete'}, {label: 'get'},
];

/** Bags of this server: list, download, report. */
export function buildBags(panel) {
  const said = make('p', {class: 'trouble', role: 'status'});
  const again = make('button', {type: 'button', text: 'Look again'});
  const bags = table('Recordings of this server', BAGS);
  panel.append(make('div', {class: 'range'}, again, said),
    make('div', {class: 'sheet', tabindex: 0, role: 'region', 'aria-label': 'Recordings'}, bags));

  async function openReport(event, url, name) {
    event.preventDefault();
    try {
      if ((await fetch(url, {method: 'HEAD'})).ok) window.open(url, '_blank', 'noopener');
      else say(said, `${name}: ${await refusal(await fetch(url))}`);
    } catch (fault) {
      say(said, `${name}: the server does not answer: ${fault.message}.`);
    }
  }

  function build({name}) {
    const url = `/bags/${encodeURIComponent(name)}`;
    const report = make('a', {href: `${url}/report`, text: 'report', 'aria-label': `Report of ${name}`});
    report.addEventListener('click', (event) => openReport(event, report.href, name));
    const line = row(BAGS);
    say(line.cells[0], name);
    line.cells[5].append(make('a', {href: url, download: true, text: 'download',
      'aria-label': `Download ${name}`}), ' · ', report);
    return line;
  }

  async function load() {
    try {
      const answer = await fetch('/bags/');
      if (!answer.ok) throw new Error(await refusal(answer));
      const items = await answer.json();
      match(bags.tBodies[0], items, ({name}) => name, build, (line, item) => {
        say(line.cells[1], moment(item.begin));
        say(line.cells[2], duration(item.duration));
        say(line.cells[3], bytes(item.bytes));
        say(line.cells[4], item.complete ? '✓ complete' : '▲ not closed');
      });
      say(said, items.length ? '' : 'No recording yet.');
    } catch (fault) {
      say(said, `The list of recordings could not be read: ${fault.message}.`);
    }
  }

  again.addEventListener('click', load);
  return load;
}

const SHOP = [
  {label: 'machine'}, {label: 'data'}, {label: 'compensation'}, {label: 'state'},
  {label: 'largest share of limit', numeric: true}, {label: 'stable in about', numeric: true},
  {label: 'sensors not ok', numeric: true}, {label: 'alarms'},
];

/** One row a machine; `open(machine)` shows it. */
export function buildShop(panel, open) {
  const shop = table('Machines of this server', SHOP);
  panel.append(make('div', {class: 'sheet', tabindex: 0, role: 'region', 'aria-label': 'Machines'}, shop));

  function build({machine}) {
    const button = make('button', {type: 'button', class: 'quiet', text: machine});
    button.addEventListener('click', () => open(machine));
    const line = row(SHOP);
    line.cells[0].append(button);
    return line;
  }

  function update(line, {view, silent, age}) {
    line.dataset.silent = String(Boolean(silent));
    const put = (place, text) => say(line.cells[place], text);
    put(1, silent ? `✕ NO DATA: ${silent}` : `${duration(age)} old`);
    if (!view) {
      for (let at = 2; at < line.cells.length; at += 1) put(at, UNKNOWN);
      return;
    }
    const {compensation, machine} = view.state;
    const shares = view.axes.map(({share}) => share).filter((share) => share !== null);
    put(2, silent ? UNKNOWN : `${STATES[compensation] ?? '×'} ${compensation}`);
    put(3, silent ? UNKNOWN : machine);
    put(4, silent || !shares.length ? UNKNOWN : percent(Math.max(...shares), 1));
    put(5, silent ? UNKNOWN : stable(stableIn(view)));
    put(6, silent ? UNKNOWN : String(view.sensors.substituted.length + view.sensors.missing.length));
    put(7, view.alarms.map(({level, name}) => `${level === 'error' ? '✕' : '▲'} ${name}`).join(', ')
      || (silent ? UNKNOWN : '✓ none'));
  }

  return (rows) => match(shop.tBodies[0], rows, ({machine}) => machine, build, update);
}
