"use strict";
/* The rig in 3-D: turned by dragging or with the arrow keys, nearer and farther with + and -, views by button. */
(() => {
  const source = document.getElementById("scene-data");
  if (!source) { return; }
  const scene = JSON.parse(source.textContent);
  const svg = document.getElementById("scene");
  const holder = document.getElementById("scene-view");
  const SIZE = { w: 800, h: 520 };
  const VIEWS = { start: [-0.55, 0.5], front: [0, 0], top: [0, Math.PI / 2], side: [-Math.PI / 2, 0] };
  const NS = "http://www.w3.org/2000/svg";
  const all = [...scene.cameras.flatMap((c) => [c.at, ...c.outline]), ...scene.boards.flatMap((b) => b.outline)];
  const low = [0, 1, 2].map((i) => Math.min(...all.map((p) => p[i])));
  const high = [0, 1, 2].map((i) => Math.max(...all.map((p) => p[i])));
  const middle = low.map((l, i) => (l + high[i]) / 2);
  const radius = Math.max(1e-9, Math.hypot(...high.map((h, i) => h - low[i])) / 2);
  let [yaw, pitch] = VIEWS.start, zoom = 1.25;

  const turned = (p) => {
    const [x, y, z] = p.map((v, i) => (v - middle[i]) / radius);
    const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
    const x1 = cy * x + sy * z, z1 = -sy * x + cy * z;
    return [x1, cp * y - sp * z1, sp * y + cp * z1];
  };
  const shown = (p) => {
    const [x, y, z] = turned(p), f = zoom * SIZE.h / 2 * 3 / (3 + z);
    return [SIZE.w / 2 + f * x, SIZE.h / 2 + f * y, z];
  };
  const text = (points) => points.map((p) => p[0].toFixed(1) + "," + p[1].toFixed(1)).join(" ");
  const add = (kind, attributes, parent) => {
    const made = document.createElementNS(NS, kind);
    for (const [key, value] of Object.entries(attributes)) { made.setAttribute(key, value); }
    (parent || svg).append(made);
    return made;
  };

  const parts = [];
  for (const board of scene.boards) {
    const made = add("polygon", { class: board.next ? "board next" : "board" });
    made.addEventListener("pointermove", (event) => { if (!event.buttons) { pageTip.show(board.text, event.clientX, event.clientY); } });
    made.addEventListener("pointerleave", pageTip.hide);
    parts.push({ made, points: board.outline });
  }
  for (const camera of scene.cameras) {
    const every = Math.max(1, Math.floor(camera.outline.length / 4));
    const edges = camera.outline.filter((_, i) => i % every === 0).map((p) => [camera.at, p]);
    for (const points of edges) { parts.push({ made: add("polyline", { class: "camera " + camera.side }), points }); }
    parts.push({ made: add("polygon", { class: "camera " + camera.side }), points: camera.outline });
    parts.push({ made: add("circle", { class: "centre " + camera.side, r: 5 }), points: [camera.at] });
  }
  parts.push({ made: add("polyline", { class: "baseline" }), points: scene.cameras.map((c) => c.at) });
  const axes = [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]].map(([name, d]) => {
    const line = add("line", { class: "axis" }), label = add("text", { class: "axis", "text-anchor": "middle", dy: "0.35em" });
    label.textContent = name;
    return { d, line, label };
  });

  const draw = () => {
    for (const part of parts) {
      const points = part.points.map(shown);
      part.depth = points.reduce((sum, p) => sum + p[2], 0) / points.length;
      if (part.made.tagName === "circle") {
        part.made.setAttribute("cx", points[0][0].toFixed(1));
        part.made.setAttribute("cy", points[0][1].toFixed(1));
      } else { part.made.setAttribute("points", text(points)); }
    }
    parts.sort((a, b) => b.depth - a.depth);
    for (const part of parts) { svg.append(part.made); }
    for (const { d, line, label } of axes) {
      const [x, y] = turned(d.map((v, i) => middle[i] + v * radius)), at = [60, SIZE.h - 60];
      line.setAttribute("x1", at[0]); line.setAttribute("y1", at[1]);
      line.setAttribute("x2", at[0] + 34 * x); line.setAttribute("y2", at[1] + 34 * y);
      label.setAttribute("x", at[0] + 46 * x); label.setAttribute("y", at[1] + 46 * y);
      svg.append(line, label);
    }
  };
  const turn = (dYaw, dPitch) => {
    yaw += dYaw;
    pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, pitch + dPitch));
    draw();
  };
  const nearer = (factor) => { zoom = Math.max(0.4, Math.min(12, zoom * factor)); draw(); };
  const look = (name) => { [yaw, pitch] = VIEWS[name]; if (name === "start") { zoom = 1.25; } draw(); };

  let last = null;
  svg.addEventListener("pointerdown", (event) => { last = [event.clientX, event.clientY]; svg.setPointerCapture(event.pointerId); });
  svg.addEventListener("pointermove", (event) => {
    if (!last) { return; }
    pageTip.hide();
    turn(-(event.clientX - last[0]) / 150, (event.clientY - last[1]) / 150);
    last = [event.clientX, event.clientY];
  });
  for (const kind of ["pointerup", "pointercancel"]) { svg.addEventListener(kind, () => { last = null; }); }
  svg.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) { return; }
    event.preventDefault();
    nearer(Math.exp(-event.deltaY / 400));
  }, { passive: false });
  holder.addEventListener("keydown", (event) => {
    const actions = {
      ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, -0.1), ArrowDown: () => turn(0, 0.1),
      "+": () => nearer(1.2), "=": () => nearer(1.2), "-": () => nearer(1 / 1.2), 0: () => look("start"),
    };
    if (event.target !== holder || !actions[event.key] || event.ctrlKey || event.metaKey) { return; }
    event.preventDefault();
    actions[event.key]();
  });
  for (const button of document.querySelectorAll("[data-look]")) {
    button.addEventListener("click", () => look(button.dataset.look));
  }
  for (const button of document.querySelectorAll("[data-nearer]")) {
    button.addEventListener("click", () => nearer(Number(button.dataset.nearer)));
  }
  for (const box of document.querySelectorAll("[data-toggle]")) {
    box.addEventListener("change", () => { svg.classList.toggle("without-" + box.dataset.toggle, !box.checked); });
  }
  document.getElementById("scene-buttons").hidden = false;
  draw();
})();
