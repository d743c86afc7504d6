// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// What a person may do: each act is confirmed, signed with a name, and answered by the server.

import {told} from './answers.js';
import {make} from './dom.js';
import {micrometres} from './units.js';

const NAME = 'fuzzycnc.by';
const TOKEN = 'fuzzycnc.token';

/** Ask the server for an act; return its answer with the HTTP status. */
async function request(machine, action, body) {
  const headers = {'Content-Type': 'application/json'};
  const token = sessionStorage.getItem(TOKEN);
  if (token) headers.Authorization = `Bearer ${token}`;
  try {
    const url = `/act/${encodeURIComponent(machine)}/${encodeURIComponent(action)}`;
    return await told(await fetch(url, {method: 'POST', headers, body: JSON.stringify(body)}));
  } catch (error) {
    return {done: false, status: 0, says: `The server does not answer: ${error.message}.`};
  }
}

/** A dialog that asks, waits for the server, and shows what it says. */
class Question {
  constructor(title, effect, {fields = [], confirm = 'Confirm', askToken = false} = {}) {
    this.by = make('input', {id: 'act-by', autocomplete: 'name', required: true, maxlength: 80});
    this.by.value = localStorage.getItem(NAME) ?? '';
    this.token = make('input', {id: 'act-token', type: 'password', autocomplete: 'off', required: true});
    this.says = make('p', {class: 'says', role: 'alert'});
    this.confirm = make('button', {type: 'submit', class: 'strong', text: confirm});
    this.close = make('button', {type: 'button', class: 'quiet', text: 'Cancel'});
    this.form = make('form', {novalidate: true},
      make('h2', {id: 'act-title', text: title}),
      make('p', {id: 'act-effect', class: 'effect', text: effect}),
      ...fields,
      make('label', {}, make('span', {text: 'Your name'}), this.by),
      ...(askToken && !sessionStorage.getItem(TOKEN) ? [this.#tokenField()] : []),
      this.says,
      make('div', {class: 'buttons'}, this.close, this.confirm));
    this.dialog = make('dialog', {class: 'act', 'aria-labelledby': 'act-title',
      'aria-describedby': 'act-effect'}, this.form);
    this.close.addEventListener('click', () => this.dialog.close());
    this.dialog.addEventListener('close', () => this.dialog.remove());
    document.body.append(this.dialog);
  }

  #tokenField() {
    return make('label', {id: 'act-token-field'}, make('span', {text: 'Token of this server'}), this.token);
  }

  /** Show; `act(by)` returns the answer of the server, or null where an entry is to be mended. */
  open(act) {
    this.form.addEventListener('submit', async (event) => {
      event.preventDefault();
      const by = this.by.value.trim();
      if (!by) return this.#refuse('Your name is needed: it is written into the recording.', this.by);
      if (this.token.isConnected) {
        if (!this.token.value.trim()) return this.#refuse('The token is needed once.', this.token);
        sessionStorage.setItem(TOKEN, this.token.value.trim());
      }
      localStorage.setItem(NAME, by);
      this.confirm.disabled = true;
      this.#tell('wait', '… asked; the machine has not answered yet');
      const answer = await act(by, (text, element) => this.#refuse(text, element));
      this.confirm.disabled = false;
      if (answer) this.#show(answer);
      return undefined;
    });
    this.dialog.showModal();
    const [first] = [...this.form.elements].filter((item) => item.matches('input') && !item.value);
    (first ?? this.close).focus();
  }

  #tell(done, text) {
    this.says.dataset.done = done;
    this.says.textContent = text;
  }

  #refuse(text, element) {
    this.#tell('false', text);
    element?.focus();
  }

