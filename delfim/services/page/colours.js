// The colours of the page: what was chosen in this browser, or day, or night where the system is dark.
"use strict";
const KEPT = "delfim.theme", root = document.documentElement;
root.dataset.theme = localStorage.getItem(KEPT) || (matchMedia("(prefers-color-scheme: dark)").matches ? "night" : "day");
addEventListener("DOMContentLoaded", () => {
  const chosen = document.getElementById("colours");
  chosen.value = root.dataset.theme;
  chosen.addEventListener("change", () => localStorage.setItem(KEPT, root.dataset.theme = chosen.value));
});
