// Exploring a study: a design by sliders, the designs that give a wanted value, and both on a map. See surface.js.
"use strict";

(() => {
  const STEPS = 400;

  // Digits that the half width of an interval leaves meaningful.
  function digits(value, low, high, scale) {
    const half = Math.abs(high - low) / 2 * scale;
    if (!Number.isFinite(half) || half <= 0) return maps.plain(value * scale);
    const decimals = Math.min(Math.max(1 - Math.floor(Math.log10(half)), 0), 8);
    return (value * scale).toFixed(decimals).replace("-", "−");
  }

  const rounded = (value, scale) => Number((value * scale).toPrecision(3)) / scale;
  const withUnit = (text, unit) => (unit ? `${text} ${unit}` : text);

  function node(name, attributes, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function start(root, data) {
    const get = (id) => document.getElementById(id), form = document.body.dataset;
    const href = (n) => ("static" in form ? `point/${n}.html` : root.dataset.points.replace("/point/0", `/point/${n}`));
    let view = null, state = null;

    function open(number, asked) {
      view = data.views[number];
      // The first design is a simulated one, in the middle.
      const off = (point) => Math.hypot(...point.at.map((value, k) => surfaces.scaled(view.factors[k], value)));
      const middle = view.points.filter((one) => one.used).sort((a, b) => off(a) - off(b))[0].at;
      const given = (asked.at || "").split(",").map((one, k) => (one === "" || !view.factors[k] ? NaN : Number(one) / view.factors[k].scale));
      state = {
        view: number,
        at: middle.map((one, k) => (Number.isFinite(given[k]) ? clamp(view.factors[k], given[k]) : one)),
        want: asked.want && Number.isFinite(Number(asked.want)) ? Number(asked.want) / view.quantity.scale : rounded(surfaces.predict(view, middle)[0], view.quantity.scale),
        over: key(asked.over, 0), x: key(asked.x, 0), y: key(asked.y, 1),
      };
      if (state.x === state.y && view.factors.length > 1) state.y = state.x === 0 ? 1 : 0;
      for (const part of document.querySelectorAll("[data-view]")) part.hidden = Number(part.dataset.view) !== number;
      get("method").textContent = `${view.method.charAt(0).toUpperCase()}${view.method.slice(1)}. Nothing is answered outside of the points.`;
      controls();
      draw();
    }

    const key = (name, other) => { const at = view.factors.findIndex((one) => one.key === name); return at < 0 ? Math.min(other, view.factors.length - 1) : at; };
    const clamp = (factor, value) => Math.min(Math.max(value, factor.low), factor.high);
    const bounds = () => { const [low, high] = maps.range(view), room = 0.02 * (high - low); return [low - room, high + room]; };

    function choice(label, options, value, changed) {
      const field = node("select", {});
      for (const [k, text] of options) field.add(new Option(text, k, false, k === value));
      field.addEventListener("change", () => changed(Number(field.value)));
      return node("label", {}, label, field);
    }

    function controls() {
      const names = view.factors.map((factor, k) => [k, factor.spoken]);
      get("sliders").replaceChildren(...view.factors.map((factor, k) => {
        const label = node("legend", { id: `key-${k}` }, maps.heading({ label: factor.spoken, unit: factor.unit }));
        const range = node("input", { type: "range", min: 0, max: STEPS, step: 1, "aria-labelledby": `key-${k}`, "data-key": factor.key });
        const exact = node("input", { type: "number", step: "any", "aria-labelledby": `key-${k}`, "data-exact": factor.key });
        range.addEventListener("input", () => set(k, rounded(surfaces.unscaled(factor, 2 * range.value / STEPS - 1), factor.scale)));
        exact.addEventListener("change", () => { if (exact.value !== "") set(k, Number(exact.value) / factor.scale); });
        return node("fieldset", { class: "slider" }, label, range, exact);
      }));
      get("want-label").textContent = maps.heading(view.quantity);
      const several = view.factors.length > 1;
      get("solve").replaceChildren(...(several ? [choice("by changing", names, state.over, (k) => { state.over = k; draw(); })] : []));
      get("axes").replaceChildren(...(view.factors.length > 2 ? [
        choice("Horizontal", names, state.x, (k) => { if (k === state.y) state.y = state.x; state.x = k; controls(); draw(); }),
        choice("Vertical", names, state.y, (k) => { if (k === state.x) state.x = state.y; state.y = k; controls(); draw(); }),
      ] : []));
    }

    function set(k, value) {
      state.at[k] = clamp(view.factors[k], value);
      draw();
    }

    const place = (factor, value) => `${maps.plain(value * factor.scale)}`;
    const setting = (factor, value) => withUnit(`${factor.label} = ${place(factor, value)}`, factor.unit);

    function draw() {
      const shown = view.quantity, found = surfaces.predict(view, state.at);
      get("value").textContent = found ? digits(found[0], found[1], found[2], shown.scale) : "–";
      get("value-unit").textContent = shown.unit;
      get("interval").textContent = found ? `95 %: ${digits(found[1], found[1], found[2], shown.scale)} to ${digits(found[2], found[1], found[2], shown.scale)} ${shown.unit}` : "This design is not between the points: no answer.";
      view.factors.forEach((factor, k) => {
        const [range, exact] = get("sliders").children[k].querySelectorAll("input"), text = place(factor, state.at[k]);
        range.value = Math.round((surfaces.scaled(factor, state.at[k]) + 1) / 2 * STEPS);
        range.setAttribute("aria-valuetext", withUnit(text, factor.unit));
        exact.value = Number((state.at[k] * factor.scale).toPrecision(4));
      });
      const [low, high] = bounds();
      get("want").value = Math.round((state.want - low) / (high - low) * STEPS);
      get("want").setAttribute("aria-valuetext", withUnit(maps.plain(state.want * shown.scale), shown.unit));
      get("want-number").value = Number((state.want * shown.scale).toPrecision(5));
      near();
      answers();
      study();
      const moved = (values) => { state.at = values.map((one, k) => clamp(view.factors[k], rounded(one, view.factors[k].scale))); draw(); };
      (view.factors.length > 1 ? maps.map : maps.curve)(get("field"), view, state, href, moved);
      const axes = view.factors.length > 1 ? [state.x, state.y] : [0];
      get("map-title").textContent = `${maps.heading(shown)} over ${axes.map((k) => view.factors[k].spoken).join(" and ")}`;
      caption();
      labbook.set({
        view: state.view || null, at: state.at.map((one, k) => Number((one * view.factors[k].scale).toPrecision(4))).join(","),
        want: Number((state.want * shown.scale).toPrecision(5)), over: view.factors.length > 1 ? view.factors[state.over].key : null,
        x: view.factors.length > 2 ? view.factors[state.x].key : null, y: view.factors.length > 2 ? view.factors[state.y].key : null,
      });
    }

    function near() {
      const u = view.factors.map((factor, k) => surfaces.scaled(factor, state.at[k]));
      const away = (point) => Math.hypot(...view.factors.map((factor, k) => surfaces.scaled(factor, point.at[k]) - u[k]));
      const [point] = [...view.points].filter((one) => one.at.every((x) => typeof x === "number")).sort((a, b) => away(a) - away(b));
      if (!point) return;
      const shown = view.quantity, value = point.value && point.used ? `${digits(point.value[0], point.value[1], point.value[2], shown.scale)} ${shown.unit}`.trim() + (point.value[1] === null ? "" : ` (${digits(point.value[1], point.value[1], point.value[2], shown.scale)} to ${digits(point.value[2], point.value[1], point.value[2], shown.scale)})`) + `, n = ${point.value[3]}` : point.clogged || "no value";
      get("nearest").replaceChildren("Nearest simulated point: ", node("a", { href: href(point.n) }, `${point.n}`), ` (${point.label}): ${value}`);
    }

    function said(answer, factor) {
      if (answer.value === undefined) return answer.why;
      const low = answer.low ?? factor.low, high = answer.high ?? factor.high, text = (value) => digits(value, low, high, factor.scale);
      return `${text(answer.value)} (${answer.low === null ? "below" : text(answer.low)} to ${answer.high === null ? "beyond" : text(answer.high)})`;
    }

    function answers() {
      const factor = view.factors[state.over], shown = view.quantity, here = surfaces.inverse(view, state.want, state.over, state.at);
      const wish = withUnit(`${shown.label} = ${maps.plain(state.want * shown.scale)}`, shown.unit);
      const others = view.factors.filter((_, k) => k !== state.over).map((one) => setting(one, state.at[view.factors.indexOf(one)])).join(", ");
      const where = others ? ` at ${others}` : "";
      if (here.value === undefined) {
        const reach = here.low === undefined ? "" : `: ${shown.label} is ${maps.plain(here.low * shown.scale)} to ${maps.plain(here.high * shown.scale)} ${shown.unit} there`.trimEnd();
        get("answer").textContent = here.why.startsWith("at ") ? `${wish} is reached ${here.why} of ${factor.label}${where}.` : here.low === undefined ? `No points are near${where}.` : `${wish} is not reached${where}${reach}.`;
      } else {
        const open = here.low === null || here.high === null ? " The swept range does not bound the interval." : "";
        get("answer").replaceChildren(`${wish} needs `, node("b", {}, withUnit(`${factor.label} = ${said(here, factor).split(" (")[0]}`, factor.unit)), ` (95 %: ${said(here, factor).split(" (")[1]}${where}.${open}`);
      }
      const table = get("answers");
      table.replaceChildren();
      if (view.factors.length < 2) return;
      const rowed = state.over === state.y || view.factors.length < 2 ? state.x : state.y, other = view.factors[rowed];
      const rows = other.values.filter((one) => one >= other.low * (1 - 1e-9) && one <= other.high * (1 + 1e-9)).map((value) => {
        const values = [...state.at];
        values[rowed] = value;
        return node("tr", {}, node("td", {}, place(other, value)), node("td", {}, said(surfaces.inverse(view, state.want, state.over, values), factor)));
      });
      const head = node("thead", {}, node("tr", {}, node("th", { scope: "col" }, maps.heading(other)), node("th", { scope: "col" }, `${maps.heading(factor)} (95 %)`)));
      table.append(node("div", { class: "wide", role: "region", "aria-label": "Designs that give the wanted value", tabindex: 0 }, node("table", {}, head, node("tbody", {}, ...rows))));
    }

    function study() {
      const values = view.factors.map((factor, k) => `${factor.key}: ${withUnit(Number((state.at[k] * factor.yaml.scale).toPrecision(4)), factor.yaml.unit)}`);
      const fixed = Object.entries(view.at).map(([name, value]) => `${name}: ${value}`);
      const text = `${view.study}points:\n- {${[...fixed, ...values].join(", ")}}\n`;
      get("design-study").textContent = text;
      get("design-copy").dataset.copy = text;
      get("design-save").dataset.save = text;
    }

    function caption() {
      const left = view.points.filter((one) => !one.used).length, bits = [];
      if (view.factors.length > 1) {
        bits.push(`Circles are simulated points, filled by their own mean; an outer ring marks intervals wider than ±15 %. The light band has the designs whose 95 % interval holds ${maps.plain(state.want * view.quantity.scale)} ${view.quantity.unit}.`);
        if (view.factors.length > 2) bits.push(`The map is at ${view.factors.map((one, k) => (k === state.x || k === state.y ? "" : setting(one, state.at[k]))).filter(Boolean).join(", ")}; points of the nearest value are drawn, fainter if they lie elsewhere.`);
      } else bits.push("Bars are 95 % intervals of the points, the band that of the curve.");
      if (left) bits.push(`Barred circles: ${left} ${left === 1 ? "point" : "points"} left out of the surface, clogged or without a value.`);
      bits.push("Drag on the map to move the design; a click on a point leads to its runs.");
      get("caption").textContent = bits.join(" ");
    }

    get("want").addEventListener("input", () => { const [low, high] = bounds(); state.want = rounded(low + (high - low) * get("want").value / STEPS, view.quantity.scale); draw(); });
    get("want-number").addEventListener("change", () => { if (get("want-number").value !== "") { state.want = Number(get("want-number").value) / view.quantity.scale; draw(); } });
    const select = get("view"), asked = Object.fromEntries(["view", "at", "want", "over", "x", "y"].map((name) => [name, labbook.get(name)]));
    const number = Math.min(Math.max(Number(asked.view) || 0, 0), data.views.length - 1);
    if (select) { select.value = String(number); select.addEventListener("change", () => open(Number(select.value), {})); }
    open(number, asked);
    let seen = root.clientWidth;
    new ResizeObserver(() => { if (root.clientWidth !== seen) { seen = root.clientWidth; draw(); } }).observe(root);
  }

  labbook.ready(() => {
    const root = document.getElementById("explore");
    if (labbook.once(root, "drawn")) start(root, labbook.data());
  });
})();
