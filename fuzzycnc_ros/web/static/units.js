// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Numbers in SI become text in the reader's units. Unknown is a dash, never a zero.

export const UNKNOWN = '–';
const GAP = '\u00a0';
const MINUS = '\u2212';

function known(value) {
  return typeof value === 'number' && Number.isFinite(value);
}

/** Return a number with a fixed count of digits; a rounded zero has no sign. */
export function number(value, digits = 0, signed = false) {
  if (!known(value)) return UNKNOWN;
  const text = Math.abs(value).toFixed(digits);
  if (Number(text) === 0) return text;
  return (value < 0 ? MINUS : signed ? '+' : '') + text;
}

/** Return a number with its unit. */
export function quantity(value, unit, digits = 0, signed = false) {
  return known(value) ? number(value, digits, signed) + GAP + unit : UNKNOWN;
}

/** Return a length [m] in micrometres. */
export function micrometres(metres, {signed = false, digits = 1} = {}) {
  return quantity(known(metres) ? metres * 1e6 : null, 'µm', digits, signed);
}

/** Return a position [m] in millimetres. */
export function millimetres(metres, digits = 3) {
  return quantity(known(metres) ? metres * 1e3 : null, 'mm', digits);
}

/** Return a rate [m/s] in micrometres a minute. */
export function rate(metresPerSecond) {
  return quantity(known(metresPerSecond) ? metresPerSecond * 6e7 : null, 'µm/min', 2, true);
}

/** Return a spindle speed [rad/s] in turns a minute. */
export function rpm(radiansPerSecond) {
  return quantity(known(radiansPerSecond) ? radiansPerSecond * 30 / Math.PI : null, 'rpm');
}

/** Return a share in percent. */
export function percent(share, digits = 0) {
  return quantity(known(share) ? share * 100 : null, '%', digits);
}

/** Return a span of time [s] as a person says it. */
export function duration(seconds) {
  if (!known(seconds)) return UNKNOWN;
  const whole = Math.round(seconds);
  if (Math.abs(seconds) < 9.95) return quantity(seconds, 's', 1);
  if (whole < 60) return quantity(whole, 's');
  if (whole < 3570) return quantity(Math.round(whole / 60), 'min');
  if (whole < 86400) {
    const minutes = Math.round(whole / 60);
    const rest = minutes % 60;
    return `${Math.floor(minutes / 60)}${GAP}h${rest ? `${GAP}${rest}${GAP}min` : ''}`;
  }
  return quantity(whole / 86400, 'd', 1);
}

/** Return a size of a file. */
export function bytes(count) {
  if (!known(count)) return UNKNOWN;
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  let size = count;
  let at = 0;
  while (size >= 999.5 && at < units.length - 1) {
    size /= 1000;
    at += 1;
  }
  return quantity(size, units[at], at && size < 99.95 ? 1 : 0);
}

/** Stamps [s] below are no dates: simulated machines count from their start. */
export const DATED = 1e9;

const two = (value) => String(value).padStart(2, '0');

/** Return a time since the start of a simulation [s] as hours, minutes and seconds. */
export function clock(time) {
  const whole = Math.floor(time);
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

/** Return a stamp [s since the epoch] as date and time of day of the reader. */
export function moment(stamp) {
  if (!known(stamp)) return UNKNOWN;
  if (stamp < DATED) return `${clock(stamp)}${GAP}h`;
  const at = new Date(stamp * 1000);
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} `
    + `${two(at.getHours())}:${two(at.getMinutes())}:${two(at.getSeconds())}`;
}
