// Keyboard, what stays chosen while the list is renewed, and no questions while nobody looks.
"use strict";
const chosen = new Set();
const toggled = new Map();
let at = null; // the marked experiment; its row may move when the list is renewed
const rows = () => [...document.querySelectorAll("[data-row]")];

function restore() {
  for (const box of document.querySelectorAll('#list input[name="e"]')) box.checked = chosen.has(box.value);
  const button = document.querySelector("[data-compare]");
  const count = document.querySelectorAll('#list input[name="e"]:checked').length;
  if (button) {
    button.disabled = count < 1;
    button.textContent = count > 1 ? `Compare ${count}` : "Compare";
  }
  rows().forEach(row => row.classList.toggle("at", row.dataset.href === at));
  for (const [name, open] of toggled) document.getElementById(name)?.toggleAttribute("open", open);
}

function move(by) {
  const all = rows();
  if (!all.length) return;
  const place = all.findIndex(row => row.dataset.href === at) + by;
  const row = all[Math.max(0, Math.min(all.length - 1, place))];
  at = row.dataset.href;
  row.scrollIntoView({ block: "nearest" });
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
  const row = rows().find(one => one.dataset.href === at);
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

// What a person opens or closes stays so when the page is renewed.
document.addEventListener("click", event => {
  const details = event.target.closest("summary")?.parentElement;
  if (details?.id) toggled.set(details.id, !details.open);
});

document.addEventListener("htmx:beforeRequest", event => {
  if (event.detail.elt.matches("[data-live]") && document.hidden) event.preventDefault();
});

// A page that cannot be renewed says so, because it looks as if it were current.
function tell(problem) {
  const notice = document.getElementById("notice");
  notice.textContent = problem && `This page is not up to date: ${problem}`;
  notice.hidden = !problem;
}
document.addEventListener("htmx:sendError", () => tell("karolos ui does not answer."));
document.addEventListener("htmx:responseError", event => {
  const answer = new DOMParser().parseFromString(event.detail.xhr.response, "text/html");
  tell(answer.querySelector(".problem:not(#notice)")?.textContent ?? `karolos ui answers with ${event.detail.xhr.status}.`);
});
document.addEventListener("htmx:afterRequest", event => event.detail.successful && tell(""));
document.addEventListener("htmx:afterSwap", restore);
document.addEventListener("htmx:afterSettle", restore);
document.addEventListener("DOMContentLoaded", restore);
