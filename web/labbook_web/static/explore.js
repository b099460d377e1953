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
    const element = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.append(...children);
    return element;
  }

  function start(root, data) {
    const get = (id) => document.getElementById(id), form = document.body.dataset;
    const href = (n) => ("static" in form ? `point/${n}.html` : root.dataset.points.replace("/point/0", `/point/${n}`));
    let view = null, state = null;

    function open(number, query) {
      view = data.views[number];
      // The first design is a simulated one, in the middle.
      const off = (point) => Math.hypot(...point.at.map((value, k) => surfaces.scaled(view.factors[k], value)));
      const middle = view.points.filter((point) => point.used).sort((a, b) => off(a) - off(b))[0].at;
      const requested = (query.at || "").split(",").map((text, k) => (text === "" || !view.factors[k] ? NaN : Number(text) / view.factors[k].scale));
      state = {
        view: number,
        at: middle.map((value, k) => (Number.isFinite(requested[k]) ? clamp(view.factors[k], requested[k]) : value)),
        want: query.want && Number.isFinite(Number(query.want)) ? Number(query.want) / view.quantity.scale : rounded(surfaces.predict(view, middle)[0], view.quantity.scale),
        over: key(query.over, 0), x: key(query.x, 0), y: key(query.y, 1),
      };
      if (state.x === state.y && view.factors.length > 1) state.y = state.x === 0 ? 1 : 0;
      for (const part of document.querySelectorAll("[data-view]")) part.hidden = Number(part.dataset.view) !== number;
      get("method").textContent = `${view.method.charAt(0).toUpperCase()}${view.method.slice(1)}. Nothing is answered outside of the points.`;
      controls();
      draw();
    }

    const key = (name, other) => { const at = view.factors.findIndex((factor) => factor.key === name); return at < 0 ? Math.min(other, view.factors.length - 1) : at; };
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
      const quantity = view.quantity, prediction = surfaces.predict(view, state.at);
      get("value").textContent = prediction ? digits(prediction[0], prediction[1], prediction[2], quantity.scale) : "–";
      get("value-unit").textContent = quantity.unit;
      get("interval").textContent = prediction ? `95 %: ${digits(prediction[1], prediction[1], prediction[2], quantity.scale)} to ${digits(prediction[2], prediction[1], prediction[2], quantity.scale)} ${quantity.unit}` : "This design is not between the points: no answer.";
      view.factors.forEach((factor, k) => {
        const [range, exact] = get("sliders").children[k].querySelectorAll("input"), text = place(factor, state.at[k]);
        range.value = Math.round((surfaces.scaled(factor, state.at[k]) + 1) / 2 * STEPS);
        range.setAttribute("aria-valuetext", withUnit(text, factor.unit));
        exact.value = Number((state.at[k] * factor.scale).toPrecision(4));
      });
      const [low, high] = bounds();
      get("want").value = Math.round((state.want - low) / (high - low) * STEPS);
      get("want").setAttribute("aria-valuetext", withUnit(maps.plain(state.want * quantity.scale), quantity.unit));
      get("want-number").value = Number((state.want * quantity.scale).toPrecision(5));
      near();
      answers();
      study();
      const moved = (values) => { state.at = values.map((value, k) => clamp(view.factors[k], rounded(value, view.factors[k].scale))); draw(); };
      (view.factors.length > 1 ? maps.map : maps.curve)(get("field"), view, state, href, moved);
      const axes = view.factors.length > 1 ? [state.x, state.y] : [0];
      get("map-title").textContent = `${maps.heading(quantity)} over ${axes.map((k) => view.factors[k].spoken).join(" and ")}`;
      caption();
      labbook.set({
        view: state.view || null, at: state.at.map((value, k) => Number((value * view.factors[k].scale).toPrecision(4))).join(","),
        want: Number((state.want * quantity.scale).toPrecision(5)), over: view.factors.length > 1 ? view.factors[state.over].key : null,
        x: view.factors.length > 2 ? view.factors[state.x].key : null, y: view.factors.length > 2 ? view.factors[state.y].key : null,
      });
    }

    function near() {
      const u = view.factors.map((factor, k) => surfaces.scaled(factor, state.at[k]));
      const away = (point) => Math.hypot(...view.factors.map((factor, k) => surfaces.scaled(factor, point.at[k]) - u[k]));
      const [point] = [...view.points].filter((candidate) => candidate.at.every((x) => typeof x === "number")).sort((a, b) => away(a) - away(b));
      if (!point) return;
      const quantity = view.quantity, value = point.value && point.used ? `${digits(point.value[0], point.value[1], point.value[2], quantity.scale)} ${quantity.unit}`.trim() + (point.value[1] === null ? "" : ` (${digits(point.value[1], point.value[1], point.value[2], quantity.scale)} to ${digits(point.value[2], point.value[1], point.value[2], quantity.scale)})`) + `, n = ${point.value[3]}` : point.clogged || "no value";
      get("nearest").replaceChildren("Nearest simulated point: ", node("a", { href: href(point.n) }, `${point.n}`), ` (${point.label}): ${value}`);
    }

    function withInterval(answer, factor) {
      if (answer.value === undefined) return answer.why;
      const low = answer.low ?? factor.low, high = answer.high ?? factor.high, text = (value) => digits(value, low, high, factor.scale);
      return `${text(answer.value)} (${answer.low === null ? "below" : text(answer.low)} to ${answer.high === null ? "beyond" : text(answer.high)})`;
    }

    function answers() {
      const factor = view.factors[state.over], quantity = view.quantity, answer = surfaces.inverse(view, state.want, state.over, state.at);
      const wish = withUnit(`${quantity.label} = ${maps.plain(state.want * quantity.scale)}`, quantity.unit);
      const fixedKeys = view.factors.filter((_, k) => k !== state.over).map((fixed) => setting(fixed, state.at[view.factors.indexOf(fixed)])).join(", ");
      const where = fixedKeys ? ` at ${fixedKeys}` : "";
      if (answer.value === undefined) {
        const reach = answer.low === undefined ? "" : `: ${quantity.label} is ${maps.plain(answer.low * quantity.scale)} to ${maps.plain(answer.high * quantity.scale)} ${quantity.unit} there`.trimEnd();
        get("answer").textContent = answer.why.startsWith("at ") ? `${wish} is reached ${answer.why} of ${factor.label}${where}.` : answer.low === undefined ? `No points are near${where}.` : `${wish} is not reached${where}${reach}.`;
      } else {
        const open = answer.low === null || answer.high === null ? " The swept range does not bound the interval." : "";
        get("answer").replaceChildren(`${wish} needs `, node("b", {}, withUnit(`${factor.label} = ${withInterval(answer, factor).split(" (")[0]}`, factor.unit)), ` (95 %: ${withInterval(answer, factor).split(" (")[1]}${where}.${open}`);
      }
      const table = get("answers");
      table.replaceChildren();
      if (view.factors.length < 2) return;
      const rowIndex = state.over === state.y || view.factors.length < 2 ? state.x : state.y, rowFactor = view.factors[rowIndex];
      const rows = rowFactor.values.filter((value) => value >= rowFactor.low * (1 - 1e-9) && value <= rowFactor.high * (1 + 1e-9)).map((value) => {
        const values = [...state.at];
        values[rowIndex] = value;
        return node("tr", {}, node("td", {}, place(rowFactor, value)), node("td", {}, withInterval(surfaces.inverse(view, state.want, state.over, values), factor)));
      });
      const head = node("thead", {}, node("tr", {}, node("th", { scope: "col" }, maps.heading(rowFactor)), node("th", { scope: "col" }, `${maps.heading(factor)} (95 %)`)));
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
      const excluded = view.points.filter((point) => !point.used).length, bits = [];
      if (view.factors.length > 1) {
        bits.push(`Circles are simulated points, filled by their own mean; an outer ring marks intervals wider than ±15 %. The light band has the designs whose 95 % interval holds ${maps.plain(state.want * view.quantity.scale)} ${view.quantity.unit}.`);
        if (view.factors.length > 2) bits.push(`The map is at ${view.factors.map((factor, k) => (k === state.x || k === state.y ? "" : setting(factor, state.at[k]))).filter(Boolean).join(", ")}; points of the nearest value are drawn, fainter if they lie elsewhere.`);
      } else bits.push("Bars are 95 % intervals of the points, the band that of the curve.");
      if (excluded) bits.push(`Barred circles: ${excluded} ${excluded === 1 ? "point" : "points"} left out of the surface, clogged or without a value.`);
      bits.push("Drag on the map to move the design; a click on a point leads to its runs.");
      get("caption").textContent = bits.join(" ");
    }

    get("want").addEventListener("input", () => { const [low, high] = bounds(); state.want = rounded(low + (high - low) * get("want").value / STEPS, view.quantity.scale); draw(); });
    get("want-number").addEventListener("change", () => { if (get("want-number").value !== "") { state.want = Number(get("want-number").value) / view.quantity.scale; draw(); } });
    const select = get("view"), query = Object.fromEntries(["view", "at", "want", "over", "x", "y"].map((name) => [name, labbook.get(name)]));
    const number = Math.min(Math.max(Number(query.view) || 0, 0), data.views.length - 1);
    if (select) { select.value = String(number); select.addEventListener("change", () => open(Number(select.value), {})); }
    open(number, query);
    let seen = root.clientWidth;
    new ResizeObserver(() => { if (root.clientWidth !== seen) { seen = root.clientWidth; draw(); } }).observe(root);
  }

  labbook.ready(() => {
    const root = document.getElementById("explore");
    if (labbook.once(root, "drawn")) start(root, labbook.data());
  });
})();
