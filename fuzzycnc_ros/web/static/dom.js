// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Elements. Whatever a server says becomes text here, never markup.

/** Make an element; `text` is text, `data` its data attributes, the rest attributes. */
export function make(tag, {text, data = {}, ...attributes} = {}, ...children) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  Object.assign(element.dataset, data);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) element.setAttribute(name, '');
    else if (value !== false && value !== null) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** Set the text of an element, if it differs: unchanged text is not read out again. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Set the text of the field of that name below an element. */
export function field(root, name, text) {
  say(root.querySelector(`[data-field="${CSS.escape(name)}"]`), text);
}

/** Make the children of an element match items: those with the same key stay where they are. */
export function match(parent, items, key, build, update = () => {}) {
  const old = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  let before = parent.firstElementChild;
  for (const item of items) {
    const name = String(key(item));
    let child = old.get(name);
    if (child) {
      old.delete(name);
    } else {
      child = build(item);
      child.dataset.key = name;
    }
    if (child === before) before = before.nextElementSibling;
    else parent.insertBefore(child, before);
    update(child, item);
  }
  for (const child of old.values()) child.remove();
}

/** Make a table of a caption and headings {label, numeric}, without rows. */
export function table(caption, headings) {
  const head = make('tr', {}, ...headings.map(
    ({label, numeric}) => make('th', {text: label, scope: 'col', class: numeric ? 'number' : 'text'}),
  ));
  return make('table', {}, make('caption', {text: caption}), make('thead', {}, head), make('tbody'));
}

/** Make a row of empty cells; each knows its heading, which narrow screens show beside it. */
export function row(headings) {
  return make('tr', {}, ...headings.map(
    ({label, numeric}) => make('td', {class: numeric ? 'number' : 'text', data: {label}}),
  ));
}
