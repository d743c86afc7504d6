// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Charts that are zoomed into, read under the cursor and saved as CSV; what they hold is declared in
// fuzzycnc_ros/studies/page/chart.py. Pictures are copies of their drawing for paper (pictures.js).
(() => {
  'use strict';
  const {decades, decoded, plain, readable, withUnit} = reading;
  const DOTS_MAX = 140;
  const SHARE_MIN = 5e-4; // of a whole axis that is shown at least
  const PIXELS = 84; // of an inch of the figure on paper
  const narrow = matchMedia('(max-width: 760px)');
  const dark = matchMedia('(prefers-color-scheme: dark)');

  const colour = name =>
    name.startsWith('--')
      ? getComputedStyle(document.documentElement).getPropertyValue(name).trim()
      : name;

  // Give a panel its columns: x, series, then the edges of bands.
  function unpacked(panel) {
    panel.columns = [decoded(panel.x), ...panel.series.map(item => decoded(item.y))];
    panel.places = [panel.x.decimals, ...panel.series.map(item => item.y.decimals)];
    for (const band of panel.bands)
      for (const side of ['low', 'high']) {
        panel.columns.push(decoded(band[side]));
        panel.places.push(band[side].decimals);
      }
    return panel;
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
        flag ? (value ? 'yes' : value === 0 ? 'no' : '–')
          : withUnit(readable(value, decimals), axis.unit),
    };
    if (dots) shown.points.filter = someDots;
    if (flag || item.kind === 'dots') shown.paths = () => null;
    if (item.kind === 'steps') shown.paths = uPlot.paths.stepped({align: 1});
    if (flag) Object.assign(shown, {scale: 'flag', width: 4});
    return shown;
  }

  const faded = hex => (/^#[0-9a-f]{6}$/i.test(hex) ? `${hex}66` : hex);

  function drawRules(u, panel) {
    const {ctx, bbox} = u;
    const ratio = devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.font = `${11 * ratio}px system-ui, sans-serif`;
    ctx.textAlign = 'left';
    ctx.textBaseline = 'alphabetic';
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
      ctx.fillStyle = colour('--muted');
      if (rule.name && rule.upright) ctx.fillText(rule.name, at + 4 * ratio, bbox.top + 12 * ratio);
      else if (rule.name) ctx.fillText(rule.name, bbox.left + 4 * ratio, at - 4 * ratio);
    }
    ctx.restore();
  }

  function drawMarks(u, panel) {
    const {ctx, bbox} = u;
    const ratio = devicePixelRatio;
    const xs = u.data[0];
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.font = `600 ${12 * ratio}px system-ui, sans-serif`;
    ctx.textAlign = 'left';
    ctx.textBaseline = 'alphabetic';
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
      item.text.forEach((text, i) => {
        if (!text || values[i] === null) return;
        ctx.fillStyle = colour('--ink');
        ctx.fillText(text, u.valToPos(xs[i], 'x', true) + 6 * ratio,
          u.valToPos(values[i], 'y', true) - 5 * ratio);
      });
    });
    ctx.restore();
  }

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

  // What gestures do to a curve; `kin` gives all plots that show the same stretch.
  function viewOf(u, keys, kin) {
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
    const whole = () => { for (const plot of kin()) plot.setData(plot.data); };
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
    const {x, linked, height} = chart;
    const quiet = panel.series.some(item => item.quiet);
    const course = panel.series.some(item => item.kind === 'line' || item.kind === 'steps');
    const note = document.createElement('p');
    note.className = 'nearest';
    const stretch = document.createElement('p');
    stretch.className = 'nearest';
    let whole = '';
    const ink = colour('--muted');
    const grid = {stroke: colour('--grid'), width: 1};
    const marks = axis => {
      const places = axis.ticks.length
        ? (low, high) => axis.ticks.filter(tick => tick >= low && tick <= high)
        : axis.scale === 'log' ? decades : null;
      if (!places) return {};
      return {splits: (u, i, low, high) => places(low, high), filter: (u, splits) => splits};
    };
    const axisOf = (axis, side) => ({
      label: side === 'x' || place.clientWidth > 0 ? axis.label : '',
      stroke: ink,
      grid,
      ticks: {stroke: colour('--faint'), width: 1, size: 4},
      font: '12px system-ui, sans-serif',
      labelFont: '12px system-ui, sans-serif',
      labelSize: 18,
      values: (u, splits) => splits.map(value => (value === null ? '' : plain(value))),
      ...marks(axis),
    });
    const sizeOf = () => ({
      width: Math.max(place.clientWidth, 120),
      height: Math.round(Math.max(PIXELS * height * panel.share, narrow.matches ? 180 : 120)),
    });
    const edges = panel.bands.flatMap(band => ['low', 'high'].map(side => ({
      label: band.name,
      stroke: 'transparent',
      width: 0,
      points: {show: false},
      value: (u, value, index, row) => {
        const low = readable(row === null ? null : u.data[index - 1][row], band.low.decimals);
        const text = `${low} to ${readable(value, band.high.decimals)}`;
        return value === null || value === undefined ? '–' : withUnit(text, panel.y.unit);
      },
    })));
    const first = 1 + panel.series.length;
    const drag = course ? {x: true, y: false} : {x: true, y: true, uni: 30};
    const u = new uPlot(
      {
        ...sizeOf(),
        title: panel.title || undefined,
        legend: {live: true, markers: {width: 0, fill: (u, i) => markerOf(panel, i)}},
        cursor: {
          drag,
          points: {size: 6},
          focus: {prox: -1},
          ...(linked ? {sync: {key, scales: ['x', null]}} : {}),
        },
        scales: {
          x: scaleOf(x, course),
          y: scaleOf(panel.y, false),
          flag: {auto: false, range: [0, 1]},
        },
        axes: [
          {...axisOf(x, 'x'), size: 34},
          {
            ...axisOf(panel.y, 'y'),
            size: (self, values) => 14 + 7 * Math.max(2, ...(values || []).map(v => v.length)),
          },
        ],
        series: [
          {label: x.name, value: (u, value) => withUnit(readable(value, panel.x.decimals), x.unit)},
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
          setCursor: [self => { if (quiet) note.textContent = nearestQuiet(self, panel, panel.y); }],
          ready: [self => {
            // What is many stays out of the legend; the upper edge of a band stands for both.
            const rows = self.root.querySelectorAll('.u-legend .u-series');
            panel.series.forEach((item, i) => { rows[i + 1].hidden = item.quiet; });
            panel.bands.forEach((_, i) => { rows[first + 2 * i].hidden = true; });
            const view = viewOf(self, course ? ['x'] : ['x', 'y'], () => (linked ? one.plots : [self]));
            gestures(self.over, view, panel.title || panel.y.name);
          }],
        },
      },
      panel.columns.map((column, i) =>
        (panel.series[i - 1]?.joined ? column.map(value => value ?? undefined) : column)),
      place,
    );
    if (quiet) place.append(note);
    place.append(stretch);
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

  // One table of all panels, by x; where panels have other rows, cells stay empty.
  function tableOf(chart) {
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
        // An x that comes twice gets two rows.
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

  function tools(figure, texts) {
    const bar = figure.querySelector('.tools');
    bar.hidden = false;
    bar.querySelector('.hint').textContent = texts.join(' ');
    return bar;
  }

  const HINT = matchMedia('(hover: none)').matches
    ? 'Two fingers zoom and move, a double tap goes back.'
    : 'Drag to zoom, double-click to go back; or Ctrl and the wheel, or + and -, arrows and 0.';
  const charts = [];
  for (const source of document.querySelectorAll('script.chart')) {
    const figure = source.closest('figure');
    const chart = JSON.parse(source.textContent);
    const name = `${document.body.dataset.name}-${figure.id}.csv`;
    const screen = figure.querySelector('.screen');
    if (chart.table) {
      const hint = chart.views.length ? [HINT] : [];
      tools(figure, hint).querySelector('button').onclick = () => save(chart.table, name);
      if (!chart.views.length) continue;
      figure.classList.add('live');
      pictures.live(figure, chart, screen);
      continue;
    }
    chart.panels.forEach(unpacked);
    const thinned = chart.panels.filter(panel => panel.kept);
    const texts = [HINT];
    if (thinned.length) {
      const most = Math.max(...thinned.map(panel => panel.kept[1]));
      texts.push(`Of ${most} samples those are kept that show every extreme.`);
    }
    tools(figure, texts).querySelector('button').onclick = () => save(tableOf(chart), name);
    figure.classList.add('live');
    screen.style.setProperty('--columns', chart.columns);
    charts.push({chart, screen, key: figure.id, plots: []});
  }

  function draw() {
    for (const one of charts) {
      one.plots.forEach(plot => plot.destroy());
      one.screen.replaceChildren();
      one.plots = one.chart.panels.map(panel => {
        const place = document.createElement('div');
        place.className = 'panel';
        one.screen.append(place);
        return chartOf(panel, one, place);
      });
    }
  }
  draw();
  dark.addEventListener('change', draw);
})();
