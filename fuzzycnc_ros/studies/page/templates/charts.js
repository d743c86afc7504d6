// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Charts that are zoomed into, read under the cursor and saved as CSV; what they hold is declared in
// fuzzycnc_ros/studies/page/chart.py.
/* global uPlot, gestures */
(() => {
  'use strict';
  const DOTS_MAX = 140;
  const SHARE_MIN = 5e-4; // of a whole axis that is shown at least
  const PIXELS = 84; // of an inch of a declared height
  const TRUE = 96 / 25.4; // pixels of a millimetre
  const SHEET = 190; // width that a sheet of A4 has within its margins [mm]
  const CLICK = 5; // pixels that a click may move
  const PAPER = 660; // pixels of the width of a figure on paper
  const FONT = 'px system-ui, sans-serif';

  const colour = name =>
    name.startsWith('--')
      ? getComputedStyle(document.documentElement).getPropertyValue(name).trim()
      : name;
  const faded = hex => (/^#[0-9a-f]{6}$/i.test(hex) ? `${hex}66` : hex);
  const withUnit = (text, unit) => (unit && text !== '–' ? `${text} ${unit}` : text);

  const element = (kind, name, parent, text = '') => {
    const made = document.createElement(kind);
    made.className = name;
    made.textContent = text;
    parent.append(made);
    return made;
  };

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

  // Give a panel its columns: x, series, then the edges of bands.
  function unpacked(panel) {
    if (panel.plane) {
      for (const item of panel.series) {
        item.places = [item.x.decimals, item.y.decimals];
        for (const key of ['x', 'y', 'level']) item[key] = item[key] && decoded(item[key]);
      }
      return;
    }
    panel.columns = [decoded(panel.x), ...panel.series.map(item => decoded(item.y))];
    panel.places = [panel.x.decimals, ...panel.series.map(item => item.y.decimals)];
    for (const band of panel.bands)
      for (const side of ['low', 'high']) {
        panel.columns.push(decoded(band[side]));
        panel.places.push(band[side].decimals);
      }
  }

  function scaleOf(axis, time) {
    const scale = {time: false, auto: true};
    if (axis.scale === 'log') scale.distr = 3;
    if (axis.scale === 'symlog') Object.assign(scale, {distr: 4, asinh: axis.linear_to});
    scale.range = (u, low, high) => {
      if (low === null || low === undefined) return [axis.low ?? 0, axis.high ?? 1];
      const ratio = axis.scale === 'log';
      let [a, b] = [low, high];
      if (!time) {
        const room = ratio ? (b / a) ** 0.06 : 0.08 * (b - a) || Math.abs(b) || 1;
        const wide = axis.scale === 'symlog';
        a = ratio ? a / room : wide ? Math.min(1.6 * a, -1.5 * axis.linear_to) : a - room;
        b = ratio ? b * room : wide ? Math.max(1.6 * b, 1.5 * axis.linear_to) : b + room;
      }
      return [axis.low ?? a, axis.high ?? b];
    };
    return scale;
  }

  // What both kinds of panels share: their size, place of the cursor, axes.
  function axesOf(x, y) {
    const marks = (axis, key) => {
      const places = axis.ticks.length
        ? (low, high) => axis.ticks.filter(tick => tick >= low && tick <= high)
        : axis.scale === 'log' ? decades : null;
      if (!places) return {};
      // Where a scale is dense some numbers give way.
      const apart = (u, found) => {
        let last = Infinity;
        return found.filter(value => {
          const at = key === 'y' ? u.valToPos(value, 'y') : 0;
          if (key === 'y' && Math.abs(at - last) < 11) return false;
          last = at;
          return true;
        });
      };
      return {
        splits: (u, i, low, high) => apart(u, places(low, high)),
        filter: (u, splits) => splits,
      };
    };
    const axisOf = (axis, key) => ({
      stroke: colour('--muted'),
      grid: {stroke: colour('--grid'), width: 1},
      ticks: {stroke: colour('--faint'), width: 1, size: 4},
      font: `12${FONT}`,
      labelFont: `12${FONT}`,
      labelSize: 18,
      values: (u, splits) => splits.map(value => (value === null ? '' : plain(value))),
      ...marks(axis, key),
    });
    return [
      {...axisOf(x, 'x'), label: x.label, size: 34},
      {
        ...axisOf(y, 'y'),
        space: 22,
        size: (u, values) => 14 + 7 * Math.max(2, ...(values || []).map(value => value.length)),
      },
    ];
  }

  // The name of a y axis stands above it, where there is room for all of it.
  function headOf(panel, place) {
    const head = element('p', 'head', place);
    if (panel.title) element('b', '', head, panel.title);
    element('span', '', head, panel.y.label);
  }

  const paper = matchMedia('print');
  const widthOf = (chart, place) => Math.max(120, paper.matches
    ? Math.min(place.clientWidth, (PAPER + 18) / chart.columns - 18) : place.clientWidth);
  const heightOf = (chart, panel) =>
    Math.round(Math.max(PIXELS * chart.height * panel.share, 180));

  // Of many dots some are shown; zooming in shows the rest.
  const someDots = (u, index, show) => {
    if (show === false) return [];
    const [first, last] = u.series[0].idxs;
    const values = u.data[index];
    const found = [];
    for (let i = first; i <= last; i++) if (values[i] !== null) found.push(i);
    const every = Math.max(1, Math.floor(found.length / DOTS_MAX));
    return found.filter((_, i) => i % every === 0);
  };

  function seriesOf(item, axis, decimals) {
    const flag = item.kind === 'flag';
    const dots = item.kind === 'dots' || item.kind === 'both';
    const stroke = colour(item.colour);
    const shown = {
      label: item.name,
      stroke: item.quiet ? faded(stroke) : stroke,
      width: item.quiet ? 0.8 : item.width,
      dash: item.dashes.map(length => 1.4 * length),
      spanGaps: item.joined,
      points: {show: dots, size: 5, fill: stroke, width: 0},
      value: (u, value) =>
        u.cursor.idx == null ? '' : flag ? (value ? 'yes' : value === 0 ? 'no' : '–')
          : withUnit(readable(value, decimals), axis.unit),
    };
    if (dots) shown.points.filter = someDots;
    if (flag || item.kind === 'dots') shown.paths = () => null;
    if (item.kind === 'steps') shown.paths = uPlot.paths.stepped({align: 1});
    if (flag) Object.assign(shown, {scale: 'flag', width: 4});
    return shown;
  }

  // Draw between the axes; `ratio` is a pixel of the page in those of the canvas.
  function within(u, font, draw) {
    const {ctx, bbox} = u;
    const ratio = devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.font = font.replace(/(\d+)px/, (_, size) => `${size * ratio}px`);
    ctx.textAlign = 'left';
    ctx.textBaseline = 'alphabetic';
    draw(ctx, bbox, ratio);
    ctx.restore();
  }

  const drawRules = (u, panel) => within(u, `11${FONT}`, (ctx, bbox, ratio) => {
    for (const span of panel.spans) {
      const [from, to] = [span.low, span.high].map(end => u.valToPos(end, 'x', true));
      ctx.fillStyle = `${colour(span.colour)}24`;
      ctx.fillRect(from, bbox.top, to - from, bbox.height);
      ctx.fillStyle = colour('--muted');
      // A name that does not fit waits until a reader zooms in.
      const room = to - Math.max(from, bbox.left) - 4 * ratio;
      if (ctx.measureText(span.name).width < room)
        ctx.fillText(span.name, Math.max(from, bbox.left) + 3 * ratio, bbox.top + 12 * ratio);
    }
    for (const rule of panel.rules) {
      const at = Math.round(u.valToPos(rule.at, rule.upright ? 'x' : 'y', true));
      ctx.strokeStyle = colour(rule.colour);
      ctx.lineWidth = 1.2 * ratio;
      ctx.setLineDash(rule.dashes.map(length => 1.4 * ratio * length));
      ctx.beginPath();
      if (rule.upright) {
        ctx.moveTo(at, bbox.top);
        ctx.lineTo(at, bbox.top + bbox.height);
      } else {
        ctx.moveTo(bbox.left, at);
        ctx.lineTo(bbox.left + bbox.width, at);
      }
      ctx.stroke();
      if (!rule.name) continue;
      ctx.fillStyle = colour('--muted');
      // A name stands on the side of its line where there is room for it.
      const size = ctx.measureText(rule.name).width + 4 * ratio;
      const beside = at + size < bbox.left + bbox.width ? at + 4 * ratio : at - size;
      const above = at - 16 * ratio > bbox.top ? at - 4 * ratio : at + 13 * ratio;
      if (rule.upright) ctx.fillText(rule.name, beside, bbox.top + 12 * ratio);
      else ctx.fillText(rule.name, bbox.left + 4 * ratio, above);
    }
  });

  const drawMarks = (u, panel) => within(u, `600 12${FONT}`, (ctx, bbox, ratio) => {
    const xs = u.data[0];
    const taken = [];
    // A name stands on the first side of its dot where no other one stands.
    function name(text, x, y) {
      const [width, height] = [ctx.measureText(text).width, 12 * ratio];
      const right = x + 6 * ratio;
      const left = x - 6 * ratio - width;
      const [above, below] = [y - 5 * ratio, y + 13 * ratio];
      const free = [[right, above], [left, above], [right, below], [left, below]].find(([a, b]) =>
        a >= bbox.left && a + width <= bbox.left + bbox.width && b - height >= bbox.top
        && b <= bbox.top + bbox.height && taken.every(other =>
          a > other.right || a + width < other.left || b - height > other.below
          || b < other.above));
      if (!free) return;
      taken.push({left: free[0], right: free[0] + width, above: free[1] - height, below: free[1]});
      ctx.fillText(text, ...free);
    }
    panel.series.forEach((item, index) => {
      const values = u.data[index + 1];
      if (item.kind === 'flag') {
        // Each sample stands for the time half-way to its neighbours, so that one alone shows too.
        const edge = i => u.valToPos(i < 0 ? xs[0] : i > xs.length - 2 ? xs[xs.length - 1]
          : 0.5 * (xs[i] + xs[i + 1]), 'x', true);
        ctx.fillStyle = colour(item.colour);
        const height = Math.max(4 * ratio, 0.03 * bbox.height);
        for (let i = 0; i < xs.length; i++) {
          if (!values[i]) continue;
          let last = i;
          while (values[last + 1]) last++;
          const [left, right] = [edge(i - 1), edge(last)];
          ctx.fillRect(left, bbox.top + bbox.height - height, Math.max(right - left, 1), height);
          i = last;
        }
      }
      ctx.fillStyle = colour('--ink');
      item.text.forEach((text, i) => {
        if (text && values[i] !== null)
          name(text, u.valToPos(xs[i], 'x', true), u.valToPos(values[i], 'y', true));
      });
    });
  });

  // Of the many in the background the nearest is named.
  function nearestQuiet(u, panel, axis) {
    const {idx, top} = u.cursor;
    if (idx === null || idx === undefined || top < 0) return '';
    let best = null;
    panel.series.forEach((item, index) => {
      const value = u.data[index + 1][idx];
      if (!item.quiet || value === null || value === undefined) return;
      const away = Math.abs(u.valToPos(value, 'y') - top);
      if (best === null || away < best.away) best = {away, item, value};
    });
    if (best === null) return '';
    const text = withUnit(readable(best.value, best.item.y.decimals), axis.unit);
    return `nearest: ${best.item.name} ${text}`;
  }

  // What gestures do to a plot; `kin` gives all plots that show the same stretch.
  function viewOf(u, keys, kin, whole) {
    const size = key => (key === 'x' ? u.over.clientWidth : u.over.clientHeight);
    const all = Object.fromEntries(keys.map(key => [key, [u.scales[key].min, u.scales[key].max]]));
    // The ends of the whole axis, as shares of what is shown; from the left, and from the top.
    const limits = key => all[key].map(end => u.valToPos(end, key) / size(key)).sort((a, b) => a - b);
    const inOrder = (a, b) => a - b;

    // Show what lies from `low` on, a share `span` of what is shown now, within the whole.
    function stretchOf(key, low, span) {
      const [least, most] = limits(key);
      const length = Math.min(span, most - least);
      const begin = Math.max(least, Math.min(low, most - length));
      return {begin, ends: [begin, begin + length]
        .map(share => u.posToVal(share * size(key), key)).sort(inOrder)};
    }
    function show(stretches) {
      for (const plot of kin())
        plot.batch(() => {
          for (const [key, {ends: [min, max]}] of stretches) plot.setScale(key, {min, max});
        });
    }
    return {
      zoom(factor, at) {
        const share = keys.map(key => 1 / factor / (limits(key)[1] - limits(key)[0]));
        if (share.every(part => part > 0.999)) whole();
        else if (factor < 1 || share.every(part => part > SHARE_MIN))
          show(keys.map(key => [key, stretchOf(key, at[key] * (1 - 1 / factor), 1 / factor)]));
      },
      shift(by) {
        const stretches = keys.map(key => [key, stretchOf(key, by[key], 1)]);
        const far = stretches.some(([, {begin}]) => Math.abs(begin) > 1e-6);
        if (far) show(stretches);
        return far;
      },
      whole,
    };
  }

  function chartOf(panel, one, place) {
    const {chart, key} = one;
    const {x, linked} = chart;
    const quiet = panel.series.some(item => item.quiet);
    const course = panel.series.some(item => item.kind === 'line' || item.kind === 'steps');
    headOf(panel, place);
    let whole = '';
    const sizeOf = () =>
      ({width: widthOf(chart, place), height: heightOf(chart, panel)});
    const edges = panel.bands.flatMap(band => ['low', 'high'].map(side => ({
      label: band.name,
      stroke: 'transparent',
      width: 0,
      points: {show: false},
      value: (u, value, index, row) => {
        if (u.cursor.idx == null) return '';
        const low = readable(row === null ? null : u.data[index - 1][row], band.low.decimals);
        const text = `${low} to ${readable(value, band.high.decimals)}`;
        return value === null || value === undefined ? '–' : withUnit(text, panel.y.unit);
      },
    })));
    const first = 1 + panel.series.length;
    const note = element('p', 'nearest', place);
    const stretch = element('p', 'nearest', place);
    note.hidden = !quiet;
    const u = new uPlot(
      {
        ...sizeOf(),
        legend: {live: true, markers: {width: 0, fill: (u, i) => markerOf(panel, i)}},
        cursor: {
          drag: course ? {x: true, y: false} : {x: true, y: true, uni: 30},
          points: {size: 6},
          focus: {prox: -1},
          ...(linked ? {sync: {key, scales: ['x', null]}} : {}),
        },
        scales: {
          x: scaleOf(x, course),
          y: scaleOf(panel.y, false),
          flag: {auto: false, range: [0, 1]},
        },
        axes: axesOf(x, panel.y),
        series: [
          {
            label: x.name,
            value: (u, value) => (u.cursor.idx == null ? ''
              : withUnit(readable(value, panel.x.decimals), x.unit)),
          },
          ...panel.series.map((item, i) => seriesOf(item, panel.y, panel.places[i + 1])),
          ...edges,
        ],
        bands: panel.bands.map((band, i) => ({
          series: [first + 2 * i + 1, first + 2 * i],
          fill: `${colour(band.colour)}33`,
        })),
        hooks: {
          drawAxes: [self => drawRules(self, panel)],
          draw: [self => drawMarks(self, panel)],
          setScale: [(self, name) => {
            if (name !== 'x' || self.scales.x.min === null) return;
            const [low, high] = [self.scales.x.min, self.scales.x.max]
              .map(end => readable(end, panel.x.decimals));
            stretch.textContent = `Shown: ${x.name} ${low} to ${withUnit(high, x.unit)}`;
            whole ||= stretch.textContent;
            stretch.hidden = stretch.textContent === whole;
          }],
          setCursor: [self => {
            note.textContent = nearestQuiet(self, panel, panel.y);
            self.root.querySelector('.u-series').classList.toggle('idle', self.cursor.idx == null);
          }],
          ready: [self => {
            // What is many stays out of the legend; the upper edge of a band stands for both.
            const rows = self.root.querySelectorAll('.u-legend .u-series');
            panel.series.forEach((item, i) => { rows[i + 1].hidden = item.quiet; });
            panel.bands.forEach((_, i) => { rows[first + 2 * i].hidden = true; });
            rows[0].classList.add('idle');
            const kin = () => (linked ? one.plots : [self]);
            const reset = () => { for (const plot of kin()) plot.setData(plot.data); };
            const view = viewOf(self, course ? ['x'] : ['x', 'y'], kin, reset);
            gestures(self.over, view, panel.title || panel.y.name);
          }],
        },
      },
      panel.columns.map((column, i) =>
        (panel.series[i - 1]?.joined ? column.map(value => value ?? undefined) : column)),
      place,
    );
    place.append(note, stretch);
    new ResizeObserver(() => {
      if (place.clientWidth > 0 && place.clientWidth !== u.width) u.setSize(sizeOf());
    }).observe(place);
    return u;
  }

  function markerOf(panel, index) {
    const item = panel.series[index - 1];
    if (item) return colour(item.colour);
    const band = panel.bands[Math.floor((index - 1 - panel.series.length) / 2)];
    return band ? `${colour(band.colour)}55` : 'transparent';
  }

  const endsOf = lists => {
    let [low, high] = [Infinity, -Infinity];
    for (const value of lists.flat())
      if (value !== null) [low, high] = [Math.min(low, value), Math.max(high, value)];
    return low <= high ? [low, high] : [0, 1];
  };

  // The colour of a level, mixed from those beside it.
  function shadeOf({stops}) {
    const known = stops.map(([level, name]) => [level, colour(name)
      .match(/[0-9a-f]{2}/gi).map(part => parseInt(part, 16))]);
    return value => {
      const next = known.findIndex(([level]) => level >= value);
      if (next <= 0) return `rgb(${known.at(next).at(1)})`;
      const [[low, a], [high, b]] = [known[next - 1], known[next]];
      const share = (value - low) / (high - low);
      return `rgb(${a.map((part, i) => Math.round(part + share * (b[i] - part)))})`;
    };
  }

  // A strip of the colours of levels, with a mark.
  function stripOf({axis, stops, mark}, place) {
    const bar = element('p', 'levels', place);
    const [low, high] = [stops[0][0], stops.at(-1)[0]];
    const share = level => `${(100 * (level - low)) / (high - low || 1)}%`;
    element('span', '', bar, `${axis.name} ${plain(low)}`);
    const strip = element('i', '', bar);
    const colours = stops.map(([level, name]) => `${colour(name)} ${share(level)}`);
    strip.style.background = `linear-gradient(to right, ${colours})`;
    if (mark) element('b', '', strip).style.left = share(mark[0]);
    element('span', '', bar, withUnit(plain(Number(high.toPrecision(3))), axis.unit)
      + (mark ? `; mark: ${mark[1]} ${withUnit(plain(Number(mark[0].toPrecision(4))), axis.unit)}` : ''));
  }

  // A panel of places in a plane: x and y go together, and the nearest place is read.
  function planeOf(panel, one, place) {
    const {chart} = one;
    const {shades} = panel;
    const axes = [chart.x, panel.y];
    const shade = shades && shadeOf(shades);
    headOf(panel, place);
    if (panel.series.length > 1) {
      const names = element('p', 'names', place);
      for (const {name, colour: own} of panel.series)
        element('i', '', element('span', '', names, name)).style.background = colour(own);
    }
    if (shades) stripOf(shades, place);
    const wide = panel.true_scale ? element('div', 'wide', place) : place;
    const data = ['x', 'y'].map(key => endsOf(panel.series.map(item => item[key])));
    const room = data.map(([low, high]) => 0.04 * (high - low) || 1);
    const full = data.map(([low, high], i) => [low - room[i], high + room[i]]);
    const wanted = full.map(([low, high]) => TRUE * (high - low));
    if (panel.true_scale) paperFor(wanted.map(length => (length + 60) / TRUE));
    const sizeOf = () => panel.true_scale
      // In whole pixels: Chromium prints a canvas of others smaller than it is.
      ? {width: Math.ceil(wanted[0]) + 60, height: Math.ceil(wanted[1]) + 60}
      : {
        width: widthOf(chart, place),
        // On a narrow page a plane needs no more height than its places have.
        height: Math.min(heightOf(chart, panel),
          90 + Math.max(120, panel.plane * place.clientWidth * wanted[1] / wanted[0])),
      };

    // Show at least these stretches, in the scale of the plane.
    function fit(u, ends) {
      const size = [u.over.clientWidth, u.over.clientHeight];
      const [x, y] = ends.map(([low, high], i) => (high - low) / size[i] * (i ? panel.plane : 1));
      const unit = Math.max(x, y);
      u.batch(() => ends.forEach(([low, high], i) => {
        const half = unit * size[i] / (i ? panel.plane : 1) / 2;
        const middle = (low + high) / 2;
        u.setScale('xy'[i], {min: middle - half, max: middle + half});
      }));
    }

    let all = null; // the lengths of the whole
    function whole(u) {
      all = null;
      const size = [u.over.clientWidth, u.over.clientHeight];
      fit(u, !panel.true_scale ? full : full.map(([low, high], i) =>
        [-1, 1].map(side => (low + high + side * size[i] / TRUE) / 2)));
      all = ['x', 'y'].map(key => u.scales[key].max - u.scales[key].min);
    }

    const draw = u => within(u, `11${FONT}`, (ctx, bbox, ratio) => {
      ctx.lineJoin = ctx.lineCap = 'round';
      for (const item of panel.series) {
        const at = i => [u.valToPos(item.x[i], 'x', true), u.valToPos(item.y[i], 'y', true)];
        ctx.strokeStyle = ctx.fillStyle = colour(item.colour);
        ctx.lineWidth = 1.4 * ratio * item.width;
        let open = false;
        ctx.beginPath();
        item.x.forEach((x, i) => {
          const known = x !== null && item.y[i] !== null;
          if (item.kind === 'dots') {
            if (!known) return;
            ctx.moveTo(...at(i));
            ctx.arc(...at(i), 1.6 * ratio, 0, 2 * Math.PI);
          } else if (known && open && item.level) {
            // Each piece has a colour of its own.
            ctx.strokeStyle = shade(item.level[i]);
            ctx.lineTo(...at(i));
            ctx.stroke();
            ctx.beginPath();
            ctx.moveTo(...at(i));
          } else if (known) {
            if (open) ctx.lineTo(...at(i));
            else ctx.moveTo(...at(i));
          }
          open = known;
        });
        if (item.kind === 'dots') ctx.fill();
        else ctx.stroke();
      }
    });

    // The place next to the cursor, and what is read there.
    function nearest(u) {
      const {left, top} = u.cursor;
      let best = {away: Infinity};
      if (left >= 0)
        for (const item of panel.series)
          item.x.forEach((x, i) => {
            if (x === null || item.y[i] === null) return;
            const to = [u.valToPos(x, 'x'), u.valToPos(item.y[i], 'y')];
            const away = Math.hypot(to[0] - left, to[1] - top);
            if (away < best.away) best = {away, to, item, i};
          });
      spot.hidden = !best.item;
      if (!best.item) return '';
      const {to, item, i} = best;
      Object.assign(spot.style, {left: `${to[0]}px`, top: `${to[1]}px`});
      const words = ['x', 'y'].map((key, n) =>
        `${axes[n].name} ${withUnit(readable(item[key][i], item.places[n]), axes[n].unit)}`);
      if (item.level && item.level[i] !== null)
        words.push(`${shades.axis.name} ${withUnit(readable(item.level[i], 2), shades.axis.unit)}`);
      if (panel.series.length > 1) words.unshift(item.name);
      return `nearest: ${words.join(', ')}`;
    }

    const note = element('p', 'nearest', place);
    const stretch = element('p', 'nearest', place);
    const spot = element('span', 'spot', place);
    const u = new uPlot(
      {
        ...sizeOf(),
        legend: {show: false},
        cursor: {drag: {x: true, y: true, setScale: false}, points: {show: false}},
        scales: Object.fromEntries(['x', 'y'].map(key =>
          [key, {time: false, range: (self, low, high) => [low, high]}])),
        axes: axesOf(...axes),
        series: [{}, {stroke: 'transparent', points: {show: false}}],
        hooks: {
          draw: [draw],
          setCursor: [self => { note.textContent = nearest(self); }],
          setScale: [self => {
            const part = ['x', 'y'].map(key => [self.scales[key].min, self.scales[key].max]);
            spot.hidden = true;
            stretch.textContent = all && part.some(([low, high], i) => high - low < 0.999 * all[i])
              ? `Shown: ${part.map(([low, high], i) => `${axes[i].name} ${readable(low, 3)} to `
                + withUnit(readable(high, 3), axes[i].unit)).join(', ')}` : '';
          }],
          ready: [self => {
            self.over.append(spot);
            if (panel.true_scale) {
              self.batch(() => self.setSize({
                width: Math.ceil(self.width + wanted[0] - self.over.clientWidth),
                height: Math.ceil(self.height + wanted[1] - self.over.clientHeight),
              }));
            }
            whole(self);
            self.over.addEventListener('dblclick', () => whole(self));
            gestures(self.over, viewOf(self, ['x', 'y'], () => [self], () => whole(self)),
              panel.title || 'plot');
          }],
          setSelect: [self => {
            const {left, top, width, height} = self.select;
            if (Math.hypot(width, height) < CLICK) return;
            self.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
            fit(self, [[left, left + width].map(at => self.posToVal(at, 'x')),
              [top + height, top].map(at => self.posToVal(at, 'y'))]);
          }],
        },
      },
      data,
      wide,
    );
    place.append(note, stretch);
    new ResizeObserver(() => {
      if (panel.true_scale || place.clientWidth === 0 || place.clientWidth === u.width) return;
      u.setSize(sizeOf());
      whole(u);
    }).observe(place);
    return u;
  }

  // A browser shrinks what is wider than its paper: ask for paper on which it keeps its size.
  function paperFor([width, height]) {
    if (width + 12 <= SHEET) return;
    element('style', '', document.head,
      `@page { size: ${width + 34}mm ${Math.max(297, height + 80)}mm; margin: 10mm; }`);
  }

  // One table of all panels of a chart: places row by row, curves by x.
  function tableOf(chart) {
    if (chart.panels.some(panel => panel.plane)) return placesOf(chart);
    const heads = [chart.x.label];
    const rows = new Map();
    let width = 1;
    for (const panel of chart.panels) {
      const before = panel.title ? `${panel.title}: ` : '';
      const names = panel.series.map(item => [item.name, item.kind === 'flag' ? '' : panel.y.unit]);
      for (const band of panel.bands)
        names.push([`${band.name}, low`, panel.y.unit], [`${band.name}, high`, panel.y.unit]);
      heads.push(...names.map(([name, unit]) => `${before}${name}${unit ? ` [${unit}]` : ''}`));
      const seen = new Map();
      panel.columns[0].forEach((x, i) => {
        // An x that comes twice gets two rows; where panels have other rows, cells stay empty.
        const turn = (seen.get(x) ?? 0) + 1;
        seen.set(x, turn);
        const key = `${x}/${turn}`;
        if (!rows.has(key)) rows.set(key, [x]);
        const row = rows.get(key);
        for (let c = 1; c < panel.columns.length; c++) row[width + c - 1] = panel.columns[c][i];
      });
      width += names.length;
    }
    const found = [...rows.values()].sort((a, b) => a[0] - b[0]);
    return [heads, ...found.map(row => Array.from({length: width}, (_, c) => row[c] ?? ''))];
  }

  function placesOf(chart) {
    const levels = chart.panels.find(panel => panel.shades)?.shades.axis.label;
    const rows = chart.panels.flatMap(panel => panel.series.flatMap(item => item.x.map((x, i) =>
      [panel.title, item.name, x, item.y[i], ...(levels ? [item.level?.[i]] : [])])));
    return [['panel', 'series', chart.x.label, chart.panels[0].y.label, ...(levels ? [levels] : [])],
      ...rows.filter(row => row[2] !== null).map(row => row.map(value => value ?? ''))];
  }

  function quoted(value) {
    const text = String(value);
    return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  }

  function save(rows, name) {
    const text = rows.map(row => row.map(quoted).join(',')).join('\r\n') + '\r\n';
    // Spreadsheets take it for UTF-8 by the mark at its beginning.
    const url = URL.createObjectURL(new Blob(['\ufeff', text], {type: 'text/csv'}));
    const link = document.createElement('a');
    Object.assign(link, {href: url, download: name});
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 1000);
  }

  const HINT = matchMedia('(hover: none)').matches
    ? 'Two fingers zoom and move, a double tap goes back.'
    : 'Drag to zoom, double-click to go back; or Ctrl and the wheel, or + and -, arrows and 0.';
  const charts = [];
  for (const source of document.querySelectorAll('script.chart')) {
    const figure = source.closest('figure');
    const chart = JSON.parse(source.textContent);
    chart.panels.forEach(unpacked);
    const texts = [HINT];
    const most = Math.max(...chart.panels.map(panel => panel.kept?.[1] ?? 0));
    if (most) texts.push(`Of ${most} samples those are kept that show every extreme.`);
    const bar = figure.querySelector('.tools');
    bar.querySelector('.hint').textContent = texts.join(' ');
    bar.querySelector('button').onclick = () =>
      save(tableOf(chart), `${document.body.dataset.name}-${figure.id}.csv`);
    const screen = figure.querySelector('.screen');
    screen.style.setProperty('--columns', chart.columns);
    figure.classList.add('live');
    charts.push({chart, screen, key: figure.id, plots: []});
  }

  function draw() {
    for (const one of charts) {
      one.plots.forEach(plot => plot.destroy());
      one.screen.replaceChildren();
      one.plots = one.chart.panels.map(panel => {
        const place = element('div', 'panel', one.screen);
        return (panel.plane ? planeOf : chartOf)(panel, one, place);
      });
    }
  }
  draw();
  // Canvases do not follow style sheets by themselves; paper is light.
  for (const query of [paper, matchMedia('(prefers-color-scheme: dark)')])
    query.addEventListener('change', draw);
})();