  #show(answer) {
    this.#tell(String(Boolean(answer.done)), (answer.done ? '✓ ' : '✕ ') + answer.says);
    if (answer.status === 401 || answer.status === 403) {
      sessionStorage.removeItem(TOKEN);
      this.token.value = '';
      if (!this.token.isConnected) this.says.before(this.#tokenField());
      this.token.focus();
    } else if (answer.done) {
      this.confirm.remove();
      this.close.textContent = 'Close';
      this.close.focus();
    } else {
      this.confirm.textContent = 'Try again';
      this.close.textContent = 'Close';
    }
  }
}

function ask(context, title, effect, action, body, options = {}) {
  const question = new Question(title, effect, {...options, askToken: context.needsToken});
  question.open((by) => request(context.machine, action, {...body, by}));
}

function offsetsNow({axes}) {
  const parts = axes.map(({axis, offset}) => `${axis} ${micrometres(offset, {signed: true})}`);
  return parts.join(', ') || 'none';
}

/** Ask for a reference; where offsets are in force the server wants to be asked twice. */
function setReference(context) {
  const {machine, view, needsToken} = context;
  const question = new Question(`Set the thermal reference of ${machine}`,
    `The present temperatures of ${machine} become its thermal zero: from then on the predicted `
    + `error counts from here. Do this at a machine in thermal equilibrium. Offsets in force: `
    + `${offsetsNow(view)}.`, {confirm: 'Set reference', askToken: needsToken});
  question.open(async (by) => {
    const answer = await request(machine, 'reference', {by, force: false});
    if (answer.needs !== 'force') return answer;
    question.dialog.close();
    ask(context, `Offsets are in force on ${machine}: set the reference all the same?`,
      answer.says, 'reference', {force: true}, {confirm: 'Set it all the same'});
    return null;
  });
}

function activate(context) {
  const {machine, view} = context;
  const wanted = view.axes.map(({axis, requested, predicted}) => (
    `${axis} ${micrometres(requested ?? (predicted === null ? null : -predicted), {signed: true})}`));
  ask(context, `Activate the compensation of ${machine}`,
    `The machine ${machine} begins to add offsets to its axes, within their limits of size and `
    + `rate. Wanted now: ${wanted.join(', ') || 'none'}.`,
    'activate', {node: 'compensator'}, {confirm: 'Activate'});
}

function deactivate(context) {
  const {machine, view} = context;
  ask(context, `Deactivate the compensation of ${machine}`,
    `The offsets of ${machine} ramp to zero, they do not step. Its thermal error is no longer `
    + `compensated. In force now: ${offsetsNow(view)}.`,
    'deactivate', {node: 'compensator'}, {confirm: 'Deactivate'});
}

/** Return the number in a field [um] in metres; null for an empty one, NaN for anything else. */
function entered(input) {
  const text = input.value.trim().replace(',', '.').replace('\u2212', '-');
  return text === '' ? null : (/^[+-]?(\d+\.?\d*|\.\d+)$/.test(text) ? Number(text) * 1e-6 : NaN);
}

function probe(context) {
  const {machine, view, needsToken} = context;
  const line = (name, label) => {
    const input = make('input', {inputmode: 'decimal', autocomplete: 'off', data: {probe: name}});
    return {name, input, label: make('label', {}, make('span', {text: label}), input)};
  };
  const axes = view.axes.map(({axis}) => line(axis, `${axis}: measured error [µm]`));
  const spread = line('deviation', 'Standard deviation of the probe [µm], if known');
  const question = new Question(`Enter a probe of ${machine}`,
    `The predictor of ${machine} compares its prediction with what was measured and corrects itself. `
    + `Error = actual minus nominal position of the tool, with sign. Empty: not measured.`,
    {fields: [...axes, spread].map(({label}) => label), confirm: 'Enter probe', askToken: needsToken});
  question.open((by, refuse) => {
    const values = {};
    for (const {name, input} of [...axes, spread]) {
      const value = entered(input);
      if (Number.isNaN(value) || (name === 'deviation' && value !== null && value <= 0)) {
        refuse(`${name}: expected ${name === 'deviation' ? 'a positive number' : 'a number'} in µm `
          + `but found "${input.value}".`, input);
        return null;
      }
      if (value !== null) values[name] = value;
    }
    const {deviation = null, ...measured} = values;
    if (!Object.keys(measured).length) {
      refuse('No axis has a value: enter at least one.', axes[0]?.input);
      return null;
    }
    return request(machine, 'probe', {values: measured, deviation, by});
  });
}

