"use strict";
// A click on a heading sorts its table by number, or by text for cells without a number.
function key(row, column) {
  const cell = row.cells[column];
  const number = parseFloat(cell.dataset.value);
  return Number.isNaN(number) ? cell.textContent.trim() : number;
}
function compare(left, right) {
  const numbers = typeof left === "number", others = typeof right === "number";
  if (numbers && others) return left - right;
  if (numbers !== others) return numbers ? -1 : 1;  // cells without a number come last
  return left.localeCompare(right, "en", { numeric: true });
}
function sort(heading) {
  const table = heading.closest("table"), body = table.tBodies[0], column = heading.cellIndex;
  const down = heading.getAttribute("aria-sort") === "ascending";
  const rows = Array.from(body.rows).map((row) => [key(row, column), row]);
  rows.sort((a, b) => {
    const order = compare(a[0], b[0]);
    return down && typeof a[0] === typeof b[0] ? -order : order;
  });
  body.append(...rows.map((pair) => pair[1]));
  for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", down ? "descending" : "ascending");
}
// A table or figure that is wider than the window says so, until its right edge is seen.
function cue(box) {
  box.classList.toggle("more", box.scrollLeft + box.clientWidth < box.scrollWidth - 2);
}
function watch(box) {
  box.addEventListener("scroll", () => cue(box), { passive: true });
  new ResizeObserver(() => cue(box)).observe(box);
}
document.querySelectorAll(".scroll").forEach(watch);
for (const heading of document.querySelectorAll(".scroll thead th")) {
  const button = document.createElement("button");
  button.type = "button";
  button.append(...heading.childNodes);
  heading.append(button);
  button.addEventListener("click", () => sort(heading));
}
