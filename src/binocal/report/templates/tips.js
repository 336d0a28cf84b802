"use strict";
/* The nearest place of a figure under the pointer, or chosen with the arrow keys, and what is there. */
const pageTip = (() => {
  const tip = document.getElementById("tip");
  const hide = () => { tip.hidden = true; };
  const show = (text, x, y) => {
    tip.textContent = text;
    tip.hidden = false;
    const box = tip.getBoundingClientRect();
    tip.style.left = Math.max(4, Math.min(x + 12, innerWidth - box.width - 4)) + "px";
    tip.style.top = Math.max(4, y - box.height - 10) + "px";
  };
  for (const figure of document.querySelectorAll("figure[data-tips]")) {
    const svg = figure.querySelector("svg");
    const tips = JSON.parse(figure.dataset.tips);
    const width = svg.viewBox.baseVal.width;
    let chosen = -1;
    const showChosen = () => {
      const box = svg.getBoundingClientRect(), scale = box.width / width, [x, y, text] = tips[chosen];
      show(text, box.left + x * scale, box.top + y * scale);
    };
    const nearest = (event) => {
      const box = svg.getBoundingClientRect(), scale = box.width / width;
      const x = (event.clientX - box.left) / scale, y = (event.clientY - box.top) / scale;
      let best = -1, least = 28 * 28;
      tips.forEach((t, i) => {
        const d = (t[0] - x) ** 2 + (t[1] - y) ** 2;
        if (d < least) { least = d; best = i; }
      });
      if (best < 0) { hide(); return; }
      chosen = best;
      show(tips[best][2], event.clientX, event.clientY);
    };
    svg.addEventListener("pointermove", nearest);
    svg.addEventListener("pointerdown", nearest);
    svg.addEventListener("pointerleave", hide);
    figure.addEventListener("blur", hide);
    figure.addEventListener("keydown", (event) => {
      if (event.key === "Escape") { hide(); return; }
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (step === undefined || event.target !== figure) { return; }
      event.preventDefault();
      chosen = (chosen + step + tips.length) % tips.length;
      showChosen();
    });
  }
  return { show, hide };
})();
