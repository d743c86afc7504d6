// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Numbers as they are read off figures and written beside their axes.
const reading = (() => {
  'use strict';

  // Numbers come as whole multiples of a decimal place, each less the one before it.
  function decoded({decimals, steps}) {
    const unit = 10 ** Math.abs(decimals);
    let sum = 0;
    return steps.map(step => {
      if (step === null) return null;
      sum += step;
      return decimals < 0 ? sum * unit : sum / unit;
    });
  }

  function plain(value) {
    const size = Math.abs(value);
    if (size !== 0 && (size >= 1e6 || size < 1e-5)) return value.toExponential(2);
    return String(Number(value.toPrecision(6)));
  }

  // What is read off: as many decimals as the data tell apart, three at most behind whole numbers.
  function readable(value, decimals) {
    if (value === null || value === undefined) return '–';
    const size = Math.abs(value);
    const most = size >= 100 ? 1 : size >= 1 ? 2 : 4;
    if (size !== 0 && (size >= 1e6 || size < 1e-4)) return value.toExponential(2);
    return value.toFixed(Math.max(0, Math.min(decimals, most)));
  }

  const withUnit = (text, unit) => (unit && text !== '–' ? `${text} ${unit}` : text);

  // Plain numbers on a logarithmic axis: all of a decade where there is room, else 1, 2 and 5.
  function decades(low, high) {
    const span = Math.log10(high / low);
    const every = span < 0.6 ? [1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9] : span < 3 ? [1, 2, 5] : [1];
    const found = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++)
      for (const step of every) {
        const tick = Number((step * 10 ** power).toPrecision(3));
        if (tick >= low && tick <= high) found.push(tick);
      }
    return found;
  }

  // Round numbers between two others, no more than a few.
  function rounds(low, high, most) {
    const rough = (high - low) / Math.max(most, 1);
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find(times => times * power >= 0.999 * rough);
    const found = [];
    for (let i = Math.ceil(low / step); i * step <= high; i++)
      found.push(Number((i * step).toPrecision(12)));
    return found;
  }

  return {decoded, plain, readable, withUnit, decades, rounds};
})();
