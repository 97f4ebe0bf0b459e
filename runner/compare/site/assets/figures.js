"use strict";
// Figures by uPlot: lines, points and intervals over any x. Colours are safe for the colour-blind.
const COLOURS = {
  light: ["#0072b2", "#d55e00", "#009e73", "#b8578e", "#b07800", "#2a93cf", "#1a1a1a", "#7a5fc0"],
  dark: ["#4db3f0", "#f08a4b", "#2fc99b", "#e59ac6", "#eebf4a", "#8fd0f5", "#e8e8e8", "#b7a3ee"],
};
const SHAPES = ["circle", "square", "triangle", "diamond"];

function isDark() {
  return matchMedia("(prefers-color-scheme: dark)").matches;
}

function colour(i) {
  const palette = COLOURS[isDark() ? "dark" : "light"];
  return palette[i % palette.length];
}

// Draw one figure. `series` are { label, place, kind, xs, ys, lows, highs, dash, alpha, size } of
// kind line, points or interval (along x); `place` chooses colour and shape. `x` and `y` are { label,
// log, values }: `values` maps a coordinate to a word. `equal` gives both axes one scale.
function drawFigure({ title, x, y, series, height = 300, equal = false, legend = true, words = "" }) {
  const host = element("div", { class: "plot", role: "img", "aria-label": `${title}. ${words}` });
  const figure = element("figure", {}, element("figcaption", {}, title),
    legend ? legendOf(series) : null, host);
  requestAnimationFrame(() => {
    if (!host.isConnected || !series.length) return;
    const width = Math.max(280, host.clientWidth);
    const box = bounds(series, x, y);
    const tall = equal ? equalHeight(box, width) : height;
    new uPlot(options(width, tall, box, { x, y, series, equal }),
      [null, ...series.map((one) => [one.xs, one.ys])], host);
  });
  return figure;
}

function legendOf(series) {
  const shown = new Map();
  for (const one of series) if (one.label && !shown.has(one.label)) shown.set(one.label, one);
  return element("ul", { class: "legend" }, [...shown].map(([label, one]) => {
    const swatch = element("span", { class: "swatch", "aria-hidden": true });
    swatch.style.borderTop = `3px ${one.dash ? "dashed" : "solid"} ${colour(one.place)}`;
    return element("li", {}, swatch, label);
  }));
}

