// A map of a quantity over two keys, or its curve over one: points with their own mean, the surface only between them.
"use strict";

const maps = (() => {
  const VIRIDIS = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"]
    .map((code) => [1, 3, 5].map((k) => parseInt(code.slice(k, k + 2), 16)));
  const BLOCK = 3, LARGE = 6, MANY = 30; // pixels of the map for each evaluation of the surface, and of one of more terms
  const WIDE = 0.15; // half width of an interval, over the value, from which on a point has a ring
  const SVG = "http://www.w3.org/2000/svg";

  function colour(part) {
    const place = Math.min(Math.max(part, 0), 1) * (VIRIDIS.length - 1), at = Math.min(Math.floor(place), VIRIDIS.length - 2);
    return VIRIDIS[at].map((channel, k) => Math.round(channel + (place - at) * (VIRIDIS[at + 1][k] - channel)));
  }

  function element(parent, name, attributes, text) {
    const child = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) child.setAttribute(key, value);
    if (text !== undefined) child.textContent = text;
    parent.append(child);
    return child;
  }

  // Round numbers within a range, about `count` of them.
  function ticks(low, high, count) {
    const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((factor) => factor >= rough * 0.999);
    const values = [];
    for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n += 1) values.push(Number((n * step).toPrecision(12)));
    return values;
  }

  const plain = (value) => Number(value.toPrecision(4)).toString().replace("-", "−");
  const heading = (quantity) => (quantity.unit ? `${quantity.label} [${quantity.unit}]` : quantity.label);

  // Ticks of a key: its swept values while they have room, else round numbers.
  function places(factor, length) {
    const room = factor.values.length * 34 <= length ? factor.values : ticks(factor.low * factor.scale, factor.high * factor.scale, 5).map((value) => value / factor.scale);
    return room.filter((value) => value > 0 || !factor.logarithmic);
  }

  // Ticks whose labels have room: those nearer than `room` pixels to the one before are left out.
  function apart(values, place, room) {
    const labelled = [];
    for (const value of [...values].sort((a, b) => a - b)) if (!labelled.length || Math.abs(place(value) - place(labelled.at(-1))) >= room) labelled.push(value);
    return labelled;
  }

  function frame(holder, label) {
    holder.replaceChildren();
    const width = Math.max(holder.clientWidth, 260), height = Math.round(Math.min(Math.max(width * 0.72, 300), 540));
    const canvas = document.createElement("canvas"), svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("height", height);
    svg.setAttribute("role", "group");
    svg.setAttribute("aria-label", label);
    holder.append(canvas, svg);
    return { width, height, canvas, svg };
  }

  // Where the axes begin and end in scaled keys: room for points beyond the surface, such as clogged ones.
  function extent(factor) {
    const all = factor.values.map((value) => surfaces.scaled(factor, value)).filter(Number.isFinite);
    const low = Math.min(-1, ...all), high = Math.max(1, ...all), room = 0.06 * (high - low);
    return [low - room, high + room];
  }

  function axes(svg, box, X, Y, x, y) {
    const { left, right, top, bottom } = box;
    for (const tick of x.ticks) element(svg, "line", { class: "axis", x1: X(tick), x2: X(tick), y1: bottom, y2: bottom + 4 });
    for (const tick of apart(x.ticks, X, 34)) element(svg, "text", { x: X(tick), y: bottom + 18, "text-anchor": "middle" }, plain(tick * x.scale));
    for (const tick of y.ticks) element(svg, "line", { class: "axis", x1: left - 4, x2: left, y1: Y(tick), y2: Y(tick) });
    for (const tick of apart(y.ticks, Y, 14)) element(svg, "text", { x: left - 7, y: Y(tick) + 4, "text-anchor": "end" }, plain(tick * y.scale));
    element(svg, "path", { class: "axis", d: `M${left},${top}V${bottom}H${right}` });
    element(svg, "text", { x: (left + right) / 2, y: bottom + 37, "text-anchor": "middle" }, heading(x));
    element(svg, "text", { transform: `translate(13 ${(top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, heading(y));
  }

  // A point that clogged or has no number: a circle with a bar through it.
  function barred(parent, x, y) {
    element(parent, "circle", { class: "barred", cx: x, cy: y, r: 7 });
    element(parent, "line", { class: "barred", x1: x - 5, x2: x + 5, y1: y + 5, y2: y - 5 });
  }

  function linked(svg, view, point, href) {
    const quantity = view.quantity, format = (value) => plain(value * quantity.scale);
    const value = point.value === null ? "no value" : `${format(point.value[0])} ${quantity.unit}` + (point.value[1] === null ? "" : ` (${format(point.value[1])} to ${format(point.value[2])}), n = ${point.value[3]}`);
    const text = `Point ${point.n}: ${point.label}: ${value}${point.clogged ? `; ${point.clogged}` : ""}`;
    const link = element(svg, "a", { href: href(point.n), "aria-label": text, "data-point": point.n });
    element(link, "title", {}, text);
    return link;
  }

  const range = (view) => {
    const values = view.points.filter((point) => point.used).map((point) => point.value[0]);
    return [Math.min(...values), Math.max(...values)];
  };

  // Over two keys. `state`: values of all keys, wanted value, numbers of the keys on the axes; `moved`: told of new values,
  // null for a map without a design.
  function map(holder, view, state, href, moved) {
    const { width, height, canvas, svg } = frame(holder, `Map of ${view.quantity.label} over ${view.factors[state.x].label} and ${view.factors[state.y].label}; the table of points on the page of the study has its numbers`);
    const box = { left: 58, right: width - 64, top: 10, bottom: height - 46 };
    const fx = view.factors[state.x], fy = view.factors[state.y], [x0, x1] = extent(fx), [y0, y1] = extent(fy);
    const ofX = (u) => box.left + (u - x0) / (x1 - x0) * (box.right - box.left), ofY = (u) => box.bottom - (u - y0) / (y1 - y0) * (box.bottom - box.top);
    const X = (value) => ofX(surfaces.scaled(fx, value)), Y = (value) => ofY(surfaces.scaled(fy, value));
    const [low, high] = range(view), part = (value) => (value - low) / (high - low || 1);

    // The surface, in blocks: transparent outside of the points, lighter where its interval holds the wanted value.
    canvas.style.cssText = `left:${100 * box.left / width}%;top:${100 * box.top / height}%;width:${100 * (box.right - box.left) / width}%;height:${100 * (box.bottom - box.top) / height}%`;
    let drawn = 0;
    if (view.surface) {
      const block = view.surface.coefficients.length > MANY ? LARGE : BLOCK;
      const columns = Math.ceil((box.right - box.left) / block), rows = Math.ceil((box.bottom - box.top) / block);
      canvas.width = columns; canvas.height = rows;
      const picture = canvas.getContext("2d"), image = picture.createImageData(columns, rows);
      const u = view.factors.map((factor, k) => surfaces.scaled(factor, state.at[k]));
      for (let row = 0; row < rows; row += 1) for (let column = 0; column < columns; column += 1) {
        u[state.x] = x0 + (column + 0.5) / columns * (x1 - x0);
        u[state.y] = y1 - (row + 0.5) / rows * (y1 - y0);
        if (!surfaces.inside(view.surface, u)) continue;
        const [value, lower, upper] = surfaces.band(view, u), light = lower <= state.want && state.want <= upper ? 0.6 : 0;
        const rgb = colour(part(value)), at = 4 * (row * columns + column);
        rgb.forEach((channel, k) => { image.data[at + k] = channel + light * (255 - channel); });
        image.data[at + 3] = 255;
        drawn += 1;
      }
      picture.putImageData(image, 0, 0);
    }
    holder.dataset.blocks = drawn;

    axes(svg, box, X, Y, { ...fx, ticks: places(fx, box.right - box.left) }, { ...fy, ticks: places(fy, box.bottom - box.top) });
    const hit = moved && element(svg, "rect", { class: "hit", x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top });

    // Of points at one place of the map the one that is nearest in the other keys is drawn, fainter if it is elsewhere.
    const design = view.factors.map((factor, k) => surfaces.scaled(factor, state.at[k])), nearest = new Map();
    const away = (point) => Math.hypot(...view.factors.map((factor, k) => (k === state.x || k === state.y ? 0 : surfaces.scaled(factor, point.at[k]) - design[k])));
    for (const point of view.points) {
      const id = `${point.at[state.x]} ${point.at[state.y]}`, other = nearest.get(id);
      if (!other || away(point) < away(other) - 1e-9) nearest.set(id, point);
    }
    for (const point of nearest.values()) {
      const x = X(point.at[state.x]), y = Y(point.at[state.y]);
      if (!Number.isFinite(x) || !Number.isFinite(y)) continue;
      const link = linked(svg, view, point, href);
      link.setAttribute("opacity", away(point) < 1e-6 ? 1 : 0.55);
      if (!point.used) { barred(link, x, y); continue; }
      const [value, lower, upper] = point.value;
      if (lower === null || (upper - lower) / 2 > WIDE * Math.abs(value)) element(link, "circle", { class: "wide-interval", cx: x, cy: y, r: 11.5 });
      element(link, "circle", { class: "rim", cx: x, cy: y, r: 8.3 });
      element(link, "circle", { class: "point", cx: x, cy: y, r: 7, fill: `rgb(${colour(part(value))})` });
    }
    const x = X(state.at[state.x]), y = Y(state.at[state.y]);
    if (moved) for (const name of ["halo", "core"]) element(svg, "path", { class: name, d: `M${x - 11},${y}H${x + 11}M${x},${y - 11}V${y + 11}`, "pointer-events": "none" });

    // The colours.
    const shades = element(element(svg, "defs", {}), "linearGradient", { id: "shades", x1: 0, x2: 0, y1: 1, y2: 0 });
    for (let k = 0; k <= 12; k += 1) element(shades, "stop", { offset: k / 12, "stop-color": `rgb(${colour(k / 12)})` });
    element(svg, "rect", { x: box.right + 14, y: box.top, width: 12, height: box.bottom - box.top, fill: "url(#shades)" });
    const scale = view.quantity.scale;
    for (const tick of ticks(low * scale, high * scale, 5)) element(svg, "text", { x: box.right + 30, y: box.bottom - part(tick / scale) * (box.bottom - box.top) + 4 }, plain(tick));
    holder.dataset.points = nearest.size;
    if (hit) drag(hit, svg, (px, py) => {
      const values = [...state.at];
      values[state.x] = surfaces.unscaled(fx, Math.min(Math.max(x0 + (px - box.left) / (box.right - box.left) * (x1 - x0), -1), 1));
      values[state.y] = surfaces.unscaled(fy, Math.min(Math.max(y1 - (py - box.top) / (box.bottom - box.top) * (y1 - y0), -1), 1));
      moved(values);
    });
  }

  // Over one key: curve, band, points with their intervals, and what gives the wanted value.
  function curve(holder, view, state, href, moved) {
    const { width, height, svg } = frame(holder, `${view.quantity.label} against ${view.factors[0].label}; the table of points on the page of the study has its numbers`);
    const box = { left: 58, right: width - 14, top: 10, bottom: height - 46 }, factor = view.factors[0];
    const all = [factor.low, factor.high, ...factor.values], room = 0.04 * (Math.max(...all) - Math.min(...all));
    const x0 = Math.min(...all) - room, x1 = Math.max(...all) + room;
    const s = view.surface, places_ = Array.from({ length: 129 }, (_, k) => factor.low + (factor.high - factor.low) * k / 128), values = places_.map((x) => surfaces.predict(view, [x]));
    const tops = [...values.map((band) => band[2]), ...view.points.filter((point) => point.value).map((point) => point.value[2] ?? point.value[0])];
    const bottoms = [...values.map((band) => band[1]), ...view.points.filter((point) => point.value).map((point) => point.value[1] ?? point.value[0])];
    const top = Math.max(...tops), least = Math.min(0, ...bottoms), y0 = least, y1 = top + 0.05 * (top - least);
    const X = (value) => box.left + (value - x0) / (x1 - x0) * (box.right - box.left), Y = (value) => box.bottom - (value - y0) / (y1 - y0) * (box.bottom - box.top);
    const scale = view.quantity.scale, levels = ticks(y0 * scale, y1 * scale, 6).map((tick) => tick / scale);
    for (const level of levels) element(svg, "line", { class: "grid", x1: box.left, x2: box.right, y1: Y(level), y2: Y(level) });
    axes(svg, box, X, Y, { ...factor, ticks: places(factor, box.right - box.left) }, { ...view.quantity, ticks: levels });
    const path = (index) => values.map((band, k) => `${X(places_[k]).toFixed(1)},${Y(band[index]).toFixed(1)}`);
    element(svg, "path", { class: "band", d: `M${path(1).join("L")}L${path(2).reverse().join("L")}Z` });
    element(svg, "path", { class: "law", d: `M${path(0).join("L")}` });
    const answer = surfaces.inverse(view, state.want, 0, state.at);
    if (answer.value !== undefined) {
      const from = X(answer.low ?? factor.low), to = X(answer.high ?? factor.high);
      element(svg, "rect", { class: "wanted-range", x: from, width: Math.max(to - from, 1), y: Y(state.want), height: box.bottom - Y(state.want) });
      element(svg, "path", { class: "wanted", d: `M${box.left},${Y(state.want)}H${X(answer.value)}V${box.bottom}` });
    }
    const hit = element(svg, "rect", { class: "hit", x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top });
    for (const point of view.points) {
      const link = linked(svg, view, point, href), x = X(point.at[0]);
      if (!point.used) { barred(link, x, box.bottom - 12); continue; }
      const [value, lower, upper] = point.value;
      if (lower !== null) element(link, "path", { class: "bar-line", d: `M${x},${Y(lower)}V${Y(upper)}M${x - 3},${Y(lower)}h6M${x - 3},${Y(upper)}h6` });
      element(link, "circle", { class: "point", cx: x, cy: Y(value), r: 5.5, fill: "var(--accent)" });
    }
    const prediction = surfaces.predict(view, state.at);
    if (prediction) for (const name of ["halo", "core"]) element(svg, "path", { class: name, d: `M${X(state.at[0]) - 10},${Y(prediction[0])}h20M${X(state.at[0])},${Y(prediction[0]) - 10}v20`, "pointer-events": "none" });
    holder.dataset.blocks = s ? values.length : 0;
    drag(hit, svg, (px) => moved([Math.min(Math.max(x0 + (px - box.left) / (box.right - box.left) * (x1 - x0), factor.low), factor.high)]));
  }

  function drag(hit, svg, moved) {
    const tell = (event) => {
      const seen = svg.getBoundingClientRect(), box = svg.viewBox.baseVal;
      moved((event.clientX - seen.left) * box.width / seen.width, (event.clientY - seen.top) * box.height / seen.height);
    };
    hit.addEventListener("pointerdown", (event) => {
      const move = (motion) => tell(motion), stop = () => { window.removeEventListener("pointermove", move); window.removeEventListener("pointerup", stop); };
      window.addEventListener("pointermove", move); // the map is drawn anew while it is dragged
      window.addEventListener("pointerup", stop);
      tell(event);
    });
  }

  return { map, curve, range, plain, heading, ticks };
})();

// The map on the page of a study: points that are chosen elsewhere on the page stay, the others fade.
labbook.ready(() => {
  const holder = document.getElementById("map"), view = holder && labbook.data() && labbook.data().map;
  if (!view || !labbook.once(holder, "drawn")) return;
  const state = { x: 0, y: 1, at: view.points[0].at, want: NaN };
  const row = (n) => document.querySelector(`#points tr[data-point="${n}"] a`);
  const render = () => {
    if (!holder.isConnected) return; // the page was shown anew
    maps.map(holder, view, state, (n) => (row(n) ? row(n).href : "#points-title"), null);
    for (const link of holder.querySelectorAll("a[data-point]")) if (labbook.chosen && !labbook.chosen.has(Number(link.dataset.point))) link.setAttribute("opacity", 0.12);
  };
  render();
  document.addEventListener("labbook:chosen", render);
  window.addEventListener("resize", render);
});

// A map as it is drawn: its colours as an image within the drawing, styles of the page as attributes.
document.addEventListener("click", (event) => {
  const button = event.target.closest("button.drawing"), holder = button && document.getElementById(button.dataset.drawing);
  if (!holder) return;
  const svg = holder.querySelector("svg"), canvas = holder.querySelector("canvas"), copy = svg.cloneNode(true), box = svg.viewBox.baseVal;
  const from = [...svg.querySelectorAll("*")], to = [...copy.querySelectorAll("*")];
  from.forEach((source, k) => { const style = getComputedStyle(source); for (const name of ["fill", "stroke", "stroke-width", "font-size", "font-family", "text-anchor", "opacity"]) to[k].setAttribute(name, style.getPropertyValue(name)); });
  const node = (name, attributes) => { const child = document.createElementNS("http://www.w3.org/2000/svg", name); for (const [key, value] of Object.entries(attributes)) child.setAttribute(key, value); return child; };
  const part = (name, length) => (parseFloat(canvas.style[name]) / 100) * length;
  if (canvas) copy.prepend(node("image", { href: canvas.toDataURL(), x: part("left", box.width), y: part("top", box.height), width: part("width", box.width), height: part("height", box.height), preserveAspectRatio: "none", opacity: getComputedStyle(canvas).opacity }));
  copy.prepend(node("rect", { width: box.width, height: box.height, fill: getComputedStyle(document.documentElement).getPropertyValue("--paper").trim() }));
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.setAttribute("width", box.width);
  labbook.save(new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }), `${button.dataset.file}.svg`);
});
