"use strict";
for (const pair of document.querySelectorAll(".pair")) {
  const slider = document.createElement("input");
  Object.assign(slider, { type: "range", min: 0, max: 100, value: 50, autocomplete: "off" });
  slider.setAttribute("aria-label", pair.dataset.label);
  const move = () => {
    pair.style.setProperty("--at", `${slider.value}%`);
    slider.setAttribute("aria-valuetext", `${slider.value} % of the left picture`);
  };
  slider.addEventListener("input", move);
  move();
  pair.append(slider);
  pair.classList.add("slides");
}
const opened = [];
addEventListener("beforeprint", () => {
  for (const fold of document.querySelectorAll("details:not([open])")) opened.push(fold);
  for (const fold of opened) fold.open = true;
});
addEventListener("afterprint", () => { while (opened.length) opened.pop().open = false; });
