// Charts of a page: what was measured against what was swept, W(t) of runs, and ledgers. Data stand in the page.
"use strict";

(() => {
  const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b58900", "#56b4e9", "#7a5195", "#444b54"];
  const COLOURS_DARK = ["#56b4e9", "#ff8c42", "#3ccb9b", "#e39ac4", "#f0c75e", "#9ad1f5", "#b794e0", "#c3cad2"];
  const SYMBOLS = ["circle", "square", "diamond", "triangle-up", "triangle-down", "pentagon", "hexagon", "star"];
  const DASHES = ["solid", "dash", "dot", "dashdot"];
  const VIRIDIS = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39"];
  const FLOWS = ["flow_rate", "grain_rate"];
  const CURVES = 6, PANELS = 36; // curves that one panel has at most, and panels of a chart
  const OPEN = 24, FACTOR = 1.12; // half a bar without ends: pixels, and on a logarithmic scale
  const scheme = matchMedia("(prefers-color-scheme: dark)");

  function theme() {
    const style = getComputedStyle(document.documentElement), get = (name) => style.getPropertyValue(name).trim();
    return { ink: get("--ink"), soft: get("--soft"), line: get("--line"), paper: get("--paper"), tint: get("--tint"), colours: scheme.matches ? COLOURS_DARK : COLOURS };
  }

  function layout(t, more) {
    const axis = { gridcolor: t.line, zerolinecolor: t.line, linecolor: t.soft, tickcolor: t.soft, automargin: true, ticks: "outside" };
    const { xaxis = {}, yaxis = {}, ...rest } = more;
    return {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: t.ink, family: "system-ui, sans-serif", size: 13 },
      margin: { l: 64, r: 16, t: 12, b: 52 }, hovermode: "closest", hoverlabel: { bgcolor: t.paper, bordercolor: t.soft, font: { color: t.ink } },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, font: { size: 12 } },
      xaxis: { ...axis, ...xaxis }, yaxis: { ...axis, ...yaxis }, ...rest,
    };
  }

  const CONFIG = { displaylogo: false, responsive: true, displayModeBar: false, showTips: false };
  const heading = (quantity) => (quantity.unit ? `${pretty(quantity.label)} [${pretty(quantity.unit)}]` : pretty(quantity.label));
  const pretty = (text) => escape(text).replace(/\^\(([^)]*)\)/g, "<sup>$1</sup>").replace(/\b(\w)_(\w+)/g, "$1<sub>$2</sub>");
  const escape = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;");
  const alpha = (colour, part) => colour + Math.round(255 * part).toString(16).padStart(2, "0");
  const rounded = (value) => (value === null || value === undefined ? "–" : Number(value.toPrecision(5)).toString().replace("-", "−"));

  // ---- measured against swept

  function studies(data) { return data.studies ? data.studies : data.points ? [data] : []; }

  function controls(form, data, state, redraw) {
    const every = studies(data), keys = {}, quantities = {}, laws = {};
    for (const one of every) {
      Object.assign(keys, one.keys);
      Object.assign(quantities, one.quantities);
      for (const series of one.series) for (const [law, fit] of Object.entries(series.laws)) laws[law] = fit.label;
    }
    form.replaceChildren();
    const select = (name, label, options) => {
      const holder = document.createElement("label"), field = document.createElement("select");
      holder.append(label, field);
      field.name = name;
      for (const [value, text] of options) field.add(new Option(text, value, false, value === state[name]));
      field.addEventListener("change", () => { state[name] = field.value; redraw(); });
      form.append(holder);
    };
    const text = (shown) => (shown.unit ? `${shown.label} [${shown.unit}]` : shown.label).replace(/\^\(([^)]*)\)/g, "^$1");
    if (!(state.x in keys)) state.x = Object.keys(keys).find((key) => keys[key].orifice) || Object.keys(keys)[0] || "";
    if (!(state.y in quantities)) state.y = Object.keys(quantities)[0] || "";
    if (Object.keys(keys).length) select("x", "Horizontal", Object.entries(keys).map(([key, one]) => [key, text(one)]));
    select("y", "Vertical", Object.entries(quantities).map(([key, one]) => [key, text(one)]));
    // A power straightens a flow rate against the outlet that it was measured at; a logarithm wants values above zero.
    const raised = FLOWS.includes(state.y) ? every.map((one) => one.outlet) : [];
    const above = every.every((one) => one.points.every((point) => !point.values[state.y] || point.values[state.y][0] > 0));
    const scales = [["linear", "linear"]];
    if (above) scales.push(["log", "logarithmic"]);
    const label = state.y in quantities ? quantities[state.y].label : "";
    if (raised.includes("slot")) scales.push(["power", `${label} to the power 2/3`]);
    if (raised.includes("hole")) scales.push(["power5", `${label} to the power 2/5`]);
    if (!scales.some(([value]) => value === state.scale)) state.scale = "linear";
    if (scales.length > 1) select("scale", "Scale", scales);
    for (const [law, label] of Object.entries(laws)) {
      const holder = document.createElement("label"), box = document.createElement("input");
      holder.className = "check";
      box.type = "checkbox";
      box.checked = !state.off.includes(law);
      box.addEventListener("change", () => {
        state.off = box.checked ? state.off.filter((one) => one !== law) : [...state.off, law];
        redraw();
      });
      holder.append(box, label);
      form.append(holder);
    }
    return { keys, quantities, laws };
  }

  function groups(study, x) {
    // Points that differ in nothing but what is on the horizontal axis are one curve.
    const found = new Map();
    for (const point of study.points) {
      const rest = Object.entries(point.at).filter(([key]) => key !== x);
      const id = JSON.stringify(rest);
      if (!found.has(id)) found.set(id, { rest, points: [] });
      found.get(id).points.push(point);
    }
    return [...found.values()];
  }

  // More curves than one can tell apart stand in panels, by the key that leaves few curves in each and few panels.
  function panelled(list, width) {
    const values = {};
    for (const group of list) for (const [key, value] of group.rest) (values[key] ||= new Map()).set(value, 0);
    const several = Object.keys(values).filter((key) => values[key].size > 1);
    if (list.length <= CURVES || !several.length) return null;
    const most = (key) => { for (const group of list) { const value = new Map(group.rest).get(key); values[key].set(value, (values[key].get(value) || 0) + 1); } return Math.max(...values[key].values()); };
    const [, , key] = several.map((one) => [Math.max(most(one), CURVES), values[one].size, one]).sort((a, b) => a[0] - b[0] || a[1] - b[1])[0];
    const every = [...values[key].keys()];
    if (typeof every[0] !== "string") every.sort((a, b) => a - b);
    if (every.length > PANELS) return null;
    const curves = new Map();
    for (const group of list) { const rest = JSON.stringify(group.rest.filter(([name]) => name !== key)); if (!curves.has(rest)) curves.set(rest, curves.size); }
    const columns = Math.min(every.length, Math.max(2, Math.min(6, Math.floor(width / 170)))), rows = Math.ceil(every.length / columns);
    return {
      key, values: every, columns, rows, curves: curves.size,
      panel: (group) => every.indexOf(new Map(group.rest).get(key)),
      curve: (group) => curves.get(JSON.stringify(group.rest.filter(([name]) => name !== key))),
    };
  }

  // Steps between neighbouring curves at one abscissa, so that no point covers another: of all of a panel together a
  // third of the distance to the next abscissa at most, as in the report's figures. On a logarithmic axis in decades.
  function apart(curves, together, log, words = 0) {
    const all = curves.flatMap((xs) => [...new Set(xs)]), values = [...new Set(all)].map((x) => (log ? Math.log10(x) : x)).sort((a, b) => a - b);
    if (values.length === all.length || !values.every(Number.isFinite)) return 0;
    const extent = words || values[values.length - 1] - values[0];
    if (values.length < 2) return words ? 0.012 : log ? 0.01 : Math.abs(values[0]) / 50 || 0.02;
    const nearest = Math.min(...values.slice(1).map((x, k) => x - values[k]));
    return Math.min(0.012 * extent, nearest / 3 / together);
  }

  const nth = (letter, place) => letter + (place ? place + 1 : "");

  function panelAxes(shape, panels, titles) {
    const { columns, rows, values } = panels, wide = (1 - 0.02 * (columns - 1)) / columns, high = 1 / rows, title = 22 / (150 * rows);
    const { xaxis, yaxis } = shape;
    shape.annotations = [];
    values.forEach((value, place) => {
      const column = place % columns, row = Math.floor(place / columns), left = column * (wide + 0.02), bottom = 1 - (row + 1) * high;
      const lowest = place + columns >= values.length, x = nth("x", place), y = nth("y", place);
      shape[`xaxis${place ? place + 1 : ""}`] = { ...xaxis, domain: [left, left + wide], anchor: y, matches: place ? "x" : undefined, showticklabels: lowest, nticks: 4, title: { text: lowest && column === Math.floor((columns - 1) / 2) ? xaxis.title.text : "" } };
      shape[`yaxis${place ? place + 1 : ""}`] = { ...yaxis, domain: [bottom + 0.25 * title, bottom + high - title], anchor: x, matches: place ? "y" : undefined, showticklabels: column === 0, nticks: 4, title: { text: column === 0 && row === Math.floor((rows - 1) / 2) ? yaxis.title.text : "" } };
      shape.annotations.push({ text: titles[place], xref: `${x} domain`, yref: `${y} domain`, x: 0, y: 1, xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: 12 } });
    });
  }

  function called(rest, keys) {
    return rest.map(([key, value]) => `${keys[key].label} = ${typeof value === "string" ? value : rounded(value * keys[key].scale)} ${keys[key].unit}`.trim()).join(", ");
  }

  function drawStudy(holder, form, note, data) {
    const asked = (name, other) => labbook.get(name) || other;
    const state = { x: asked("x", ""), y: asked("y", "flow_rate"), scale: asked("scale", "linear"), off: asked("fits", "").split(",").filter(Boolean) };
    let known = null;
    const redraw = () => {
      known = controls(form, data, state, redraw);
      labbook.set({ x: state.x, y: state.y === "flow_rate" ? "" : state.y, scale: state.scale === "linear" ? "" : state.scale, fits: state.off.join(",") });
      render();
    };
    const render = () => {
      const t = theme(), traces = [], every = studies(data), several = every.length > 1;
      const without = every.filter((one) => one.nothing).map((one) => (several ? `${one.label}: ${one.nothing}` : one.nothing));
      const X = known.keys[state.x] || { label: "point", unit: "", scale: 1, words: true, orifice: false }, Y = known.quantities[state.y];
      if (!Y) { note.textContent = without.join(" "); holder.hidden = form.hidden = true; return; }
      const power = state.scale === "power" ? 2 / 3 : state.scale === "power5" ? 2 / 5 : 1;
      const raised = (value) => (value === null ? null : power === 1 ? value : Math.sign(value) * Math.abs(value) ** power);
      const chosen = labbook.chosen;
      const shown = (point) => state.x === "" || point.at[state.x] !== undefined;
      const list = every.flatMap((study, place) => groups(study, state.x).map((group) => ({ study, place, ...group }))).filter((group) => group.points.some(shown));
      const dropped = every.filter((study) => study.points.length && !list.some((group) => group.study === study));
      const open = [], log = state.scale === "log";
      const panels = several ? null : panelled(list, holder.clientWidth), lost = [];
      const numeric = !several && !panels && list.length > t.colours.length;
      const colour = (at) => (panels ? (panels.curves > t.colours.length ? VIRIDIS[Math.round(((VIRIDIS.length - 1) * panels.curve(list[at])) / (panels.curves - 1))] : t.colours[panels.curve(list[at])]) : numeric ? VIRIDIS[Math.round(((VIRIDIS.length - 1) * at) / (list.length - 1))] : t.colours[at % t.colours.length]);
      const fitted = X.orifice && state.y === "flow_rate";
      // Words stand at whole numbers, so that points at one word can stand side by side as well.
      const words = X.words ? [...new Set(list.flatMap((group) => group.points.filter(shown).map((point) => (state.x === "" ? point.label : point.at[state.x]))))] : [];
      const abscissa = (point) => (state.x === "" ? words.indexOf(point.label) : X.words ? words.indexOf(point.at[state.x]) : point.at[state.x] * X.scale);
      const together = panels ? panels.curves : list.length, step = apart(list.map((group) => group.points.filter(shown).map(abscissa)), together, log && !X.words, words.length);
      const beside = (x, curve, of = together, by = step) => (log && !X.words ? x * 10 ** (by * (curve - (of - 1) / 2)) : x + by * (curve - (of - 1) / 2));
      let residuals = false, lacking = 0, marks = 0;
      const told = new Set();
      list.forEach((group, at) => {
        const place_ = panels ? panels.panel(group) : 0, curve = panels ? panels.curve(group) : at;
        const axes = panels ? { xaxis: nth("x", place_), yaxis: nth("y", place_) } : {}, cluster = panels ? `c${curve}` : `g${at}`;
        const keys = group.study.keys, rest = panels ? group.rest.filter(([key]) => key !== panels.key) : group.rest, name = [several ? group.study.label : "", called(rest, keys)].filter(Boolean).join(": ") || (several ? group.study.label : Y.label);
        const here = group.points.filter((point) => point.values[state.y] && point.values[state.y][0] !== null && shown(point));
        const x = (point) => beside(abscissa(point), curve);
        if (!X.words) here.sort((a, b) => x(a) - x(b));
        const value = (point, k) => point.values[state.y][k];
        const end = (point, k) => (value(point, k) === null ? null : raised(value(point, k) * Y.scale));
        const middle = here.map((point) => raised(value(point, 0) * Y.scale));
        const dim = chosen && here.length && !here.some((point) => chosen.has(point.n));
        const unknown = (point) => value(point, 2) === null || value(point, 3) === null, hollow = (point) => point.remark || unknown(point);
        const legend = panels ? panels.curves > 1 && panels.curves <= t.colours.length && !told.has(curve) : list.length > 1 || (fitted && group.study.series.length > 0);
        told.add(curve);
        here.filter(unknown).forEach((point) => open.push({ x: x(point), y: raised(value(point, 0) * Y.scale), color: colour(at), xref: axes.xaxis, yref: axes.yaxis }));
        // An entry of its own: the legend shows the marker of the series, not that of its first point.
        traces.push({ type: "scatter", mode: fitted || X.words ? "markers" : "lines+markers", name: pretty(name), legendgroup: cluster, x: [null], y: [null], meta: "legend", line: { color: alpha(colour(at), 0.45), width: 1 }, marker: { color: colour(at), size: 9, symbol: SYMBOLS[curve % SYMBOLS.length], line: { color: colour(at), width: 2 } }, hoverinfo: "skip", showlegend: legend });
        traces.push({
          ...axes, type: "scatter", mode: fitted || X.words ? "markers" : "lines+markers", name: pretty(name), legendgroup: cluster, x: here.map(x), y: middle, customdata: here.map((point) => [point.n, group.study.study]),
          line: { color: alpha(colour(at), 0.45), width: 1 },
          marker: { color: here.map((point) => (hollow(point) ? t.paper : colour(at))), size: 9, symbol: SYMBOLS[curve % SYMBOLS.length], line: { color: colour(at), width: 2 }, opacity: here.map((point) => (!chosen || chosen.has(point.n) ? 1 : 0.15)) },
          error_y: { type: "data", symmetric: false, array: here.map((point, k) => (end(point, 3) === null ? 0 : end(point, 3) - middle[k])), arrayminus: here.map((point, k) => (end(point, 2) === null ? 0 : middle[k] - end(point, 2))), color: colour(at), thickness: 1.5, width: 4 },
          opacity: dim ? 0.3 : 1,
          hovertemplate: here.map((point) => `<b>${pretty(point.label)}</b><br>${pretty(Y.label)} = ${point.said[state.y]} ${pretty(Y.unit)}${point.remark ? "<br>" + escape(point.remark) : ""}<extra></extra>`),
          showlegend: false,
        });
        marks += here.filter(hollow).length;
        const none = group.points.filter((point) => !here.includes(point) && shown(point));
        if (none.length) {
          lacking += none.length;
          if (panels) none.forEach((point) => lost.push({ x: x(point), xref: axes.xaxis, yref: `${axes.yaxis} domain`, color: colour(at) }));
          else traces.push({ type: "scatter", mode: "markers", cliponaxis: false, yaxis: "y3", x: none.map(x), y: none.map(() => 0), customdata: none.map((point) => [point.n, group.study.study]), marker: { symbol: "x-thin", size: 10, line: { color: colour(at), width: 2.5 } }, showlegend: false, legendgroup: cluster, hovertemplate: none.map((point) => `<b>${pretty(point.label)}</b><br>no ${pretty(Y.label)}: ${escape(point.remark || "not measured")}<extra></extra>`) });
        }
        if (!fitted) return;
        const laws = Object.keys(known.laws).filter((law) => !state.off.includes(law));
        const inside = new Set(group.points.map((point) => point.n));
        for (const series of group.study.series) {
          if (!series.points.some((n) => inside.has(n))) continue;
          Object.entries(series.laws).forEach(([law, fit]) => {
            if (state.off.includes(law)) return;
            const place = Object.keys(known.laws).indexOf(law), x = fit.x.map((value) => value * X.scale), scaled = (values) => values.map((one) => raised(one === null ? null : one * Y.scale));
            const paint = list.length > 1 ? colour(at) : t.colours[(place + 1) % t.colours.length];
            if ((panels ? panels.curves : list.length) <= 4) {
              traces.push({ ...axes, type: "scatter", mode: "lines", x, y: scaled(fit.low), line: { width: 0 }, hoverinfo: "skip", showlegend: false, legendgroup: cluster });
              traces.push({ ...axes, type: "scatter", mode: "lines", x, y: scaled(fit.high), line: { width: 0 }, fill: "tonexty", fillcolor: alpha(paint, 0.16), hoverinfo: "skip", showlegend: false, legendgroup: cluster });
            }
            traces.push({ ...axes, type: "scatter", mode: "lines", name: pretty(fit.label), meta: "fit", x, y: scaled(fit.value), line: { color: paint, width: 2, dash: DASHES[place % DASHES.length] }, legendgroup: list.length > 1 ? cluster : `l${law}`, showlegend: list.length === 1, hovertemplate: `${pretty(fit.label)}: ${pretty(fit.parameters)}<extra></extra>` });
            if (panels) return; // no room for residuals
            residuals = true;
            const own = apart(laws.map(() => fit.at.map((value) => value * X.scale)), laws.length, log);
            const at_ = fit.at.map((value) => beside(beside(value * X.scale, curve), laws.indexOf(law), laws.length, list.length > 1 ? 0 : own));
            traces.push({ type: "scatter", mode: "markers", x: at_, y: fit.residuals, yaxis: "y2", marker: { size: 0.1, color: paint }, error_y: { type: "data", array: fit.errors, color: alpha(paint, 0.5), thickness: 6, width: 0 }, legendgroup: list.length > 1 ? cluster : `l${law}`, showlegend: false, hoverinfo: "skip" });
            fit.half_widths.forEach((half, k) => { if (half === null) open.push({ x: at_[k], y: fit.residuals[k], color: paint, yref: "y2" }); });
            traces.push({ type: "scatter", mode: "markers", meta: "residual", x: at_, y: fit.residuals, yaxis: "y2", marker: { color: paint, size: 7, symbol: SYMBOLS[(list.length > 1 ? at : place + 1) % SYMBOLS.length] }, error_y: { type: "data", array: fit.half_widths.map((half) => half || 0), color: paint, thickness: 1.2, width: 3 }, legendgroup: list.length > 1 ? cluster : `l${law}`, showlegend: false, hovertemplate: `${pretty(fit.label)}: %{y:.2f} %<extra></extra>` });
          });
        }
      });
      for (const study of every) {
        const theirs = study.references.filter((one) => one.quantity === state.y);
        const at = new Map(study.points.map((point) => [point.n, point]));
        const here = theirs.filter((one) => at.has(one.point) && (state.x === "" || at.get(one.point).at[state.x] !== undefined));
        if (here.length) traces.push({ type: "scatter", mode: "markers", name: escape(study.source), meta: "reference", x: here.map((one) => abscissa(at.get(one.point))), y: here.map((one) => raised(one.value * Y.scale)), marker: { symbol: "diamond-open", size: 13, color: t.ink, line: { width: 2 } }, hovertemplate: `${escape(study.source)}: %{y:.4g}<extra></extra>` });
      }
      if (list.length > 1 && (residuals || (panels && fitted))) {
        Object.entries(known.laws).forEach(([law, label], place) => {
          if (!state.off.includes(law)) traces.push({ type: "scatter", mode: "lines", name: pretty(label), x: [null], y: [null], line: { color: t.soft, width: 2, dash: DASHES[place % DASHES.length] }, hoverinfo: "skip" });
        });
      }
      const yTitle = power === 1 ? heading(Y) : `(${heading(Y)})<sup>${state.scale === "power" ? "2/3" : "2/5"}</sup>`;
      const shape = layout(t, {
        xaxis: { title: { text: state.x === "" ? "" : heading(X) }, type: log && !X.words ? "log" : "linear", ...(X.words ? { tickvals: words.map((_, place) => place), ticktext: words.map(pretty), range: [-0.5, words.length - 0.5], zeroline: false } : {}) },
        yaxis: { title: { text: yTitle }, type: log ? "log" : "linear", domain: residuals ? [0.3, 1] : [0, 1], rangemode: log || Y.label.includes("drift") ? "normal" : "tozero" },
      });
      if (residuals) shape.yaxis2 = { ...shape.yaxis, type: "linear", title: { text: "residual [%]" }, domain: [0, 0.2], rangemode: "normal", zeroline: true, zerolinecolor: t.soft };
      if (residuals) shape.xaxis.anchor = "y2";
      if (panels) panelAxes(shape, panels, panels.values.map((value) => pretty(called([[panels.key, value]], every[0].keys))));
      // Crosses stand on the lower edge, whatever the scale.
      else shape.yaxis3 = { overlaying: "y", anchor: "x", range: [0, 1], fixedrange: true, visible: false };
      // Plotly takes no pixels below a point on a logarithmic axis: there the bars are a factor long.
      const reach = (one) => (log && (panels || !one.yref) ? { y0: one.y / FACTOR, y1: one.y * FACTOR } : { ysizemode: "pixel", yanchor: one.y, y0: -OPEN, y1: OPEN });
      shape.shapes = open.map((one) => ({ type: "line", xref: one.xref || "x", yref: one.yref || "y", x0: one.x, x1: one.x, ...reach(one), line: { color: one.color, width: 1.5, dash: "dot" } }));
      if (panels) shape.annotations.push(...lost.map((one) => ({ text: "✕", x: one.x, xref: one.xref, yref: one.yref, y: 0, yanchor: "bottom", showarrow: false, font: { size: 11, color: one.color } })));
      shape.height = panels ? 90 + 150 * panels.rows : list.length > 8 ? 560 : residuals ? 500 : 420;
      Plotly.react(holder, traces, shape, CONFIG);
      const points = traces.filter((one) => one.customdata && one.marker.symbol !== "x-thin").reduce((sum, one) => sum + one.x.length, 0);
      holder.dataset.points = points;
      holder.dataset.fits = traces.filter((one) => one.meta === "fit").length;
      const bits = [`${points} point${points === 1 ? "" : "s"}; bars and hovers are 95 % intervals over n runs.`];
      if (Y.meaning) bits.push(`${Y.label.replace(/\^\(([^)]*)\)/g, "^$1")}: ${Y.meaning}.`);
      if (panels) bits.push(`${panels.values.length} panels, by ${every[0].keys[panels.key].label}, with one pair of axes.`);
      if (every.some((one) => one.lacking)) bits.push("Preliminary: laws are drawn when all runs are there.");
      if (dropped.length) bits.push(`Not drawn, without ${X.label}: ${dropped.map((one) => one.label || one.study).join(", ")}.`);
      if (fitted && list.length > 4 && residuals) bits.push(`With ${list.length} curves, bands are not drawn.`);
      if (step && list.length > 1) bits.push("Points at one value stand side by side.");
      if (residuals) bits.push("Residuals: thin bars are 95 % intervals, thick ones the standard errors that fit and test use.");
      if (marks) bits.push("Hollow points have a remark or rest on one run.");
      if (open.length) bits.push("Dotted bars: one run, the interval is unknown.");
      if (lacking) bits.push(`Crosses on the lower edge: ${lacking} without a number.`);
      bits.push("Click a point to see its runs.", ...without);
      note.textContent = bits.join(" ");
    };
    redraw();
    if (!holder.hidden && labbook.once(holder, "listening")) { // Plotly adds `on` when it draws
      holder.on("plotly_click", (event) => {
        const point = event.points[0].customdata;
        if (!point) return;
        const row = document.querySelector(`#points tr[data-point="${point[0]}"] a`);
        if (row) location.assign(row.href); else if (!("static" in document.body.dataset)) location.assign(`/study/${encodeURIComponent(point[1])}/point/${point[0]}`);
      });
      document.addEventListener("labbook:chosen", render);
      scheme.addEventListener("change", render);
    }
  }

  // ---- W(t)

  // `pooled`: mean over runs with its interval, of a page of one point.
  function drawCurves(holder, curves, pooled) {
    const t = theme(), traces = [], shapes = [];
    if (pooled) {
      const [mean, low, high] = pooled.mean.map((one) => (one === null ? null : one * 1e3)), [x0, x1] = pooled.window;
      if (curves.length > 1) shapes.push({ type: "rect", layer: "below", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: alpha(t.soft, 0.14), line: { width: 0 } });
      if (low !== null && high !== null) shapes.push({ type: "rect", layer: "below", xref: "x", yref: "y", x0, x1, y0: low, y1: high, fillcolor: alpha(t.colours[1], 0.28), line: { width: 0 } });
      traces.push({ type: "scatter", mode: "lines", name: "pooled mean", x: [x0, x1], y: [mean, mean], line: { color: t.colours[1], width: 4 }, hovertemplate: `pooled mean: ${escape(pooled.text)}<extra></extra>`, showlegend: curves.length > 1 });
    }
    const named = new Set();
    curves.forEach((curve, at) => {
      const group = curve.group === undefined ? at : curve.group, colour = pooled ? t.colours[group % (t.colours.length - 1) + (group % (t.colours.length - 1) ? 1 : 0)] : t.colours[group % t.colours.length];
      traces.push({ type: "scatter", mode: "lines", name: pretty(curve.group === undefined ? curve.label : curve.title), legendgroup: `g${group}`, x: curve.time, y: curve.rate.map((one) => one * 1e3), line: { color: colour, width: 1.6, shape: "hvh", dash: DASHES[group < 4 ? 0 : 1 + (group % 3)] }, hovertemplate: `<b>${pretty(curve.label)}</b><br>t = %{x:.3g} s, W = %{y:.4g} g/s<extra></extra>`, showlegend: curves.length > 1 && !named.has(group) });
      named.add(group);
      if (curve.window && curves.length === 1) shapes.push({ type: "rect", layer: "below", xref: "x", yref: "paper", x0: curve.window[0], x1: curve.window[1], y0: 0, y1: 1, fillcolor: alpha(colour, 0.13), line: { width: 0 } });
      if (curve.mean && curve.window && curve.mean[0] !== null) traces.push({ type: "scatter", mode: "lines", x: curve.window, y: [curve.mean[0] * 1e3, curve.mean[0] * 1e3], line: { color: colour, width: 2.5, dash: "dot" }, hovertemplate: `mean of the window: ${rounded(curve.mean[0] * 1e3)} ± ${rounded(curve.mean[1] === null ? null : curve.mean[1] * 1e3)} g/s (one standard error)<extra></extra>`, showlegend: false, legendgroup: `g${group}` });
    });
    Plotly.react(holder, traces, layout(t, { shapes, height: 340, xaxis: { title: { text: "t [s]" }, rangemode: "tozero" }, yaxis: { title: { text: "W [g/s]" }, rangemode: "tozero" } }), CONFIG);
    holder.dataset.points = curves.length;
    if (labbook.once(holder, "listening")) {
      holder.on("plotly_hover", (event) => {
        const at = event.points[0].curveNumber;
        Plotly.restyle(holder, { opacity: traces.map((_, k) => (k === at ? 1 : 0.25)) });
      });
      holder.on("plotly_unhover", () => Plotly.restyle(holder, { opacity: traces.map(() => 1) }));
      scheme.addEventListener("change", () => drawCurves(holder, curves, pooled));
    }
  }

  function drawLedger(holder, ledger) {
    const t = theme(), line = (name, y, at, more = {}) => ({ type: "scatter", mode: "lines", name, x: ledger.time, y, line: { color: t.colours[at], width: 1.6 }, ...more });
    const traces = [line("kinetic", ledger.kinetic, 0), line("potential", ledger.potential, 1), line("work of contacts", ledger.work, 2), line("largest overlap", ledger.overlap.map((one) => 100 * one), 3, { yaxis: "y2" })];
    const shape = layout(t, { height: 340, xaxis: { title: { text: "t [s]" } }, yaxis: { title: { text: "energy [J]" } } });
    shape.yaxis2 = { ...shape.yaxis, overlaying: "y", side: "right", showgrid: false, title: { text: "largest overlap [% of d]" }, rangemode: "tozero" };
    Plotly.react(holder, traces, shape, CONFIG);
    if (labbook.once(holder, "listening")) scheme.addEventListener("change", () => drawLedger(holder, ledger));
  }

  // Numbers of a chart in SI, a row for each time.
  const TABLES = {
    curves: ({ curves }) => [["run", "time [s]", "flow_rate [kg/s]", "in_window"], ...curves.flatMap((curve) => curve.time.map((t, k) => [curve.label, t, curve.rate[k], Boolean(curve.window) && t >= curve.window[0] && t <= curve.window[1]]))],
    ledger: ({ ledger }) => [["time [s]", "kinetic [J]", "potential [J]", "work_of_contacts [J]", "largest_overlap [d]"], ...ledger.time.map((t, k) => [t, ledger.kinetic[k], ledger.potential[k], ledger.work[k], ledger.overlap[k]])],
  };
  const cell = (value) => (/[",\n]/.test(value) ? `"${String(value).replace(/"/g, '""')}"` : value === null ? "" : String(value));

  // A chart as it is drawn, on the colour of the page.
  document.addEventListener("click", (event) => {
    const button = event.target.closest("button.plot"), chart = button && document.getElementById(button.dataset.plot);
    if (!chart || !chart.layout) return;
    if (button.dataset.kind === "csv") {
      const rows = TABLES[chart.id](labbook.data()).map((row) => row.map(cell).join(","));
      labbook.save(new Blob([rows.join("\n") + "\n"], { type: "text/csv" }), `${button.dataset.file}.csv`);
      return;
    }
    const width = chart.clientWidth, height = chart.clientHeight, file = `${button.dataset.file}.${button.dataset.kind}`;
    const figure = { data: chart.data, layout: { ...chart.layout, paper_bgcolor: theme().paper, plot_bgcolor: theme().paper }, config: CONFIG };
    Plotly.toImage(figure, { format: "svg", width, height }).then((address) => {
      if (button.dataset.kind === "svg") { labbook.save(new Blob([decodeURIComponent(address.slice(address.indexOf(",") + 1))], { type: "image/svg+xml" }), file); return; }
      const image = new Image(), canvas = document.createElement("canvas"); // Plotly's own way needs images from blob:, which the policy of the page refuses
      canvas.width = 3 * width;
      canvas.height = 3 * height;
      image.onload = () => { canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height); canvas.toBlob((content) => labbook.save(content, file)); };
      image.src = address;
    });
  });

  labbook.ready(() => {
    const data = labbook.data();
    if (!data || typeof Plotly === "undefined") return;
    const chart = document.getElementById("chart"), curves = document.getElementById("curves"), ledger = document.getElementById("ledger");
    if (labbook.once(chart, "drawn")) drawStudy(chart, document.getElementById("axes"), document.getElementById("chart-note"), data);
    if (labbook.once(curves, "drawn") && data.curves.length) drawCurves(curves, data.curves, data.pooled);
    if (labbook.once(ledger, "drawn") && data.ledger) drawLedger(ledger, data.ledger);
  });
})();
