// Keyboard, what stays chosen while the list is renewed, and no questions while nobody looks.
"use strict";
const chosen = new Set();
let place = -1;
const rows = () => [...document.querySelectorAll("[data-row]")];

function restore() {
  for (const box of document.querySelectorAll('#list input[name="e"]')) box.checked = chosen.has(box.value);
  const button = document.querySelector("[data-compare]");
  const count = document.querySelectorAll('#list input[name="e"]:checked').length;
  if (button) {
    button.disabled = count < 1;
    button.textContent = count > 1 ? `Compare ${count}` : "Compare";
  }
  rows().forEach((row, index) => row.classList.toggle("at", index === place));
}

function move(by) {
  const all = rows();
  if (!all.length) return;
  place = Math.max(0, Math.min(all.length - 1, place + by));
  all[place].scrollIntoView({ block: "nearest" });
  restore();
}

document.addEventListener("change", event => {
  if (event.target.name !== "e") return;
  if (event.target.checked) chosen.add(event.target.value);
  else chosen.delete(event.target.value);
  restore();
});

document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const filter = document.getElementById("filter");
  if (event.target.matches("input[type=search]") && event.key === "Escape") event.target.blur();
  if (event.target.matches("input:not([type=checkbox]), textarea, select")) return;
  const row = rows()[place];
  if (event.key === "/" && filter) {
    event.preventDefault();
    filter.focus();
    filter.select();
  } else if (event.key === "j") move(1);
  else if (event.key === "k") move(-1);
  else if (event.key === "x" && row) row.querySelector('input[name="e"]').click();
  else if (event.key === "Enter" && row && event.target === document.body) location.href = row.dataset.href;
});

// Enter in the filter shows the list, which is already there, instead of loading the page again.
document.addEventListener("submit", event => {
  if (event.target.matches(".filter")) event.preventDefault();
});

document.addEventListener("htmx:beforeRequest", event => {
  const live = event.detail.elt.matches("[data-live]");
  if (live && (document.hidden || event.detail.elt.querySelector("details[open]"))) event.preventDefault();
});
document.addEventListener("htmx:afterSwap", restore);
document.addEventListener("htmx:afterSettle", restore);
document.addEventListener("DOMContentLoaded", restore);