// Lowest and highest finite x and y, with a margin.
function bounds(series, x, y) {
  const span = (axis, ...lists) => {
    let low = Infinity, high = -Infinity;
    for (const list of lists) {
      for (const value of list ?? []) {
        if (value === null || !Number.isFinite(value) || (axis.log && value <= 0)) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (low > high) return [axis.log ? 1 : 0, axis.log ? 10 : 1];
    if (axis.log) return [low / 1.3, high * 1.3];
    const margin = 0.04 * (high - low) || Math.abs(high) * 0.1 || 1;
    return axis.range ?? [low - margin, high + margin];
  };
  return {
    x: span(x, ...series.flatMap((one) => [one.xs, one.lows, one.highs])),
    y: span(y, ...series.map((one) => one.ys)),
  };
}

// The height at which a metre is as long along both axes; the box grows if it would be too tall.
function equalHeight(box, width) {
  const [across, up] = [box.x[1] - box.x[0], box.y[1] - box.y[0]];
  const inner = width - 70;
  const tall = Math.min(560, Math.max(220, (inner * up) / across));
  const scale = Math.max(across / inner, up / tall); // [m/px]
  for (const [axis, pixels] of [["x", inner], ["y", tall]]) {
    const extra = scale * pixels - (box[axis][1] - box[axis][0]);
    box[axis] = [box[axis][0] - extra / 2, box[axis][1] + extra / 2];
  }
  return tall + 50;
}

function options(width, height, box, { x, y, series, equal }) {
  const style = getComputedStyle(document.documentElement);
  const ink = style.getPropertyValue("--ink"), line = style.getPropertyValue("--line");
  const scale = (axis, span) => ({
    time: false,
    auto: false,
    distr: axis.log ? 3 : 1,
    min: span[0],
    max: span[1],
    range: (plot, low, high) => (low === null || low === high ? span : [low, high]),
  });
  const axis = (of, size, span) => ({
    label: of.label, labelSize: 22, size, stroke: ink, font: "12px system-ui", labelFont: "12px system-ui",
    grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1 },
    ...(of.values ? { splits: () => of.splits, values: (plot, at) => at.map(of.values) } : {
      values: (plot, at) => at.map((v) => (v === null ? "" : String(Number(v.toPrecision(6))))),
    }),
  });
  return {
    mode: 2, width, height,
    legend: { show: false },
    cursor: { show: !equal, points: { show: false }, x: false, y: false,
      drag: { x: true, y: true, uni: 20 }, dataIdx: () => null },
    scales: { x: scale(x, box.x), y: scale(y, box.y) },
    axes: [axis(x, 34, box.x), axis(y, y.size ?? 58, box.y)],
    series: [null, ...series.map((one) => ({
      stroke: colour(one.place),
      facets: [{ scale: "x", auto: false }, { scale: "y", auto: false }],
      paths: painter(one),
    }))],
  };
}

// A function for uPlot that paints one series on its canvas.
function painter(one) {
  return (plot, at) => {
    uPlot.orient(plot, at, (own, dataX, dataY, scaleX, scaleY, toX, toY, left, top, wide, tall) => {
      const context = plot.ctx;
      const px = (v) => toX(v, scaleX, wide, left), py = (v) => toY(v, scaleY, tall, top);
      context.save();
      context.beginPath();
      context.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
      context.clip();
      context.strokeStyle = context.fillStyle = colour(one.place);
      context.globalAlpha = one.alpha ?? 1;
      context.lineWidth = (one.size ?? 1.5) * uPlot.pxRatio;
      context.setLineDash(one.dash ? [6 * uPlot.pxRatio, 4 * uPlot.pxRatio] : []);
      ({ line: paintLine, points: paintPoints, interval: paintIntervals })[one.kind](context, one, px, py);
      context.restore();
    });
    return null;
  };
}

function paintLine(context, one, px, py) {
  context.beginPath();
  let drawing = false;
  one.xs.forEach((x, i) => {
    const y = one.ys[i];
    if (x === null || y === null) drawing = false;
    else if (drawing) context.lineTo(px(x), py(y));
    else context.moveTo(px(x), py(y));
    drawing = x !== null && y !== null;
  });
  context.stroke();
}

function paintPoints(context, one, px, py) {
  const size = (one.size ?? 4) * uPlot.pxRatio;
  context.beginPath();
  one.xs.forEach((x, i) => {
    if (x !== null && one.ys[i] !== null) {
      shape(context, SHAPES[one.place % SHAPES.length], px(x), py(one.ys[i]), size);
    }
  });
  if (one.hollow) {
    context.lineWidth = 1.5 * uPlot.pxRatio;
    context.stroke();
  } else {
    context.fill();
  }
}

function shape(context, name, x, y, size) {
  const corners = { square: [[-1, -1], [1, -1], [1, 1], [-1, 1]], triangle: [[0, -1.2], [1.1, 0.9], [-1.1, 0.9]],
    diamond: [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]] }[name];
  if (!corners) {
    context.moveTo(x + size, y);
    context.arc(x, y, size, 0, 2 * Math.PI);
    return;
  }
  corners.forEach(([dx, dy], i) => {
    context[i ? "lineTo" : "moveTo"](x + 0.9 * size * dx, y + 0.9 * size * dy);
  });
  context.closePath();
}

// Whiskers along x with a mark at the value.
function paintIntervals(context, one, px, py) {
  const cap = 4 * uPlot.pxRatio;
  context.beginPath();
  one.xs.forEach((x, i) => {
    const [low, high] = [one.lows[i], one.highs[i]];
    if (!Number.isFinite(low) || !Number.isFinite(high) || x === null) return;
    const y = py(one.ys[i]), ends = [px(one.floor ? Math.max(low, one.floor) : low), px(high)];
    context.moveTo(ends[0], y);
    context.lineTo(ends[1], y);
    for (const end of ends) {
      context.moveTo(end, y - cap);
      context.lineTo(end, y + cap);
    }
  });
  context.stroke();
  context.setLineDash([]);
  paintPoints(context, { ...one, size: 4.5 }, px, py);
}
