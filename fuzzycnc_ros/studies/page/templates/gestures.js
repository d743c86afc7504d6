// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// What a hand does over a plot: the wheel with Ctrl, keys, two fingers. One finger scrolls the page.
// A view takes `zoom(factor, at)`, `shift(by)`, which says whether it moved, and `whole()`; places
// and ways are shares of the plot, from its upper left corner.
const gestures = (() => {
  'use strict';
  const KEY_ZOOM = 1.5;
  const KEY_SHIFT = 0.15;
  const WHEEL = 240; // pixels of the wheel that double
  const LINE = 33; // pixels of a line, for wheels that count lines
  const TAP = 350; // ms from one tap to the next
  const NEAR = 24; // pixels that a finger may move in a tap
  const MIDDLE = {x: 0.5, y: 0.5};
  const ARROWS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};

  function onKey(event, view) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const arrow = ARROWS[event.key];
    if (event.key === '+' || event.key === '=') view.zoom(KEY_ZOOM, MIDDLE);
    else if (event.key === '-') view.zoom(1 / KEY_ZOOM, MIDDLE);
    else if (event.key === '0') view.whole();
    // Where there is nothing to move to, arrows scroll the page.
    else if (!arrow || !view.shift({x: KEY_SHIFT * arrow[0], y: KEY_SHIFT * arrow[1]})) return;
    event.preventDefault();
  }

  return (over, view, name) => {
    const placeOf = (x, y) => {
      const box = over.getBoundingClientRect();
      return {x: (x - box.left) / box.width, y: (y - box.top) / box.height};
    };
    over.tabIndex = 0;
    over.setAttribute('role', 'group');
    over.setAttribute('aria-label', `${name}: plus and minus zoom, arrows move, 0 shows all`);
    over.addEventListener('keydown', event => onKey(event, view));
    over.addEventListener('wheel', event => {
      if (!event.ctrlKey) return; // the page scrolls
      event.preventDefault();
      const way = event.deltaMode === 1 ? LINE * event.deltaY : event.deltaY;
      view.zoom(2 ** Math.max(-1, Math.min(1, -way / WHEEL)), placeOf(event.clientX, event.clientY));
    }, {passive: false});

    let pair = null; // two fingers: their middle, and how far they are apart
    let tap = null; // one finger that has not moved
    let before = null; // the tap before
    const pairOf = ([a, b]) => ({
      at: placeOf((a.clientX + b.clientX) / 2, (a.clientY + b.clientY) / 2),
      apart: Math.max(Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY), 1),
    });
    const apart = (a, b) => Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
    over.addEventListener('touchstart', event => {
      const two = event.targetTouches.length === 2;
      pair = two ? pairOf(event.targetTouches) : null;
      tap = event.touches.length === 1 ? event.touches[0] : null;
      if (two) event.preventDefault();
    }, {passive: false});
    over.addEventListener('touchmove', event => {
      if (tap && apart(tap, event.touches[0]) > NEAR) tap = null;
      if (!pair || event.targetTouches.length !== 2) return;
      event.preventDefault();
      const now = pairOf(event.targetTouches);
      view.zoom(now.apart / pair.apart, pair.at);
      view.shift({x: pair.at.x - now.at.x, y: pair.at.y - now.at.y});
      pair = now;
    }, {passive: false});
    over.addEventListener('touchend', event => {
      pair = null;
      if (!tap) {
        before = null;
        return;
      }
      const again = before && event.timeStamp - before.time < TAP && apart(before.tap, tap) < NEAR;
      before = again ? null : {tap, time: event.timeStamp};
      tap = null;
      if (!again) return;
      event.preventDefault(); // it is no double-click as well
      view.whole();
    }, {passive: false});
    over.addEventListener('touchcancel', () => { pair = tap = before = null; });
  };
})();
