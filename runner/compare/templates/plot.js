// The figures of one run, or of several over each other, drawn from the lines that Python prepared.
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#b8578e", "#b07800", "#2a93cf", "#7a5fc0", "#5a5a5a"];
const MODELS = { nominal: "#d55e00", identified: "#0072b2", plant: "#009e73" };
const COMMON = { measured: "#1a1a1a", reference: "#767676" }; // lines of every model
const [LEFT, RIGHT, TOP, BOTTOM] = [62, 8, 8, 40]; // margins of a figure [px]

// Ticks at 1, 2 or 5 times a power of ten.
function ticks(low, high, most) {
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((size) => size * power).find((size) => size >= raw);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, i) => Number(((first + i) * step).toPrecision(6)));
}

// Lowest and highest number of some lists, with a margin.
function span(lists) {
  let low = Infinity, high = -Infinity;
  for (const value of lists.flat()) {
    if (value === null) continue;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (low > high) return [0, 1];
  const margin = 0.04 * (high - low) || 0.1 * Math.abs(high) || 1;
  return [low - margin, high + margin];
}

// The spans of x and y, and the height [px]; with `equal` a metre is as long along both.
function layout(figure, lines, width) {
  const x = span(lines.map((one) => one.x)), inner = width - LEFT - RIGHT;
  const y = span(lines.flatMap((one) => [one.y, ...(one.band ?? []).map((edge) => edge[1])]));
  if (!figure.equal) return { x, y, height: 250 };
  const height = Math.min(480, Math.max(200, (inner * (y[1] - y[0])) / (x[1] - x[0])));
  const scale = Math.max((x[1] - x[0]) / inner, (y[1] - y[0]) / height);
  const wider = (ends, pixels) => {
    const extra = (scale * pixels - (ends[1] - ends[0])) / 2;
    return [ends[0] - extra, ends[1] + extra];
  };
  return { x: wider(x, inner), y: wider(y, height), height: height + TOP + BOTTOM };
}

// One figure; `lines` are { name, colour, x, y, band, dash }, a band is two lines.
function drawFigure(figure, lines) {
  const width = Math.min(720, Math.max(280, document.documentElement.clientWidth - 40));
  const box = layout(figure, lines, width), { height } = box;
  const px = (value) => LEFT + ((value - box.x[0]) / (box.x[1] - box.x[0])) * (width - LEFT - RIGHT);
  const py = (value) => height - BOTTOM - ((value - box.y[0]) / (box.y[1] - box.y[0])) * (height - TOP - BOTTOM);
  const path = (xs, ys) => {
    let pen = "M"; // lifted where a value is missing
    return xs.map((x, i) => {
      if (x === null || ys[i] === null) {
        pen = "M";
        return "";
      }
      const point = `${pen}${px(x).toFixed(1)} ${py(ys[i]).toFixed(1)}`;
      pen = "L";
      return point;
    }).join("");
  };
  const closed = ([low, high]) => `${path([...low[0], ...high[0].toReversed()], [...low[1], ...high[1].toReversed()])}Z`;
  const across = ticks(...box.x, width / 90), up = ticks(...box.y, height / 45);
  const shown = svg("svg", { class: "plot", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": figure.title },
    across.map((at) => [svg("path", { class: "grid", d: `M${px(at)} ${TOP}V${height - BOTTOM}` }),
      svg("text", { x: px(at), y: height - BOTTOM + 15, "text-anchor": "middle" }, at)]),
    up.map((at) => [svg("path", { class: "grid", d: `M${LEFT} ${py(at)}H${width - RIGHT}` }),
      svg("text", { x: LEFT - 5, y: py(at) + 4, "text-anchor": "end" }, at)]),
    svg("text", { x: (LEFT + width) / 2, y: height - 5, "text-anchor": "middle" }, figure.x),
    svg("text", { x: 12, y: height / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${height / 2})` }, figure.y),
    lines.map((one) => (one.band ? svg("path", { d: closed(one.band), fill: one.colour, opacity: 0.2 }) : null)),
    lines.map((one) => svg("path", { d: path(one.x, one.y), stroke: one.colour, "stroke-dasharray": one.dash ? "6 4" : null })));
  const legend = lines.map((one) => {
    const swatch = element("span", { class: "swatch" });
    swatch.style.borderTop = `3px ${one.dash ? "dashed" : "solid"} ${one.colour}`;
    return element("li", {}, swatch, one.name);
  });
  return element("figure", {}, element("figcaption", {}, figure.title), element("ul", { class: "legend" }, legend), shown);
}

// The lines of one model in several runs, or all lines of one run. `runs` are { label, figures }.
function linesOf(key, runs, model) {
  const common = new Set();
  return runs.flatMap((run, k) => (run.figures[key]?.lines ?? []).flatMap((line) => {
    const everywhere = Object.hasOwn(COMMON, line.name);
    if (runs.length === 1) return [{ ...line, colour: COMMON[line.name] ?? MODELS[line.name] ?? COLOURS[7] }];
    if (everywhere ? common.has(line.name) : line.name !== model) return [];
    common.add(line.name);
    return [{ ...line, ...(everywhere ? { colour: COMMON[line.name] } : { name: run.label, colour: COLOURS[k % COLOURS.length] }) }];
  }));
}

function modelsOf(runs) {
  const names = runs.flatMap((run) => Object.values(run.figures).flatMap((figure) => figure.lines.map((line) => line.name)));
  return [...new Set(names)].filter((name) => !Object.hasOwn(COMMON, name)).sort();
}

function figuresOf(runs, model) {
  const keys = [...new Set(runs.flatMap((run) => Object.keys(run.figures)))];
  return keys.flatMap((key) => {
    const lines = linesOf(key, runs, model);
    return lines.length ? [drawFigure(runs.find((run) => run.figures[key]).figures[key], lines)] : [];
  });
}

if (window.seatrial && !seatrial.runs) { // the page of one run
  document.getElementById("plots").append(...figuresOf(Object.values(seatrial), ""));
}
