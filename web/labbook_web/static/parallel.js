// Parallel coordinates of all points of a study; ranges on the axes choose points in the table and in the chart too.
"use strict";

(() => {
  const NS = "http://www.w3.org/2000/svg", TOP = 62, HEIGHT = 250, WIDTH = 1240, SIDE = 80, MOST = 9;

  function node(name, attributes, text) {
    const child = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) child.setAttribute(key, value);
    if (text !== undefined) child.textContent = text;
    return child;
  }

  // Without quantities that are the same at all points, or run along with one before: their axes would tell nothing new.
  function distinct(all, points) {
    const selected = [];
    const place = (axis, point) => { const value = axis.of(point); return value === null ? null : (value - axis.low) / (axis.high - axis.low); };
    const along = (first, second) => points.every((point) => { const a = place(first, point), b = place(second, point); return (a === null) === (b === null) && (a === null || Math.abs(a - b) < 0.02); });
    for (const axis of all) if (axis.key || (!axis.constant && !selected.some((previous) => !previous.words && along(axis, previous)))) selected.push(axis);
    return selected;
  }

  function axes(data) {
    const list = [];
    const add = (id, display, value) => {
      const values = data.points.map(value).filter((entry) => entry !== undefined && entry !== null);
      if (!values.length) return;
      if (display.words) {
        const words = [...new Set(values)];
        list.push({ id, title: display.label, words, low: 0, high: Math.max(words.length - 1, 1), of: (point) => { const entry = value(point); return entry === undefined ? null : words.indexOf(entry); } });
      } else {
        const low = Math.min(...values) * display.scale, high = Math.max(...values) * display.scale;
        const title = (display.unit ? `${display.label} [${display.unit}]` : display.label).replace(/\^\(([^)]*)\)/g, "^$1");
        list.push({ id, title, low, high: high > low ? high : low + (Math.abs(low) || 1), constant: !(high > low), of: (point) => { const entry = value(point); return entry === undefined || entry === null ? null : entry * display.scale; } });
      }
    };
    for (const [key, display] of Object.entries(data.keys)) add(key, display, (point) => point.at[key]);
    for (const axis of list) axis.key = true;
    for (const [name, display] of Object.entries(data.quantities)) add(name, { ...display, words: false }, (point) => point.values[name] && point.values[name][0]);
    return distinct(list, data.points).slice(0, MOST);
  }

  const round = (value) => Number(value.toPrecision(4));

  function draw(holder, form, clear, data) {
    const allAxes = axes(data), brushes = new Map();
    for (const text of (labbook.get("brush") || "").split(";").filter(Boolean)) {
      const [id, low, high] = text.split("~");
      if (allAxes.some((axis) => axis.id === id) && !Number.isNaN(Number(low)) && !Number.isNaN(Number(high))) brushes.set(id, [Number(low), Number(high)]);
    }
    const svg = node("svg", { viewBox: `0 0 ${WIDTH} ${TOP + HEIGHT + 30}`, preserveAspectRatio: "xMidYMid meet", "aria-hidden": "true" });
    const x = (k) => SIDE + (k * (WIDTH - 2 * SIDE)) / Math.max(allAxes.length - 1, 1);
    const y = (axis, value) => TOP + HEIGHT * (1 - (value - axis.low) / (axis.high - axis.low));
    const valueAt = (axis, place) => axis.low + (1 - (place - TOP) / HEIGHT) * (axis.high - axis.low);
    const tinted = allAxes.find((axis) => !axis.key && !axis.words); // the flow rate, where it was measured
    document.getElementById("parallel-note").textContent = tinted ? `Lines are coloured by ${tinted.title}: orange where small, blue where large; dashed without a value.` : "";
    const lines = data.points.map((point) => {
      const parts = [];
      let on = false; // a line has a gap where a point has no value
      allAxes.forEach((axis, k) => {
        const value = axis.of(point);
        if (value !== null) parts.push(`${on ? "L" : "M"}${x(k).toFixed(1)} ${y(axis, value).toFixed(1)}`);
        on = value !== null;
      });
      const path = node("path", { d: parts.join("") }), value = tinted && tinted.of(point);
      if (value !== null && value !== undefined) path.style.setProperty("--part", `${(100 * (value - tinted.low) / (tinted.high - tinted.low)).toFixed(1)}%`);
      else if (tinted) path.classList.add("without");
      path.append(node("title", {}, point.label));
      svg.append(path);
      return path;
    });
    const shades = allAxes.map((axis, k) => {
      svg.append(node("line", { x1: x(k), x2: x(k), y1: TOP, y2: TOP + HEIGHT }));
      const title = node("text", { x: x(k), y: k % 2 ? 40 : 16 }, axis.title.length > 26 ? axis.title.slice(0, 25) + "…" : axis.title);
      title.append(node("title", {}, axis.title));
      svg.append(title);
      const ends = axis.constant ? [[String(round(axis.low)).replace("-", "−"), axis.low]] : axis.words ? axis.words.map((word, at) => [word, at]) : [[String(round(axis.low)).replace("-", "−"), axis.low], [String(round(axis.high)).replace("-", "−"), axis.high]];
      for (const [text, at] of ends) svg.append(node("text", { x: x(k), y: axis.words ? y(axis, at) - 4 : at === axis.low ? TOP + HEIGHT + 17 : TOP - 7, class: "tick" }, text));
      const shade = node("rect", { x: x(k) - 9, width: 18, class: "brush", visibility: "hidden" });
      const grip = node("rect", { x: x(k) - 22, y: TOP - 6, width: 44, height: HEIGHT + 12, class: "grip", "data-axis": axis.id });
      svg.append(shade, grip);
      let from = null;
      const place = (event) => {
        const matrix = svg.getScreenCTM().inverse(), pointer = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix);
        return valueAt(axis, Math.min(Math.max(pointer.y, TOP), TOP + HEIGHT));
      };
      grip.addEventListener("pointerdown", (event) => { from = place(event); labbook.dragging = true; grip.setPointerCapture(event.pointerId); });
      grip.addEventListener("pointermove", (event) => {
        if (from === null) return;
        const to = place(event);
        brushes.set(axis.id, [Math.min(from, to), Math.max(from, to)]);
        apply();
      });
      grip.addEventListener("pointerup", (event) => {
        if (from !== null && Math.abs(place(event) - from) < 0.01 * (axis.high - axis.low)) brushes.delete(axis.id); // a click clears
        from = null;
        labbook.dragging = false;
        apply(true);
      });
      return shade;
    });
    const fields = allAxes.map((axis) => {
      if (axis.words) return null;
      const set = document.createElement("fieldset"), title = document.createElement("legend");
      title.textContent = axis.title;
      set.append(title);
      const pair = ["from", "to"].map((word) => {
        const label = document.createElement("label"), field = document.createElement("input");
        field.type = "number";
        field.step = "any";
        label.append(word, field);
        set.append(label);
        field.addEventListener("change", () => {
          const [low, high] = pair.map((input) => input.value);
          if (low === "" && high === "") brushes.delete(axis.id);
          else brushes.set(axis.id, [low === "" ? axis.low : Number(low), high === "" ? axis.high : Number(high)]);
          apply(true);
        });
        return field;
      });
      form.append(set);
      return pair;
    });
    form.addEventListener("submit", (event) => event.preventDefault());
    clear.addEventListener("click", () => { brushes.clear(); apply(true); });

    function apply(last) {
      allAxes.forEach((axis, k) => {
        const range = brushes.get(axis.id), shade = shades[k];
        shade.setAttribute("visibility", range ? "visible" : "hidden");
        if (range) {
          const high = Math.min(range[1], axis.high), low = Math.max(range[0], axis.low);
          shade.setAttribute("y", y(axis, high));
          shade.setAttribute("height", Math.max(y(axis, low) - y(axis, high), 2));
        }
        if (fields[k]) fields[k].forEach((field, end) => { if (document.activeElement !== field) field.value = range ? round(range[end]) : ""; });
      });
      const matching = new Set();
      data.points.forEach((point, k) => {
        const fits = allAxes.every((axis) => {
          const range = brushes.get(axis.id), value = axis.of(point), slack = 1e-9 * (axis.high - axis.low);
          return !range || (value !== null && value >= range[0] - slack && value <= range[1] + slack);
        });
        lines[k].classList.toggle("off", !fits);
        if (fits) matching.add(point.n);
      });
      clear.hidden = !brushes.size;
      labbook.choose(brushes.size ? matching : null);
      if (last) labbook.set({ brush: [...brushes].map(([id, [low, high]]) => `${id}~${round(low)}~${round(high)}`).join(";") });
    }
    holder.replaceChildren(svg);
    apply();
  }

  labbook.ready(() => {
    const holder = document.getElementById("parallel"), data = labbook.data();
    if (!labbook.once(holder, "drawn")) return;
    if (labbook.get("brush")) holder.closest("details").open = true; // the address names ranges
    draw(holder, document.getElementById("ranges"), document.getElementById("parallel-clear"), data);
  });
})();
