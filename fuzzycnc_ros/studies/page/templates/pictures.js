// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Pictures that are zoomed into: a copy of the drawing for paper, of which each declared view shows
// a part of what lies between its axes, with ticks of its own (fuzzycnc_ros/studies/page/chart.py).
const pictures = (() => {
  'use strict';
  const {decades, decoded, plain, readable, rounds, withUnit} = reading;
  const SVG = 'http://www.w3.org/2000/svg';
  const SPAN_MIN = 0.02; // shown of an axis at least; places have no more digits
  const TICKS = {x: 70, y: 34}; // between ticks at least, in units of the drawing
  const GAP = 2; // between numbers and the name of an axis, in units of the drawing
  const MARGIN = 9; // that a name may stand beside the drawing, in its units
  const BESIDE = 8; // from a place to the words beside it at most, in units of the drawing
  const CLICK = 5; // pixels that a click may move
  const STRIP = 30; // pixels; a drag that is narrower is meant along its length only
  const ALL = {x: [0, 1], y: [0, 1]};
  const KEYS = ['x', 'y'];

  const element = (kind, name, parent) => {
    const made = document.createElement(kind);
    made.className = name;
    parent.append(made);
    return made;
  };

  // The drawing once more; on a page each name is given once.
  function copied(source, place) {
    place.innerHTML = source.outerHTML.replace(/(\bid="|url\((?:&quot;)?#|href="#)/g, '$1s-');
    return place.querySelector('svg');
  }

  const valueAt = (axis, share) =>
    axis.scale === 'log'
      ? axis.low * (axis.high / axis.low) ** share
      : axis.low + share * (axis.high - axis.low);

  const shareOf = (axis, value) =>
    axis.scale === 'log'
      ? Math.log(value / axis.low) / Math.log(axis.high / axis.low)
      : (value - axis.low) / (axis.high - axis.low);

  // Lines keep their width whatever the stretch; `--pixel` is a unit of the drawing in pixels.
  function keepWidths(inner) {
    for (const line of inner.querySelectorAll('path, line')) {
      if (line.closest('defs') || !line.style.stroke || line.style.stroke === 'none') continue;
      const width = parseFloat(line.style.strokeWidth || '1');
      line.style.vectorEffect = 'non-scaling-stroke';
      line.style.strokeWidth = `calc(${width}px * var(--pixel))`;
    }
  }

  // What is drawn between the axes of a view, moved into a frame of its own.
  function framed(group, [left, top, width, height]) {
    const data = [...group.children].filter(part =>
      !part.id.includes('matplotlib.axis') &&
      (part.matches('[clip-path]') || part.querySelector('[clip-path]')));
    const inner = document.createElementNS(SVG, 'svg');
    const place = {x: left, y: top, width, height, preserveAspectRatio: 'none'};
    for (const [name, value] of Object.entries(place)) inner.setAttribute(name, value);
    if (data.length) data[0].before(inner);
    inner.append(...data);
    keepWidths(inner);
    return inner;
  }

  const number = (node, name) => Number(node.getAttribute(name));

  // The name of an axis makes room for numbers that are longer than those on paper.
  function makeRoom(own, ticks) {
    const name = [...own.children].find(part => part.id.includes('text_'));
    if (!name) return;
    name.removeAttribute('transform');
    name.style.visibility = '';
    const numbers = [...ticks.querySelectorAll('text')].map(text => text.getBoundingClientRect().left);
    const pixel = own.ownerSVGElement.getScreenCTM()?.a;
    if (!numbers.length || !pixel) return;
    const room = Math.min(...numbers) / pixel - GAP;
    const box = name.getBoundingClientRect();
    const way = Math.min(0, room - box.right / pixel);
    name.setAttribute('transform', `translate(${way} 0)`);
    const edge = own.ownerSVGElement.getBoundingClientRect().left;
    if ((box.left - edge) / pixel + way < -MARGIN) name.style.visibility = 'hidden';
  }

  // The ticks of an axis, for any stretch of it: copies of its first one.
  function ticksOf(group, key, axis, [left, top, width, height]) {
    const letter = key === 'x' ? '1' : '2';
    const own = group.querySelector(`[id$="matplotlib.axis_${letter}"]`)
      ?? group.querySelectorAll('[id*="matplotlib.axis"]')[Number(letter) - 1];
    const drawn = [...own.children].filter(part => part.id.includes(`${key}tick_`));
    const first = drawn.find(part => part.querySelector('text') && part.querySelector('use'));
    const shown = document.createElementNS(SVG, 'g');
    own.append(shown);
    return ([low, high]) => {
      const whole = low === 0 && high === 1;
      for (const part of drawn) part.style.display = whole ? '' : 'none';
      shown.replaceChildren();
      if (key === 'y') makeRoom(own, shown);
      if (whole || !first) return;
      const ends = [valueAt(axis, low), valueAt(axis, high)].sort((a, b) => a - b);
      const length = key === 'x' ? width : height;
      let values = axis.scale === 'log' ? decades(...ends) : [];
      if (values.length < 3) values = rounds(...ends, length / TICKS[key]);
      const at = number(first.querySelector('use'), key);
      for (const value of values) {
        const share = (shareOf(axis, value) - low) / (high - low);
        const to = key === 'x' ? left + share * width : top + (1 - share) * height;
        const tick = first.cloneNode(true);
        for (const named of [tick, ...tick.querySelectorAll('[id]')]) named.removeAttribute('id');
        for (const used of tick.querySelectorAll('defs')) used.remove();
        tick.style.display = '';
        tick.setAttribute('transform',
          key === 'x' ? `translate(${to - at} 0)` : `translate(0 ${to - at})`);
        tick.querySelector('text').textContent = plain(value).replace('-', '−');
        shown.append(tick);
      }
      if (key === 'y') makeRoom(own, shown);
    };
  }

  // Words between the axes move with the place that they stand beside, and leave with it.
  function wordsOf(group, [left, top, width, height], spots) {
    return [...group.children]
      .filter(part => part.id.includes('text_') && part.querySelector('text'))
      .map(part => {
        const text = part.querySelector('text');
        return {part, x: number(text, 'x'), y: number(text, 'y')};
      })
      .filter(({x, y}) => x >= left && x <= left + width && y >= top && y <= top + height)
      .map(({part, x, y}) => {
        const beside = spots.find(spot => Math.hypot(spot.x - x, spot.y - y) < BESIDE);
        return {part, x: beside?.x ?? x, y: beside?.y ?? y};
      });
  }

  function spotsOf(view, table) {
    const across = decoded(view.across);
    const down = decoded(view.down);
    const [heads, ...rows] = view.read ?? table;
    return across.map((x, i) => ({
      x,
      y: down[i],
      text: () => heads
        .map((head, c) => [head, rows[view.rows[i]][c]])
        .filter(([, value]) => value !== '')
        .map(([head, value]) => {
          const [, name, unit] = /^(.*?)(?: \[(.*)\])?$/.exec(head);
          const shown = typeof value === 'number' ? plain(Number(value.toPrecision(4))) : value;
          return `${name} ${withUnit(shown, unit)}`;
        })
        .join(', '),
    }));
  }

  function viewOf(svg, view, table, over, told) {
    const [left, top, width, height] = view.box;
    const group = svg.querySelector(`[id$="-${view.id}"]`);
    const inner = framed(group, view.box);
    const free = KEYS.filter(key => !view[key].fixed);
    const ticks = free.map(key => [key, ticksOf(group, key, view[key], view.box)]);
    const marks = [...inner.querySelectorAll('use')].map(mark =>
      ({mark, x: number(mark, 'x'), y: number(mark, 'y')}));
    const spots = spotsOf(view, table);
    const words = wordsOf(group, view.box, spots);
    const dot = element('span', 'spot', over);
    const strip = element('span', 'strip', over);
    let shown = ALL; // shares of the axes, from their lower ends

    // Where a place of the drawing is now, as shares of the plot.
    const seen = ({x, y}) => ({
      x: ((x - left) / width - shown.x[0]) / (shown.x[1] - shown.x[0]),
      y: 1 - (1 - (y - top) / height - shown.y[0]) / (shown.y[1] - shown.y[0]),
    });
    const within = ({x, y}) => x >= 0 && x <= 1 && y >= 0 && y <= 1;

    function show(ends) {
      shown = ends;
      const [wide, high] = KEYS.map(key => shown[key][1] - shown[key][0]);
      const corner = [left + shown.x[0] * width, top + (1 - shown.y[1]) * height];
      inner.setAttribute('viewBox', [...corner, wide * width, high * height].join(' '));
      for (const {mark, x, y} of marks)
        mark.setAttribute('transform',
          `translate(${x * (1 - wide)} ${y * (1 - high)}) scale(${wide} ${high})`);
      for (const {part, x, y} of words) {
        const at = seen({x, y});
        part.style.display = within(at) ? '' : 'none';
        part.setAttribute('transform',
          `translate(${left + at.x * width - x} ${top + at.y * height - y})`);
      }
      for (const [key, draw] of ticks) draw(shown[key]);
      dot.hidden = true;
      told();
    }

    // `low` is where a stretch of a length begins; both stay on the axis.
    function moved(low, span) {
      const length = Math.min(Math.max(span, SPAN_MIN), 1);
      const begin = Math.max(0, Math.min(low, 1 - length));
      return [begin, begin + length];
    }
    // Shares of the plot that lie at a place, along the axis.
    const along = (key, at) => (key === 'x' ? at.x : 1 - at.y);

    const hand = {
      zoom(factor, at) {
        const ends = {...shown};
        for (const key of free) {
          const [low, high] = shown[key];
          const span = Math.min(Math.max((high - low) / factor, SPAN_MIN), 1);
          ends[key] = moved(low + along(key, at) * (high - low - span), span);
        }
        show(ends);
      },
      shift(by) {
        const ends = {...shown};
        for (const key of free) {
          const [low, high] = shown[key];
          const way = (key === 'x' ? by.x : -by.y) * (high - low);
          ends[key] = moved(low + way, high - low);
        }
        const far = free.some(key => Math.abs(ends[key][0] - shown[key][0]) > 1e-9);
        if (far) show(ends);
        return far;
      },
      whole: () => show(ALL),
    };
    gestures(over, hand, view.title || 'plot');
    over.addEventListener('dblclick', hand.whole);

    // Zoom to what lies between two places.
    function zoomTo(a, b) {
      const size = {x: over.clientWidth, y: over.clientHeight};
      const ways = Object.fromEntries(KEYS.map(key => [key, Math.abs(a[key] - b[key])]));
      let keys = free;
      const narrow = KEYS.filter(key => ways[key] * size[key] < STRIP);
      if (view.together) ways.x = ways.y = Math.max(ways.x, ways.y);
      else if (narrow.length === 1 && free.length === 2)
        keys = free.filter(key => key !== narrow[0]);
      const ends = {...shown};
      for (const key of keys) {
        const [low, high] = shown[key];
        const span = Math.max(ways[key] * (high - low), SPAN_MIN);
        const middle = (along(key, a) + along(key, b)) / 2;
        ends[key] = moved(low + middle * (high - low) - span / 2, span);
      }
      show(ends);
    }

    const placeOf = event => {
      const box = over.getBoundingClientRect();
      const share = (at, low, size) => Math.max(0, Math.min(1, (at - low) / size));
      return {
        x: share(event.clientX, box.left, box.width),
        y: share(event.clientY, box.top, box.height),
      };
    };
    let begin = null;
    const dragged = event => {
      const now = placeOf(event);
      const [x, y] = KEYS.map(key => Math.min(begin[key], now[key]));
      Object.assign(strip.style, {
        left: `${100 * x}%`,
        top: `${100 * y}%`,
        width: `${100 * Math.abs(begin.x - now.x)}%`,
        height: `${100 * Math.abs(begin.y - now.y)}%`,
      });
      return now;
    };
    over.addEventListener('pointerdown', event => {
      if (event.pointerType !== 'mouse' || event.button !== 0) return;
      begin = placeOf(event);
      over.setPointerCapture(event.pointerId);
    });
    over.addEventListener('pointermove', event => { if (begin) dragged(event); });
    const dropped = event => {
      if (!begin) return;
      const [first, last] = [begin, dragged(event)];
      begin = null;
      strip.removeAttribute('style');
      const far = Math.hypot((first.x - last.x) * over.clientWidth,
        (first.y - last.y) * over.clientHeight);
      if (event.type === 'pointerup' && far > CLICK) zoomTo(first, last);
    };
    over.addEventListener('pointerup', dropped);
    over.addEventListener('pointercancel', dropped);

    // The nearest place is read; among bars, that of the nearest name.
    over.addEventListener('mousemove', event => {
      const at = placeOf(event);
      let best = null;
      for (const spot of spots) {
        const place = seen(spot);
        const away = Math.hypot(
          (place.x - at.x) * over.clientWidth * (view.y.fixed ? 1e-3 : 1),
          (place.y - at.y) * over.clientHeight * (view.x.fixed ? 1e-3 : 1),
        );
        if (!best || away < best.away) best = {away, place, spot};
      }
      dot.hidden = !best || !within(best.place);
      if (!best) return;
      dot.style.left = `${100 * best.place.x}%`;
      dot.style.top = `${100 * best.place.y}%`;
      told(`nearest: ${best.spot.text()}`);
    });
    over.addEventListener('mouseleave', () => {
      dot.hidden = true;
      told('');
    });

    show(ALL);
    // What is shown, in words; nothing while it is all.
    return () => free
      .filter(key => shown[key][1] - shown[key][0] < 1)
      .map(key => {
        const axis = view[key];
        const ends = shown[key].map(share => valueAt(axis, share)).sort((a, b) => a - b);
        const places = Math.max(0, 2 - Math.floor(Math.log10(ends[1] - ends[0])));
        const [low, high] = ends.map(end => readable(end, places));
        return `${axis.name || key} ${low} to ${withUnit(high, axis.unit)}`;
      })
      .join(', ');
  }

  // Show a picture and let it be zoomed into.
  function live(figure, {table, views}, screen) {
    const place = element('div', 'panel', screen);
    const drawing = element('div', 'drawing', element('div', 'wide', place));
    const svg = copied(figure.querySelector('.paper svg'), drawing);
    const nearest = element('p', 'nearest', place);
    const stretch = element('p', 'nearest', place);
    const [, , across, down] = svg.getAttribute('viewBox').split(' ').map(Number);
    const all = [];
    function told(text) {
      if (text !== undefined) {
        nearest.textContent = text;
        return;
      }
      const found = views
        .map((view, i) => [views.length > 1 && view.title, all[i]?.()])
        .filter(([, words]) => words)
        .map(([title, words]) => (title ? `${title}: ${words}` : words));
      stretch.textContent = found.length ? `Shown: ${found.join('; ')}` : '';
    }
    views.forEach((view, i) => {
      // Panels side by side name an axis once.
      for (const key of KEYS)
        if (!view[key].name && i > 0)
          Object.assign(view[key], {name: views[i - 1][key].name, unit: views[i - 1][key].unit});
      const over = element('div', 'over', drawing);
      const [left, top, width, height] = view.box;
      Object.assign(over.style, {
        left: `${(100 * left) / across}%`,
        top: `${(100 * top) / down}%`,
        width: `${(100 * width) / across}%`,
        height: `${(100 * height) / down}%`,
      });
      all.push(viewOf(svg, view, table, over, told));
    });
    new ResizeObserver(() => {
      drawing.style.setProperty('--pixel', svg.clientWidth / across || 1);
    }).observe(svg);
  }

  return {live};
})();
