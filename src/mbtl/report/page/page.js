"use strict";
/* The moving part of a report. Everything is computed already; here it is unpacked and drawn. */
(() => {
  const byId = (id) => document.getElementById(id);
  const root = document.documentElement;
  const SCALE = "Cividis";
  const LINES = ["#8a8f98", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
  const DASHES = ["dash", "dot", "dashdot", "longdash", "dash", "dot"];
  const state = { items: [], which: 0, steps: [], maps: [], drawn: new Map() };

  function trouble(what) {
    byId("trouble").hidden = false;
    byId("trouble").textContent = "The pictures could not be drawn: " + what;
  }
  addEventListener("error", (event) => trouble(event.message));
  addEventListener("unhandledrejection", (event) => trouble(String(event.reason)));

  /* ---- unpacking ------------------------------------------------------------------------- */

  async function unpack(id) {
    if (!("DecompressionStream" in window)) throw new Error("this browser is too old (it cannot unpack gzip)");
    const text = atob(byId(id).textContent), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  }

  function revive(value, buffer, start) {
    if (Array.isArray(value)) return value.map((item) => revive(item, buffer, start));
    if (value === null || typeof value !== "object") return value;
    if ("$" in value && "shape" in value) return array(value, buffer, start + value.$);
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, revive(v, buffer, start)]));
  }

  function array(spec, buffer, start) {
    const size = spec.shape.reduce((a, b) => a * b, 1);
    let flat;
    if (spec.type === "f8") flat = new Float64Array(buffer, start, size);
    else if (spec.type === "i4") flat = new Int32Array(buffer, start, size);
    else {
      const codes = spec.type === "u1" ? new Uint8Array(buffer, start, size) : new Uint16Array(buffer, start, size);
      const top = spec.type === "u1" ? 254 : 65534, step = (spec.high - spec.low) / top;
      flat = Float32Array.from(codes, (code) => (code > top ? NaN : spec.low + code * step));
    }
    if (spec.shape.length < 2) return flat;
    const width = spec.shape[1];
    return Array.from({ length: spec.shape[0] }, (_, i) => flat.subarray(i * width, (i + 1) * width));
  }

  /* ---- words and colours ----------------------------------------------------------------- */

  const css = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const short = (x) => (Number.isFinite(x) ? String(+x.toPrecision(4)) : "–");
  const fixed = (x) => (Number.isFinite(x) ? x.toFixed(4) : "–");
  const mean = (rows) => Array.from(rows[0], (_, j) => rows.reduce((sum, row) => sum + row[j], 0) / rows.length);
  const named = (axis, value) => (axis.choices ? axis.choices[value] : short(value) + (axis.unit ? " " + axis.unit : ""));
  const describe = (item, i) => item.axes.map((axis) => `${axis.name} = ${named(axis, axis.values[i])}`).join(", ");
  const home = (item, p) => "trained on " + item.trained[p];
  /* Policies with a place of their own: one that was trained on several contexts has none. */
  const hasPlace = (item, p) => p !== undefined && item.kinds[p] !== "several";
  const placed = (item, last = item.sources.length) => item.sources.map((_, p) => p).slice(0, last).filter((p) => hasPlace(item, p));
  const SYMBOLS = { several: "square", specialist: "circle", tuned: "diamond" };
  const contexts = (item) => (item.said ??= Array.from({ length: item.n }, (_, i) => describe(item, i)));

  function axisOf(axis, more = {}) {
    const look = { title: { text: axis.label }, type: axis.log ? "log" : "linear", gridcolor: css("--line"), zeroline: false };
    if (axis.choices) Object.assign(look, { tickvals: axis.choices.map((_, i) => i), ticktext: axis.choices });
    return { ...look, ...more };
  }
  const plain = (text, more = {}) => ({ title: { text }, gridcolor: css("--line"), zeroline: false, exponentformat: "none", ...more });

  function layout(more) {
    return {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: css("--ink"), size: 12 },
      margin: { l: 60, r: 16, t: 30, b: 48 }, modebar: { bgcolor: "rgba(0,0,0,0)", color: css("--soft"), activecolor: css("--accent") }, hovermode: "closest", legend: { orientation: "h" },
      colorway: ["#0072b2", ...LINES], ...more,
    };
  }

  function draw(box, traces, look) {
    const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
    const whole = layout(look), below = 64 / (box.clientHeight - 170); // clear of the axis and its title
    whole.legend.y = -below;
    return Plotly.react(box, traces, whole, config);
  }

  /* ---- maps over two axes ---------------------------------------------------------------- */

  function edges(levels, axis) {
    const to = axis.log ? Math.log : (x) => x, back = axis.log ? Math.exp : (x) => x;
    const at = levels.map(to), out = [];
    if (at.length === 1) return [back(at[0] - 0.5), back(at[0] + 0.5)];
    for (let i = 1; i < at.length; i++) out.push((at[i] + at[i - 1]) / 2);
    out.unshift(2 * at[0] - out[0]);
    out.push(2 * at.at(-1) - out.at(-1));
    return out.map(back);
  }
  const distinct = (values) => Array.from(new Set(values)).sort((a, b) => a - b);

  function mapOf(i) {
    const item = state.items[i];
    if (state.maps[i]) return state.maps[i];
    const levels = item.axes.map((axis) => distinct(axis.values)), widest = levels.map((_, q) => q).sort((a, b) => levels[b].length - levels[a].length);
    const [x, y] = widest.slice(0, 2).sort((a, b) => a - b); // the others are held in their middle
    return (state.maps[i] = { x, y, fixed: levels.map((own) => own[own.length >> 1]), show: {} });
  }

  /* Which contexts belong to each cell of two axes, where some others are held. */
  function cells(item, x, y, held) {
    const [across, up] = [x, y].map((q) => distinct(item.axes[q].values));
    const [column, row] = [across, up].map((levels) => new Map(levels.map((v, j) => [v, j])));
    const members = up.map(() => across.map(() => []));
    for (let i = 0; i < item.n; i++) {
      if (held.some((v, q) => v !== null && q !== x && q !== y && item.axes[q].values[i] !== v)) continue;
      members[row.get(item.axes[y].values[i])][column.get(item.axes[x].values[i])].push(i);
    }
    return { across, up, members };
  }
  const average = (values) => (those) => {
    const known = those.map((i) => values[i]).filter(Number.isFinite);
    return known.length ? known.reduce((a, b) => a + b, 0) / known.length : null;
  };
  /* The policy of a cell; none of several is shown for all. */
  const only = (values) => (those) => (new Set(those.map((i) => values[i])).size === 1 ? values[those[0]] : null);

  function mapTraces(item, view, values, { kind, label, range, taken }) { // taken: numbers of policies
    const { x, y, fixed: held } = view, policies = kind === "policy", colours = item.served.colours;
    const scale = policies ? colours.flatMap((c, p) => [[p / colours.length, c], [(p + 1) / colours.length, c]]) : SCALE;
    if (policies) values = Array.from(values, (p) => p + 1); // people count from 1
    const bar = policies ? { tickvals: colours.map((_, p) => p + 1), title: { text: "policy" } }
      : { title: { text: label, side: "right" } };
    const [low, high] = policies ? [0.5, colours.length + 0.5] : range;
    const traces = [];
    if (item.isGrid) {
      const { across, up, members } = cells(item, x, y, held);
      const pick = policies ? only(values) : average(values);
      const several = (those) => `${those.length} contexts` + (policies ? ": policies " + distinct(those.map((c) => values[c])).join(", ") : "");
      traces.push({
        type: "heatmap", x: edges(across, item.axes[x]), y: edges(up, item.axes[y]), z: members.map((row) => row.map(pick)),
        text: members.map((row) => row.map((those) => (those.length === 1 ? describe(item, those[0]) : several(those)))),
        hovertemplate: `%{text}<br>${label}: %{z:.4~f}<extra></extra>`, colorscale: scale, zmin: low, zmax: high, colorbar: bar,
      });
    } else {
      traces.push({
        type: "scatter", mode: "markers", x: item.axes[x].values, y: item.axes[y].values, text: contexts(item),
        marker: { color: Array.from(values), colorscale: scale, cmin: low, cmax: high, colorbar: bar, size: 10, showscale: true },
        hovertemplate: `%{text}<br>${label}: %{marker.color:.4~f}<extra></extra>`, showlegend: false,
      });
    }
    const places = new Map(); // in a projection several sources may stand at one place
    taken.forEach((p) => {
      const at = [x, y].map((q) => item.axes[q].values[item.sources[p]]), one = places.get(String(at)) || { at, numbers: [], said: [] };
      one.numbers.push(p + 1);
      one.said.push(`${p + 1}: ${home(item, p)}`);
      places.set(String(at), one);
    });
    const marks = [...places.values()];
    traces.push({
      type: "scatter", mode: "markers+text", x: marks.map((m) => m.at[0]), y: marks.map((m) => m.at[1]), text: marks.map((m) => m.numbers.join(",")),
      textfont: { color: "#000", size: 10 }, hovertext: marks.map((m) => m.said.join("<br>")), hoverinfo: "text",
      marker: { opacity: 1, size: marks.map((m) => 14 + 5 * m.numbers.join().length), color: "#fff", line: { color: "#000", width: 1 } }, showlegend: false,
    });
    return traces;
  }
  const mapLook = (item, view) => ({ xaxis: axisOf(item.axes[view.x]), yaxis: axisOf(item.axes[view.y]) });

  function select(label, options, value, change) {
    const frame = document.createElement("label"), box = document.createElement("select");
    frame.append(label, " ", box);
    options.forEach(([v, text]) => box.add(new Option(text, v)));
    box.value = value;
    box.addEventListener("change", () => change(box.value));
    return frame;
  }

  function mapControls(i, part, quantities) {
    const item = state.items[i], view = mapOf(i), box = controls(i, part);
    if (box.childElementCount) return;
    view.show[part] = quantities[0][0];
    box.append(select("Show", quantities, quantities[0][0], (v) => { view.show[part] = v; redraw(i, [part]); }));
    if (item.axes.length < 3) return;
    const axes = item.axes.map((axis, q) => [q, axis.name]);
    for (const side of ["x", "y"]) {
      box.append(select(side === "x" ? "across" : "up", axes, view[side], (v) => {
        const other = side === "x" ? "y" : "x";
        if (+v === view[other]) view[other] = view[side];
        view[side] = +v;
        sync(i);
      }));
    }
    item.axes.forEach((axis, q) => {
      const levels = distinct(axis.values).map((v) => [v, named(axis, v)]);
      const slice = select(axis.name, [["", "all: averages, and policies that serve alone"], ...levels], view.fixed[q], (v) => { view.fixed[q] = v === "" ? null : +v; sync(i); });
      slice.dataset.slice = q;
      box.append(slice);
    });
    sync(i, false);
  }

  /* The same axes and slices in all maps of an item. */
  function sync(i, again = true) {
    const view = mapOf(i);
    for (const part of ["policies", "model"]) {
      const boxes = controls(i, part).querySelectorAll("select");
      if (boxes.length < 3) continue;
      boxes.forEach((box) => {
        const text = box.parentElement.firstChild.textContent, q = box.parentElement.dataset.slice;
        if (q !== undefined) {
          box.value = view.fixed[q] ?? "";
          box.parentElement.hidden = +q === view.x || +q === view.y;
        } else if (text === "across") box.value = view.x;
        else if (text === "up") box.value = view.y;
      });
    }
    if (again) redraw(i, ["policies", "model"]);
  }

  /* ---- the pictures ---------------------------------------------------------------------- */

  const pictures = {
    curve(i, box) {
      const item = state.items[i], k = item.curve.units, last = Math.max(k.at(-1) || 0, 2), traces = [];
      Object.entries(item.levels).forEach(([name, v]) => traces.push({
        x: [Math.min(1, ...k), last], y: [v, v], mode: "lines", name, line: { width: 1, dash: "dot", color: css("--soft") }, visible: name === "Independent" || item.kind === "study" ? true : "legendonly",
      }));
      Object.entries(item.baselines).forEach(([name, rows], n) => {
        const x = Array.from(rows[0], (_, j) => j + 1), colour = LINES[n % LINES.length];
        if (rows.length > 1) {
          const across = (of) => x.map((_, j) => of(...rows.map((row) => row[j])));
          traces.push({ x: [...x, ...x.slice().reverse()], y: [...across(Math.min), ...across(Math.max).reverse()], fill: "toself", fillcolor: colour, opacity: 0.15, line: { width: 0 }, hoverinfo: "skip", showlegend: false, legendgroup: name });
        }
        traces.push({ x, y: mean(rows), mode: "lines", name, legendgroup: name, line: { width: 1.6, dash: DASHES[n % 6], color: colour } });
      });
      const { values } = item.curve, gained = (j) => (j ? `gained ${fixed(values[j] - values[j - 1])}<br>` : "");
      traces.push({
        x: k, y: values, mode: "lines+markers", name: item.selector, line: { width: 3, color: css("--accent") }, marker: { size: 8 },
        text: item.trained.map((what, j) => `${what}<br>${gained(j)}${item.reasons[j]}`),
        hovertemplate: "after %{x}: V = %{y:.4f}<br>%{text}<extra></extra>",
      });
      if (item.fresh) traces.push({
        x: [k.at(-1)], y: [item.fresh[0]], mode: "markers", name: "on fresh episodes", marker: { size: 9, symbol: "diamond", color: css("--ink") },
        error_y: { type: "constant", value: item.fresh[1] || 0, thickness: 1.5 }, hovertemplate: "on fresh episodes: V = %{y:.4f}<extra></extra>",
      });
      const heights = traces.flatMap((one) => [...one.y]), low = Math.min(...heights), high = Math.max(...heights);
      const upright = plain("V", high - low < 0.02 ? { range: [low - 0.05, high + 0.05] } : {}); // rounding is no course
      return draw(box, traces, { xaxis: plain(item.kind === "study" ? "units of training spent" : "trainings", { dtick: Math.ceil((26 * last) / box.clientWidth) }), yaxis: upright });
    },

    policies(i, box) {
      const item = state.items[i], { policy, performance, runnerUp, runnerUpPerformance: second } = item.served;
      const { colours } = item.served, margin = Array.from(performance, (v, j) => v - second[j]);
      if (item.axes.length > 1) {
        const own = item.rows.map((_, p) => [p, `policy ${p + 1} everywhere`]);
        mapControls(i, "policies", [["policy", "policy"], ["performance", "performance"], ["margin", "lead over the runner-up"], ...own]);
        const view = mapOf(i), show = view.show.policies, values = { policy, performance, margin }[show] ?? item.rows[show];
        const label = { policy: "policy", margin: "lead" }[show] ?? "performance";
        return draw(box, mapTraces(item, view, values, { kind: show, label, range: range([values]), taken: placed(item) }), mapLook(item, view));
      }
      const axis = item.axes[0], order = sorted(axis.values), x = order.map((j) => axis.values[j]);
      const traces = [
        { x, y: order.map((j) => second[j]), mode: "lines", name: "runner-up", line: { width: 1, dash: "dot", color: css("--soft") }, hoverinfo: "skip" },
        { x, y: order.map((j) => performance[j]), mode: "lines", line: { width: 0.6, color: css("--soft") }, hoverinfo: "skip", showlegend: false },
      ];
      Object.entries(item.beside).forEach(([name, values], n) => traces.push({
        x, y: order.map((j) => values[j]), mode: "lines", name, line: { width: 1, dash: DASHES[n % 6], color: LINES[(n + 1) % 6] }, hoverinfo: "skip",
      }));
      distinct(policy).forEach((p) => {
        const own = order.filter((j) => policy[j] === p);
        traces.push({
          x: own.map((j) => axis.values[j]), y: own.map((j) => performance[j]), mode: "markers", name: `policy ${p + 1}: ${item.trained[p]}`,
          marker: { size: 8, symbol: SYMBOLS[item.kinds[p]], color: colours[p] },
          text: own.map((j) => `${describe(item, j)}<br>policy ${p + 1}, ${home(item, p)}` +
            (runnerUp[j] < 0 ? "" : `<br>runner-up: policy ${runnerUp[j] + 1}, ${fixed(second[j])}`)),
          hovertemplate: "%{text}<br>performance %{y:.4f}<extra></extra>",
        });
      });
      const ends = wider(range([performance, second, ...Object.values(item.beside)]));
      const at = placed(item), homes = at.map((p) => axis.values[item.sources[p]]);
      traces.push({
        x: homes, y: at.map(() => ends[0]), mode: "markers+text", name: "trained there",
        text: at.map((p) => p + 1), textposition: "top center", cliponaxis: false, hovertext: at.map((p) => home(item, p)), hoverinfo: "text",
        marker: { size: 9, symbol: "triangle-up", color: css("--ink") },
      });
      return draw(box, traces, { xaxis: axisOf(axis), yaxis: plain("performance", { range: ends }) });
    },

    model(i, box) {
      const item = state.items[i], steps = item.steps, last = item.sources.length;
      if (!controls(i, "model").querySelector("input")) slider(i, last);
      const j = state.steps[i] - 1, taken = placed(item, j + 1), coming = j + 1 < last ? j + 1 : undefined;
      controls(i, "model").querySelector("output").textContent = `after ${j + 1} of ${last}` +
        (coming === undefined ? "" : `; next pick: ${item.trained[coming]}`);
      if (item.axes.length > 1) {
        const view = mapOf(i), show = view.show.model, label = { mean: "mean", std: "deviation", gain: "score", served: "performance" }[show];
        return draw(box, mapTraces(item, view, steps[show][j], { kind: show, label, range: range(steps[show]), taken }), mapLook(item, view));
      }
      const axis = item.axes[0], order = sorted(axis.values), x = order.map((c) => axis.values[c]);
      const of = (rows) => order.map((c) => rows[j][c]), middle = of(steps.mean), wide = of(steps.std);
      const gain = of(steps.gain), accent = css("--accent"), ends = modelRange(item, j), homes = taken.map((p) => axis.values[item.sources[p]]);
      const traces = [
        { x, y: middle.map((m, c) => m - 1.96 * wide[c]), mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false },
        { x, y: middle.map((m, c) => m + 1.96 * wide[c]), mode: "lines", line: { width: 0 }, fill: "tonexty", fillcolor: "rgba(0,114,178,0.18)", name: "95 % band", hoverinfo: "skip" },
        { x, y: middle, mode: "lines", name: "believed", line: { color: accent, width: 2 }, hovertemplate: "%{x}: %{y:.4f}<extra>believed</extra>" },
        { x, y: of(steps.served), mode: "lines", name: "best policy so far", line: { color: css("--soft"), width: 1, dash: "dot" }, hoverinfo: "skip" },
        { x: homes, y: taken.map((p) => item.rows[p][item.sources[p]]), mode: "markers+text", name: "trained here", text: taken.map((p) => p + 1), textposition: sides(homes), cliponaxis: false, marker: { color: css("--ink"), size: 8 } },
        { x, y: gain, mode: "lines", name: "score", yaxis: "y2", fill: "tozeroy", line: { color: "#e69f00", width: 1 }, connectgaps: true, hovertemplate: "%{x}: %{y:.4f}<extra>score</extra>" },
      ];
      if (hasPlace(item, coming)) {
        const where = item.sources[coming];
        traces.push({ x: [axis.values[where]], y: [gain[order.indexOf(where)] || 0], mode: "markers", yaxis: "y2", name: "next pick", marker: { symbol: "triangle-down", size: 13, color: "#d55e00" } });
      }
      return draw(box, traces, {
        xaxis: axisOf(axis, { anchor: "y2" }), yaxis: plain("performance", { domain: [0.38, 1], range: ends }),
        yaxis2: plain("score", { domain: [0, 0.26], range: [0, 1.08 * Math.max(1e-9, range([gain])[1])] }),
      });
    },

    heat(i, box) {
      const item = state.items[i], axis = item.axes[0], at = axis.values, across = sorted(at), whole = item.matrix;
      const x = edges(across.map((c) => at[c]), axis), homes = placed(item).map((p) => [p, at[item.sources[p]]]);
      let y, z, marks;
      if (whole) {
        const down = sorted(Array.from(whole.sources, (s) => at[s]));
        y = edges(down.map((r) => at[whole.sources[r]]), axis);
        z = down.map((r) => across.map((c) => whole.values[r][c]));
        marks = homes.map(([p, place]) => [place, place, p]);
      } else {
        y = item.rows.map((_, p) => p + 1);
        z = item.rows.map((row) => across.map((c) => row[c]));
        marks = homes.map(([p, place]) => [place, p + 1, p]);
      }
      const [zmin, zmax] = inner(z.flat()); // a few cells must not take the whole scale
      const side = (text) => axisOf(axis, { title: { text: `${text}: ${axis.label}` } });
      return draw(box, [
        { type: "heatmap", x, y, z, zmin, zmax, colorscale: SCALE, colorbar: { title: { text: "performance", side: "right" } }, hovertemplate: "source %{y}, target %{x}<br>performance %{z:.4f}<extra></extra>" },
        {
          type: "scatter", mode: "markers+text", x: marks.map((m) => m[0]), y: marks.map((m) => m[1]), text: marks.map((m) => m[2] + 1), textfont: { color: "#000", size: 9 },
          hovertext: marks.map((m) => item.trained[m[2]]), hoverinfo: "text", marker: { size: 15, color: "#fff", line: { color: "#000", width: 1 } }, showlegend: false,
        },
      ], { xaxis: side("target"), yaxis: whole ? side("source") : plain("policy, in the order of training", { dtick: item.rows.length > 20 ? undefined : 1, range: [item.rows.length + 0.5, 0.5] }) });
    },

    pairs(i, box) {
      const item = state.items[i], view = mapOf(i), d = item.axes.length, pairs = [];
      for (let a = 0; a < d; a++) for (let b = a + 1; b < d; b++) pairs.push([a, b]);
      const columns = box.clientWidth < 600 ? 1 : Math.min(3, pairs.length), rows = Math.ceil(pairs.length / columns);
      const [low, high] = range([item.served.performance]), traces = [], look = { grid: { rows, columns, pattern: "independent", xgap: 0.22, ygap: 0.3 }, height: 300 * rows };
      pairs.forEach(([x, y], p) => {
        const n = p ? p + 1 : "", alone = item.axes.map(() => null), { across, up, members } = cells(item, x, y, alone);
        traces.push({
          type: "heatmap", x: edges(across, item.axes[x]), y: edges(up, item.axes[y]), z: members.map((row) => row.map(average(item.served.performance))),
          xaxis: "x" + n, yaxis: "y" + n, colorscale: SCALE, zmin: low, zmax: high, showscale: p === 0, hovertemplate: "%{x}, %{y}<br>mean %{z:.4f}<extra></extra>",
        });
        look["xaxis" + n] = axisOf(item.axes[x]);
        look["yaxis" + n] = axisOf(item.axes[y]);
      });
      return draw(box, traces, look);
    },
  };

  const sorted = (values) => Array.from(values, (_, i) => i).sort((a, b) => values[a] - values[b]);
  /* Between which all but a hundredth at each end are. */
  function inner(values) {
    const known = values.filter(Number.isFinite).sort((a, b) => a - b);
    return [0.01, 0.99].map((share) => known[Math.round(share * (known.length - 1))]);
  }
  function range(rows) {
    let low = Infinity, high = -Infinity;
    for (const row of rows) for (const v of row) if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
    return low < high ? [low, high] : [low - 0.05, high + 0.05];
  }
  const wider = ([low, high]) => [low - 0.08 * (high - low), high + 0.08 * (high - low)];
  /* Of one step: what was measured and believed, and of the band as much as leaves that readable. */
  function modelRange(item, j) {
    const [low, high] = range([item.steps.mean[j]]), spread = 1.96 * range([item.steps.std[j]])[1];
    const [a, b] = range([item.steps.served[j]]), most = 0.05 + 0.5 * (Math.max(b, high) - Math.min(a, low));
    return wider([Math.min(a, low - Math.min(spread, most)), Math.max(b, high + Math.min(spread, most))]);
  }
  /* Numbers of neighbours stand above and below in turn, not over each other. */
  function sides(places) {
    const out = [];
    sorted(places).forEach((p, rank) => (out[p] = rank % 2 ? "bottom center" : "top center"));
    return out;
  }

  /* ---- page ------------------------------------------------------------------------------ */

  const article = (i) => document.querySelector(`article[data-item="${i}"]`);
  const controls = (i, part) => article(i).querySelector(`[data-controls="${part}"]`);

  function slider(i, last) {
    const box = controls(i, "model"), frame = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "range", min: 1, max: last, step: 1, value: state.steps[i] });
    frame.className = "wide";
    frame.append("Trainings ", input, document.createElement("output"));
    input.addEventListener("input", () => { state.steps[i] = +input.value; redraw(i, ["model"]); });
    if (state.items[i].axes.length > 1) {
      mapControls(i, "model", [["mean", "mean"], ["std", "standard deviation"], ["gain", "score"], ["served", "best policy so far"]]);
    }
    box.prepend(frame);
  }

  function redraw(i, parts) {
    for (const [box, part] of state.drawn) {
      if (parts.includes(part) && box.closest("article") === article(i)) pictures[part](i, box);
    }
  }

  function servingTable(i, place) {
    if (place.childElementCount) return;
    const item = state.items[i], s = item.served, table = document.createElement("table");
    const more = Object.entries(item.columns), heads = table.createTHead().insertRow();
    ["context", "policy", "which is", "performance", "runner-up", "its performance", ...more.map(([head]) => head)].forEach((head) => {
      const cell = document.createElement("th");
      cell.textContent = head;
      heads.append(cell);
    });
    const body = table.createTBody();
    for (let c = 0; c < item.n; c++) {
      const row = body.insertRow(), p = s.policy[c], r = s.runnerUp[c];
      [describe(item, c), p + 1, home(item, p), fixed(s.performance[c]), r < 0 ? "–" : r + 1, fixed(s.runnerUpPerformance[c]), ...more.map(([, values]) => fixed(values[c]))]
        .forEach((text) => (row.insertCell().textContent = text));
    }
    place.append(table);
  }

  function theme(choice) {
    if (choice) root.dataset.theme = choice;
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    byId("theme").textContent = dark ? "Light" : "Dark";
    byId("theme").setAttribute("aria-pressed", String(dark));
    for (const [box, part] of state.drawn) pictures[part](+box.closest("article").dataset.item, box);
  }

  function show(which) {
    state.which = which;
    document.querySelectorAll("article").forEach((one) => (one.hidden = +one.dataset.item !== which));
  }

  async function start() {
    const [data, code] = await Promise.all([unpack("data"), unpack("plotly")]);
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(code);
    document.head.append(script);
    const length = new DataView(data).getUint32(0, true), first = Math.ceil((length + 4) / 8) * 8;
    state.items = revive(JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))), data, first);
    state.steps = state.items.map((item) => item.sources.length);
    theme();
    byId("theme").addEventListener("click", () => theme(byId("theme").getAttribute("aria-pressed") === "true" ? "light" : "dark"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => theme());
    byId("which")?.addEventListener("change", (event) => show(+event.target.value));
    show(0);

    const itemOf = (box) => +box.closest("article").dataset.item;
    const once = (box) => {
      if (state.drawn.has(box)) return;
      near.unobserve(box);
      state.drawn.set(box, box.dataset.chart);
      pictures[box.dataset.chart](itemOf(box), box);
    };
    const fill = (box) => box.open && servingTable(itemOf(box), box.querySelector(".scroll"));
    const near = new IntersectionObserver((seen) => seen.forEach((one) => one.isIntersecting && once(one.target)), { rootMargin: "400px" });
    document.querySelectorAll("[data-chart]").forEach((box) => near.observe(box));
    document.querySelectorAll("details[data-table]").forEach((box) => box.addEventListener("toggle", () => fill(box)));
    addEventListener("beforeprint", () => { // on paper nothing can be scrolled to, or opened
      theme("light");
      article(state.which).querySelectorAll("[data-chart]").forEach(once);
      article(state.which).querySelectorAll("details[data-table]").forEach((box) => { box.open = true; fill(box); });
    });
    document.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      const input = article(state.which).querySelector('input[type="range"]');
      if (!step || !input || event.target.closest("input, select, button, summary")) return;
      input.value = +input.value + step;
      input.dispatchEvent(new Event("input"));
    });
    requestAnimationFrame(() => setTimeout(() => (root.dataset.ready = Math.round(performance.now())), 0));
  }
  start();
})();
