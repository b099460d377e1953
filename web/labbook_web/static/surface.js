// The surface of labbook.results.explore where there is no Python: value, interval and inverse at a design.
// Coefficients, covariance and curves come with the page; tests compare the answers with Python's.
"use strict";

const surfaces = (() => {
  const EDGE = 1e-9, PLACES = 129, STEPS = 50;

  const coordinate = (factor, value) => (factor.logarithmic ? Math.log(value) : value);

  function scaled(factor, value) {
    const low = coordinate(factor, factor.low), high = coordinate(factor, factor.high);
    return 2 * (coordinate(factor, value) - low) / (high - low) - 1;
  }

  function unscaled(factor, u) {
    const low = coordinate(factor, factor.low), high = coordinate(factor, factor.high), x = low + (u + 1) / 2 * (high - low);
    return factor.logarithmic ? Math.exp(x) : x;
  }

  // Legendre polynomials of degree 0 to `highest`, orthonormal over -1 to 1.
  function legendre(u, highest) {
    const plain = [1, u];
    for (let n = 1; n < highest; n += 1) plain.push(((2 * n + 1) * u * plain[n] - n * plain[n - 1]) / (n + 1));
    return plain.map((value, n) => Math.sqrt(2 * n + 1) * value);
  }

  function terms(surface, u) {
    if (surface.highest === undefined) surface.highest = Math.max(...surface.degrees.flat());
    const polynomials = u.map((x) => legendre(x, surface.highest));
    return surface.degrees.map((degrees) => degrees.reduce((product, degree, k) => product * polynomials[k][degree], 1));
  }

  const distance = (plane, u) => u.reduce((sum, x, k) => sum + plane[k] * x, plane[u.length]);
  const inside = (surface, u) => surface.hull.every((plane) => distance(plane, u) <= EDGE);

  function value(view, u) {
    const surface = view.surface, x = terms(surface, u);
    let mean = 0;
    for (let i = 0; i < x.length; i += 1) mean += x[i] * surface.coefficients[i];
    if (surface.trend) {
      const { factor, power, offset } = surface.trend;
      mean += power * Math.log(unscaled(view.factors[factor], u[factor]) - offset);
    }
    return [mean, x];
  }

  // Value and ends of the 95 % interval [SI] at scaled keys.
  function band(view, u) {
    const surface = view.surface;
    if (surface.kind === "curve") return curve(surface, unscaled(view.factors[0], u[0]));
    const [mean, x] = value(view, u);
    let variance = surface.misfit ** 2;
    for (let i = 0; i < x.length; i += 1) {
      const row = surface.covariance[i];
      let sum = 0;
      for (let j = 0; j < x.length; j += 1) sum += row[j] * x[j];
      variance += x[i] * sum;
    }
    const half = surface.student * Math.sqrt(Math.max(variance, 0)), back = surface.logarithmic ? Math.exp : (y) => y;
    return [back(mean), back(mean - half), back(mean + half)];
  }

  function curve(surface, x) {
    const last = surface.x.length - 1, place = (x - surface.x[0]) / (surface.x[last] - surface.x[0]) * last;
    const at = Math.min(Math.max(Math.floor(place), 0), last - 1), part = Math.min(Math.max(place - at, 0), 1);
    return [surface.value, surface.low, surface.high].map((table) => table[at] + part * (table[at + 1] - table[at]));
  }

  // The same at values of the keys [SI]; null outside of the points.
  function predict(view, values) {
    const u = view.factors.map((factor, k) => scaled(factor, values[k]));
    const isInside = view.surface.kind === "curve" ? Math.abs(u[0]) <= 1 + EDGE : inside(view.surface, u);
    return isInside ? band(view, u) : null;
  }

  // The part of the line along a key that is between the points, in scaled values; null if there is none.
  function line(view, k, u) {
    if (view.surface.kind === "curve") return [-1, 1];
    let low = -Infinity, high = Infinity;
    for (const plane of view.surface.hull) {
      const rest = distance(plane, u.map((x, j) => (j === k ? 0 : x))), slope = plane[k];
      if (Math.abs(slope) < EDGE) {
        if (rest > EDGE) return null;
      } else if (slope > 0) high = Math.min(high, -rest / slope);
      else low = Math.max(low, -rest / slope);
    }
    return high - low > EDGE ? [low, high] : null;
  }

  function zero(f, start, end) {
    let a = start, b = end;
    const sign = Math.sign(f(a));
    for (let n = 0; n < STEPS; n += 1) {
      const middle = (a + b) / 2;
      if (Math.sign(f(middle)) === sign) a = middle; else b = middle;
    }
    return (a + b) / 2;
  }

  // The value of a key that gives a target, the others as in `values`: as labbook.stats.inverse finds it. An end that
  // the points do not bound is null; where there is no answer, `why` says so.
  function inverse(view, target, k, values) {
    const factor = view.factors[k], u = view.factors.map((f, j) => scaled(f, values[j])), ends = line(view, k, u);
    if (!ends) return { why: "no points here" };
    // A curve is searched at even steps of its key, a surface at those of the scaled key.
    const even = view.surface.kind === "curve";
    const from = even ? factor.low : ends[0], to = even ? factor.high : ends[1];
    const at = (x) => band(view, u.map((v, j) => (j === k ? (even ? scaled(factor, x) : x) : v)));
    const off = (x) => at(x)[0] - target;
    const margin = (x) => { const [, low, high] = at(x); return Math.min(target - low, high - target); };
    const places = Array.from({ length: PLACES }, (_, n) => from + (to - from) * n / (PLACES - 1));
    const values_ = places.map(off), crossings = [];
    for (let n = 0; n + 1 < PLACES; n += 1) if (Math.sign(values_[n]) !== Math.sign(values_[n + 1])) crossings.push(n);
    const low = Math.min(...values_) + target, high = Math.max(...values_) + target;
    if (!crossings.length) return { why: "not reached", low, high };
    if (crossings.length > 1 && values_[crossings[1]] !== 0) return { why: `at ${crossings.length} values`, low, high };
    const first = crossings[0], root = zero(off, places[first], places[first + 1]);
    const within = places.map((x) => margin(x) >= 0);
    let below = -1, above = PLACES;
    places.forEach((x, n) => { if (!within[n] && x < root) below = n; });
    for (let n = PLACES - 1; n >= 0; n -= 1) if (!within[n] && places[n] > root) above = n;
    const si = (x) => (even ? x : unscaled(factor, x));
    return {
      value: si(root),
      low: below < 0 ? null : si(zero(margin, places[below], Math.min(places[below + 1], root))),
      high: above === PLACES ? null : si(zero(margin, places[above], Math.max(places[above - 1], root))),
    };
  }

  return { scaled, unscaled, band, value, inside, predict, inverse };
})();
