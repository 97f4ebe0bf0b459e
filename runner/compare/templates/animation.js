"use strict";
// Moves each hull along its track, with its thrust and rudder; the slider is the time.
const scene = JSON.parse(document.getElementById("scene").textContent);
const HULL = [[0.5, 0], [0.2, 0.18], [-0.5, 0.18], [-0.5, -0.18], [0.2, -0.18]];
const last = Math.max(...scene.sails.map((sail) => sail.t[sail.t.length - 1]));
const slider = document.getElementById("time"), play = document.getElementById("play");
function draw(parent, name, attributes) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const key in attributes) element.setAttribute(key, attributes[key]);
  return parent.appendChild(element);
}
const flat = (points) => points.map((point) => `${point[0]},${-point[1]}`).join(" ");  // y is down
const NEAR = 1.4;  // half the width of the enlarged picture, in hulls
function ship(svg, sail, near) {
  const points = sail.x.map((x, k) => [x, sail.y[k]]);
  if (sail.reference) draw(svg, "polyline", { class: "reference", points: flat(sail.reference) });
  draw(svg, "polyline", { class: "faint", stroke: sail.colour, points: flat(points) });
  const track = draw(svg, "polyline", { stroke: sail.colour });
  const hull = draw(svg, "polygon", { class: "hull", stroke: sail.colour });
  const lines = sail.parts.map((part) => draw(svg, "line", { class: part.kind }));
  return { svg, sail, points, track, hull, lines, near };
}
const ships = scene.sails.flatMap((sail, i) => {
  const far = document.querySelectorAll(".sails .far")[i];
  const [west, east] = scene.east, [south, north] = scene.north;
  far.setAttribute("viewBox", `${west} ${-north} ${east - west} ${north - south}`);
  return [ship(far, sail, false), ship(document.querySelectorAll(".sails .near")[i], sail, true)];
});
function place(sail, k, ahead, side) {
  const s = Math.sin(sail.psi[k]), c = Math.cos(sail.psi[k]);
  return [sail.x[k] + s * ahead + c * side, sail.y[k] + c * ahead - s * side];
}
function show(time) {
  for (const { svg, sail, points, track, hull, lines, near } of ships) {
    let k = sail.t.findIndex((t) => t > time);
    k = k < 0 ? sail.t.length - 1 : Math.max(0, k - 1);
    const half = NEAR * scene.length;
    if (near) {
      svg.setAttribute("viewBox", `${sail.x[k] - half} ${-sail.y[k] - half} ${2 * half} ${2 * half}`);
    }
    track.setAttribute("points", flat(points.slice(0, k + 1)));
    const corners = HULL.map(([x, y]) => place(sail, k, x * scene.length, y * scene.length));
    hull.setAttribute("points", flat(corners));
    sail.parts.forEach((part, j) => {
      const [x0, y0, x1, y1] = part.at[k];
      const from = place(sail, k, x0, y0), to = place(sail, k, x1, y1);
      const ends = { x1: from[0], y1: -from[1], x2: to[0], y2: -to[1] };
      for (const key in ends) lines[j].setAttribute(key, ends[key]);
    });
  }
  slider.value = 1000 * time / last;
  document.getElementById("now").textContent = `${time.toFixed(0)} s`;
}
let time = 0, before = null;
function step(now) {
  if (before === null) return;
  time += (now - before) / 1000 * last / document.getElementById("duration").value;
  before = now;
  if (time >= last) { time = last; pause(); }
  show(time);
  if (before !== null) requestAnimationFrame(step);
}
function pause() { before = null; play.textContent = "Play"; play.setAttribute("aria-pressed", "false"); }
play.addEventListener("click", () => {
  if (before !== null) { pause(); return; }
  if (time >= last) time = 0;
  before = performance.now();
  play.textContent = "Pause";
  play.setAttribute("aria-pressed", "true");
  requestAnimationFrame(step);
});
slider.addEventListener("input", () => { pause(); time = slider.value / 1000 * last; show(time); });
show(0);
