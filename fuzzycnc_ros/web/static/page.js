// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// The page: which machine and which tab, what the socket says, and how old that is.

import {buildActions, closeQuestions, showActions} from './acting.js';
import {make, match, say} from './dom.js';
import {Live, patience} from './live.js';
import {showOperator} from './operator.js';
import {Plots, Range} from './plots.js';
import {buildBags, buildModel, buildMotion, buildOffsets, buildShop} from './tables.js';
import {duration} from './units.js';

const TABS = [
  ['operator', 'Operator'], ['temperatures', 'Temperatures'], ['error', 'Error'],
  ['offsets', 'Offsets'], ['model', 'Model'], ['motion', 'Motion'], ['bags', 'Bags'], ['shop', 'Shop'],
];
/** Tabs that do not show the present of one machine. */
const APART = new Set(['bags', 'shop']);
/** Tabs whose past stays readable below the words NO DATA. */
const PAST = new Set(['temperatures', 'error', 'offsets']);
const TICK = 250;

const find = (id) => document.getElementById(id);
const panel = (tab) => find(`panel-${tab}`);

const live = new Live();
const loaded = performance.now();
/** The newest view of each machine, and when it arrived. */
const views = new Map();
let hello = {machines: [], writable: false, needs_token: false, recordable: false, interval: 1};
let helloAt = null;
let [machine, tab] = place();

function place() {
  const [named, opened] = location.hash.slice(1).split('/').map(decodeURIComponent);
  return [named || null, TABS.some(([name]) => name === opened) ? opened : 'operator'];
}

// Machine time and that of this computer need not agree: age counts on from the arrival.
function since(at) {
  return (performance.now() - at) / 1000;
}

/** Return why nothing that is shown of a machine counts; empty while all is well. */
function silence(name) {
  if (live.lostAt !== null) {
    return `The server does not answer, for ${duration(since(live.lostAt))}. Connecting again. `
      + 'Look whether the node dashboard runs, and at the network to it.';
  }
  if (helloAt === null) {
    return since(loaded) > patience(1) ? 'The server has not said anything yet.' : '';
  }
  if (!hello.machines.includes(name)) {
    return hello.machines.length ? `This server knows no machine ${name}: choose another.`
      : 'This server sees no machine yet: start its nodes.';
  }
  const held = views.get(name);
  const waited = since(Math.max(held?.arrived ?? 0, helloAt));
  if (waited > patience(hello.interval)) {
    return `Nothing from the server for ${duration(waited)}: it is busy, stopped, or the network is gone.`;
  }
  return held?.view.silent ?? '';
}

function age(name) {
  const held = views.get(name);
  return held && held.view.age !== null ? held.view.age + since(held.arrived) : null;
}

const range = new Range();
const showOffsets = buildOffsets(panel('offsets'));
const showModel = buildModel(panel('model'));
const plots = {
  temperatures: new Plots(panel('temperatures'), 'temperatures', range),
  error: new Plots(panel('error'), 'error', range),
  offsets: new Plots(panel('offsets'), 'compensation', range),
  motion: new Plots(panel('motion'), 'axes', range),
};
const showMotion = buildMotion(panel('motion'));
const loadBags = buildBags(panel('bags'));
const showShop = buildShop(panel('shop'), (name) => choose(name, 'operator'));
const SHOW = {
  operator: (view) => showOperator(panel('operator'), view),
  offsets: showOffsets,
  model: showModel,
  motion: showMotion,
};

function choose(name, opened = tab) {
  location.hash = `${encodeURIComponent(name ?? '')}/${opened}`;
}

function showTab() {
  for (const [name] of TABS) {
    const chosen = name === tab;
    panel(name).hidden = !chosen;
    const button = find(`tab-${name}`);
    button.setAttribute('aria-selected', String(chosen));
    button.tabIndex = chosen ? 0 : -1;
    if (chosen) button.scrollIntoView({block: 'nearest', inline: 'nearest'});
    plots[name]?.activate(chosen);
  }
  if (tab === 'bags') loadBags();
}

function showMachines() {
  const several = hello.machines.length > 1;
  find('machine-choice').hidden = !several;
  find('machine-name').classList.toggle('visually-hidden', several);
  say(find('machine-name'), machine ?? 'no machine');
  match(find('machine'), hello.machines, (name) => name, (name) => make('option', {value: name, text: name}));
  find('machine').value = machine ?? '';
  document.title = `${machine ?? 'no machine'} · fuzzycnc`;
}

function show() {
  const held = views.get(machine);
  if (held) {
    SHOW[tab]?.(held.view);
    for (const item of Object.values(plots)) item.take(held.view);
  }
  showActions(find('actions'), held?.view ?? null, hello);
  tick();
}

/** Show how old things are, also while nothing arrives. */
function tick() {
  const why = silence(machine);
  const lost = live.lostAt !== null;
  const link = find('link');
  link.dataset.link = lost ? 'lost' : helloAt === null ? 'connecting' : 'open';
  say(link, {lost: '× no connection', connecting: '… connecting', open: '✓ connected'}[link.dataset.link]);
  const sequence = views.get(machine)?.view.sequence;
  link.title = `fuzzycnc ${hello.version ?? ''}, view ${sequence ?? 'not yet'}`;
  say(find('age'), duration(age(machine)));
  const cover = find('no-data');
  cover.hidden = !why || (!lost && APART.has(tab));
  cover.classList.toggle('through', PAST.has(tab));
  find('main').inert = !cover.hidden && !PAST.has(tab);
  say(find('no-data-cause'), why);
  document.body.dataset.silent = String(Boolean(why));
  if (tab === 'shop') {
    showShop(hello.machines.map((name) => ({
      machine: name, view: views.get(name)?.view, silent: silence(name), age: age(name)})));
  }
}

function buildTabs() {
  const list = find('tabs');
  for (const [name, text] of TABS) {
    const button = make('button', {type: 'button', role: 'tab', id: `tab-${name}`, text,
      'aria-controls': `panel-${name}`});
    button.addEventListener('click', () => choose(machine, name));
    list.append(button);
  }
  list.addEventListener('keydown', (event) => {
    const step = {ArrowRight: 1, ArrowLeft: -1}[event.key];
    const at = TABS.findIndex(([name]) => name === tab);
    const goal = {Home: 0, End: TABS.length - 1}[event.key]
      ?? (step && (at + step + TABS.length) % TABS.length);
    if (goal === undefined) return;
    event.preventDefault();
    choose(machine, TABS[goal][0]);
    find(`tab-${TABS[goal][0]}`).focus();
  });
}

window.addEventListener('hashchange', () => {
  const before = machine;
  [machine, tab] = place();
  if (machine !== before) closeQuestions();
  showMachines();
  showTab();
  show();
});
find('machine').addEventListener('change', ({target}) => choose(target.value));
live.addEventListener('hello', ({detail}) => {
  hello = detail;
  helloAt = performance.now();
  if (!machine && hello.machines.length) choose(hello.machines[0]);
  for (const name of views.keys()) if (!hello.machines.includes(name)) views.delete(name);
  showMachines();
  show();
});
live.addEventListener('view', ({detail}) => {
  views.set(detail.machine, {view: detail.view, arrived: performance.now()});
  if (detail.machine === machine) show();
});
live.addEventListener('lost', tick);
live.addEventListener('connected', tick);

buildTabs();
buildActions(find('actions'), () => ({
  machine, view: views.get(machine).view, needsToken: hello.needs_token}));
showTab();
showMachines();
setInterval(tick, TICK);
live.start();