const FORGOTTEN = [
  ['undo', 'The last probe was false: back to what was known before it'],
  ['widen', 'The machine has changed: what was learnt counts for less'],
  ['all', 'Begin from nothing, as on the first day'],
];

function forget(context) {
  const {machine, needsToken} = context;
  const modes = FORGOTTEN.map(([mode, text]) => make('label', {class: 'choice'},
    make('input', {type: 'radio', name: 'mode', value: mode, data: {mode}}), make('span', {text})));
  const why = make('input', {autocomplete: 'off', maxlength: 200, data: {why: ''}});
  const question = new Question(`Let ${machine} forget`,
    `The predictor of ${machine} knows less of the thermal error than probes have taught it, and `
    + 'asks for a probe. Its band is wider until then; offsets do not step.',
    {fields: [...modes, make('label', {}, make('span', {text: 'Reason, such as "new spindle"'}), why)],
      confirm: 'Forget', askToken: needsToken});
  question.open((by, refuse) => {
    const mode = modes.map(({firstChild}) => firstChild).find(({checked}) => checked)?.value;
    if (!mode) {
      refuse('Choose what is forgotten.', modes[0].firstChild);
      return null;
    }
    if (!why.value.trim()) {
      refuse('A reason is needed: it is written into the recording.', why);
      return null;
    }
    return request(machine, 'forget', {mode, why: why.value.trim(), by});
  });
}

function record(context) {
  const {machine, view} = context;
  const active = Boolean(view.recording?.active);
  ask(context, `${active ? 'Stop' : 'Start'} recording ${machine}`,
    active ? `The bag ${view.recording.bag} is closed; what comes after is not recorded.`
      : `Everything that the nodes of ${machine} say is written into a new bag, until it is stopped.`,
    'record', {start: !active}, {confirm: active ? 'Stop recording' : 'Start recording'});
}

const ACTS = [
  ['reference', 'Set reference…', setReference],
  ['activate', 'Activate…', activate],
  ['deactivate', 'Deactivate…', deactivate],
  ['probe', 'Enter probe…', probe],
  ['forget', 'Forget…', forget],
  ['record', 'Start recording…', record],
];

/** Make the buttons; `context()` returns machine, view and whether a token is needed. */
export function buildActions(container, context) {
  for (const [name, text, open] of ACTS) {
    const button = make('button', {type: 'button', text, data: {act: name}});
    button.addEventListener('click', () => open(context()));
    container.append(button);
  }
  container.append(make('p', {id: 'no-recording',
    text: 'Recording needs a folder: set the parameter bags of dashboard.'}));
}

/** Show which acts make sense now; the server judges for itself. */
export function showActions(container, view, {writable, recordable}) {
  container.hidden = !writable;
  const button = (name) => container.querySelector(`[data-act="${name}"]`);
  const node = view?.nodes.find(({name}) => name === 'compensator');
  for (const [name] of ACTS) button(name).disabled = !view;
  container.querySelector('#no-recording').hidden = recordable;
  if (!view) return;
  button('activate').disabled = ['active', 'finalized'].includes(node?.lifecycle);
  button('deactivate').disabled = ['inactive', 'finalized'].includes(node?.lifecycle);
  button('forget').disabled = !view.probing;
  button('record').disabled = !(recordable || view.recording?.active);
  button('record').textContent = view.recording?.active ? 'Stop recording…' : 'Start recording…';
}

/** Close any question that is open: it is about a machine that is no longer shown. */
export function closeQuestions() {
  for (const dialog of document.querySelectorAll('dialog.act')) dialog.close();
}
