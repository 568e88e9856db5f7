// The curves, drawn by uPlot: force, area, and a third one of choice, live or of the last press.
/* global uPlot */

const $ = (id) => document.getElementById(id);
const SPAN = 10;
// s of difference from which stamps are of another clock than the server's.
const OTHER_CLOCK = 2;
// s of live curves that stay for a pause; the server keeps as much for a reload.
const KEPT = 30;
// s without an estimate that end its line: the finger was off the plate.
const GAP = 0.3;
// Columns of a point, after time and force: of a measured area, and of an estimate.
const AREA = 2;
const ESTIMATE = 2, DEVIATION = 3, INDENTATION = 4, MEAN = 5, PEAK = 6;
const KINDS = ["force", "measured", "model"];

const empty = () => ({ force: [], measured: [], model: [] });
const last = (points) => points[points.length - 1];

function nearest(points, time) {
  let low = 0, high = points.length - 1;
  if (high < 0) return null;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle][0] < time) low = middle + 1; else high = middle;
  }
  if (low > 0 && time - points[low - 1][0] < points[low][0] - time) low -= 1;
  return Math.abs(points[low][0] - time) < GAP ? points[low] : null;
}

function columns(points, wanted) {
  const result = wanted.map(() => []);
  let before = null;
  for (const point of points) {
    if (before !== null && point[0] - before > GAP) {
      result[0].push(before + 0.001);
      for (let i = 1; i < wanted.length; i++) result[i].push(null);
    }
    wanted.forEach((column, i) => {
      result[i].push(typeof column === "function" ? column(point) : point[column]);
    });
    before = point[0];
  }
  return result;
}

export class Charts {
  constructor(moved) {
    this.moved = moved;
    this.live = empty();
    this.before = empty();
    this.press = null;
    this.lastPress = null;
    this.target = 1;
    this.mode = "live";
    this.window = null;
    this.zero = 0;
    this.hover = null;
    this.time = null;
    this.clock = null;
    this.offset = 0;
    this.third = "loop";
    this.measured = [];
    this.highest = 0;
    this.build();
    const light = matchMedia("(prefers-color-scheme: dark)");
    light.addEventListener("change", () => this.build());
    this.watch = new ResizeObserver(() => this.fit());
    for (const id of ["force-plot", "area-plot", "third-plot"]) this.watch.observe($(id));
  }

  // Data ----------------------------------------------------------------------------------------

  // clock: the server's time (s) now; the live curves end there, so that silence shows as a gap.
  setClock(time) { this.clock = { time, at: performance.now() }; }

  now() {
    const newest = last(this.live.force)?.[0] ?? 0;
    if (!this.clock) return newest;
    return this.serverTime() - this.offset;
  }

  serverTime() { return this.clock.time + (performance.now() - this.clock.at) / 1e3; }

  // Stamps of another clock, of a bag that is replayed or of a driver that was started before the
  // system clock was stepped, are followed: what comes now is of now.
  follow(time) {
    if (!this.clock) return;
    const offset = this.serverTime() - time;
    this.offset = Math.abs(offset) > OTHER_CLOCK ? offset : 0;
  }

  add(kind, points) {
    const all = this.live[kind];
    if (kind === "force" && points.length) this.follow(last(points)[0]);
    if (all.length && points.length && points[0][0] < last(all)[0] - 1) all.length = 0;
    all.push(...points);
    const newest = last(all)?.[0] ?? 0;
    const kept = this.press ? 60 : KEPT;
    let first = 0;
    while (first < all.length && all[first][0] < newest - kept) first += 1;
    if (first > 200) all.splice(0, first);
  }

  restore({ live, press, last: done }) {
    for (const kind of KINDS) this.live[kind] = live[kind] || [];
    this.press = press === null ? null : { began: press };
    if (done) this.setLast(done);
  }

  pressBegins(index, began) {
    this.press = { index, began };
    if (this.lastPress) this.before = this.lastPress.curves;
    this.lastPress = null;
    $("last").disabled = true;
    if (this.mode === "last") this.show("live");
  }

  pressEnds(ended) {
    if (!this.press) return;
    const { index, began } = this.press;
    this.press = null;
    this.setLast({ index, began, ended, ...this.since(began) });
  }

  // What was drawn with another zero means nothing.
  forget() {
    this.live = empty();
    this.before = empty();
  }

  setLast({ index, began, ended, force, measured, model }) {
    this.lastPress = { index, began, ended, curves: { force, measured, model } };
    $("last").disabled = false;
  }

  since(began) {
    return Object.fromEntries(
      KINDS.map((kind) => [kind, this.live[kind].filter((p) => p[0] >= began - 1)]));
  }

  shown() { return this.mode === "last" ? this.lastPress.curves : this.live; }

  // Points of the press that the loop shows.
  loop() {
    if (this.mode === "last") return this.lastPress.curves;
    if (this.press) return this.since(this.press.began);
    return this.lastPress ? this.lastPress.curves : this.live;
  }

  // Time ----------------------------------------------------------------------------------------

  show(mode) {
    if (mode === "last" && !this.lastPress) return;
    this.mode = mode;
    this.hover = null;
    const end = this.now();
    if (mode === "last") {
      const { began, ended, curves } = this.lastPress;
      const first = curves.model[0]?.[0] ?? began;
      this.zero = first;
      this.window = this.whole = [first - 0.3, Math.max(ended, first + 0.5)];
    } else if (mode === "frozen") {
      this.zero = end;
      this.whole = [Math.max(end - KEPT, this.live.force[0]?.[0] ?? end - SPAN), end];
      this.window = [end - SPAN, end];
    } else this.window = null;
    this.time = mode === "live" ? null : this.window[1];
    for (const [id, its] of [["live", "live"], ["freeze", "frozen"], ["last", "last"]]) {
      $(id).setAttribute("aria-pressed", String(mode === its));
    }
    $("scrub").disabled = mode === "live";
    $("scrub").value = mode === "last" ? 0 : 1;
    $("zoom-out").disabled = mode === "live";
    if (mode === "last") this.scrub(0);
    this.draw();
  }

  zoom(low, high) {
    if (this.mode === "live") this.show("frozen");
    this.window = [low, high];
    this.draw();
  }

  zoomOut() {
    if (this.mode === "live") return;
    this.window = this.whole;
    this.draw();
  }

  scrub(share) {
    if (this.mode === "live") return;
    const [low, high] = this.whole;
    this.time = low + share * (high - low);
    if (this.time < this.window[0] || this.time > this.window[1]) this.window = this.whole;
    const text = `${(this.time - this.zero).toFixed(2)} s`;
    $("scrub").setAttribute("aria-valuetext", text);
    this.moved(this.time);
    this.draw();
  }

  // Points at the cursor, or the newest.
  at() {
    const time = this.hover ?? this.time;
    const shown = this.shown();
    if (time === null) return Object.fromEntries(KINDS.map((k) => [k, last(shown[k]) ?? null]));
    return Object.fromEntries(KINDS.map((k) => [k, nearest(shown[k], time)]));
  }

  // Drawing -------------------------------------------------------------------------------------

  build() {
    const style = getComputedStyle(document.documentElement);
    this.colour = (name) => style.getPropertyValue(`--c-${name}`).trim();
    for (const chart of [this.force, this.area, this.thirdChart]) chart?.destroy();
    const c = this.colour;
    this.force = this.timeChart("force-plot", "N", [
      { label: "force", stroke: c("measured"), width: 2.5, points: { show: false } },
    ], () => this.forceRange(), (u) => this.drawTarget(u));
    this.area = this.timeChart("area-plot", "mm²", [
      { label: "estimated", stroke: c("model"), width: 2.5, points: { show: false } },
      { label: "high", stroke: null, points: { show: false } },
      { label: "low", stroke: null, points: { show: false } },
    ], (high) => [0, Math.max(high * 1.06, this.highest * 1.06, 60)], (u) => this.drawMeasured(u),
    [{ series: [2, 3], fill: c("band") }]);
    this.buildThird();
    this.draw();
  }

  buildThird() {
    this.thirdChart?.destroy();
    const c = this.colour;
    const legend = $("third-legend");
    const names = {
      loop: [["measured", "measured"], ["model", "estimated"], ["before", "press before"]],
      indentation: [], pressure: [["model", "mean"], ["measured", "peak"]],
    }[this.third];
    legend.replaceChildren(...names.map(([kind, text]) => {
      const item = document.createElement("span");
      const mark = document.createElement("i");
      mark.className = this.third === "pressure" ? `model ${kind}` : kind;
      item.append(mark, text);
      return item;
    }));
    $("third-unit").textContent = { loop: "", indentation: "mm", pressure: "kPa" }[this.third];
    const name = { loop: "contact area over normal force, measured and estimated",
      indentation: "estimated indentation over time", pressure: "estimated pressures" };
    $("third-plot").setAttribute("aria-label", name[this.third]);
    if (this.third === "loop") this.thirdChart = this.loopChart();
    else if (this.third === "indentation") {
      this.thirdChart = this.timeChart("third-plot", "mm", [
        { label: "indentation", stroke: c("model"), width: 2.5, points: { show: false } },
      ], (high) => [0, Math.max(high * 1.06, 0.5)]);
    } else {
      this.thirdChart = this.timeChart("third-plot", "kPa", [
        { label: "mean", stroke: c("model"), width: 2.5, points: { show: false } },
        { label: "peak", stroke: c("measured"), width: 2.5, points: { show: false } },
      ], (high) => [0, Math.max(high * 1.06, 10)]);
    }
  }

  // The unit stands at the last number of an axis.
  axis(unit, side) {
    const c = this.colour;
    const text = (v) => String(Number(v.toPrecision(6))).replace("-", "−");
    return {
      side, stroke: c("axis"), font: "12px system-ui", gap: 4,
      // Wide enough for the longest number with its unit.
      size: side === 3 ? (u, all) => Math.max(54, ...(all || []).map((v) => 7 * v.length + 12))
        : 22,
      grid: { stroke: c("grid"), width: 1 }, ticks: { show: false },
      values: (u, all) => all.map((v, i) => text(v) + (i === all.length - 1 ? ` ${unit}` : "")),
    };
  }

  timeChart(id, unit, series, range, over = null, bands = []) {
    const x = this.axis("s", 2);
    x.splits = (u) => {
      const { min, max } = u.scales.x;
      const step = [0.1, 0.2, 0.5, 1, 2, 5, 10].find((s) => (max - min) / s <= 8) || 20;
      const found = [];
      for (let k = Math.ceil((min - this.zero) / step); this.zero + k * step <= max; k++) {
        found.push(this.zero + k * step);
      }
      return found;
    };
    x.values = (u, all) => all.map((v, i) => {
      const text = String(Number((v - this.zero).toFixed(2))).replace("-", "−");
      return (text === "−0" ? "0" : text) + (i === all.length - 1 ? " s" : "");
    });
    const chart = new uPlot({
      ...this.sizeOf(id), legend: { show: false }, bands,
      padding: [10, 14, 0, 0],
      scales: { x: { time: false }, y: { range: (u, low, high) => range(high ?? 0, low ?? 0) } },
      axes: [x, this.axis(unit, 3)],
      series: [{}, ...series],
      cursor: { y: false, sync: { key: "time" }, drag: { x: true, y: false, setScale: false },
        points: { size: 8 }, bind: { dblclick: () => () => { this.zoomOut(); return null; } } },
      hooks: {
        setCursor: [(u) => this.hovered(u)],
        setSelect: [(u) => this.selected(u)],
        draw: [...(over ? [over] : []), (u) => this.drawTime(u)],
      },
    }, [[], ...series.map(() => [])], $(id));
    return chart;
  }

  loopChart() {
    const chart = new uPlot({
      ...this.sizeOf("third-plot"), legend: { show: false }, padding: [10, 14, 0, 0],
      scales: {
        x: { time: false, range: (u, low, high) => [0, high] },
        y: { range: (u, low, high) => [0, high] },
      },
      axes: [this.axis("N", 2), this.axis("mm²", 3)],
      series: [{}, { stroke: null, points: { show: false } }],
      cursor: { drag: { x: false, y: false }, points: { show: false } },
      hooks: { draw: [(u) => this.drawLoop(u)] },
    }, [[0, 1], [0, 60]], $("third-plot"));
    return chart;
  }

  sizeOf(id) {
    const box = $(id);
    return { width: Math.max(box.clientWidth, 80), height: Math.max(box.clientHeight, 60) };
  }

  fit() {
    for (const [chart, id] of [[this.force, "force-plot"], [this.area, "area-plot"],
      [this.thirdChart, "third-plot"]]) {
      const size = this.sizeOf(id);
      if (chart.width !== size.width || chart.height !== size.height) chart.setSize(size);
    }
  }

  hovered(u) {
    if (u.cursor.event == null && this.mode === "live") return;
    const inside = u.cursor.left >= 0 && u.cursor.event != null;
    this.hover = inside ? u.posToVal(u.cursor.left, "x") : null;
    this.moved(this.hover ?? this.time);
  }

  selected(u) {
    const { left, width } = u.select;
    if (width < 8) return;
    const low = u.posToVal(left, "x"), high = u.posToVal(left + width, "x");
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.zoom(low, high);
  }

  forceRange() {
    let high = Math.max(this.target * 1.25, 0.5), low = 0;
    const { min, max } = this.force.scales.x;
    for (const [t, f] of this.shown().force) {
      if (t < min || t > max) continue;
      if (f * 1.05 > high) high = f * 1.05;
      if (f < low) low = f;
    }
    return [Math.min(low * 1.05, -0.06 * high), high];
  }

  draw() {
    const shown = this.shown();
    const end = this.now();
    if (this.mode === "live") this.zero = end;
    const [min, max] = this.window ?? [end - SPAN, end];
    const visible = (kind) => shown[kind].filter((p) => p[0] >= min - GAP && p[0] <= max + GAP);
    const set = (chart, data) => {
      chart.batch(() => { chart.setData(data, false); chart.setScale("x", { min, max }); });
    };
    set(this.force, columns(visible("force"), [0, 1]));
    const model = visible("model");
    const spread = (sign) => (p) => (p[DEVIATION] === null || p[ESTIMATE] === null ? null
      : Math.max(p[ESTIMATE] + sign * 1.96 * p[DEVIATION], 0));
    const estimated = columns(model, [0, ESTIMATE, spread(1), spread(-1)]);
    this.measured = visible("measured");
    this.highest = Math.max(0, ...this.measured.map((p) => p[AREA]));
    set(this.area, estimated);
    if (this.third === "indentation") set(this.thirdChart, columns(model, [0, INDENTATION]));
    else if (this.third === "pressure") set(this.thirdChart, columns(model, [0, MEAN, PEAK]));
    else this.setLoop();
  }

  setLoop() {
    let x = this.target * 1.15, y = 60;
    const loop = this.loop();
    for (const { measured, model } of [loop, this.before]) {
      for (const p of measured) { x = Math.max(x, p[1] * 1.03); y = Math.max(y, p[AREA] * 1.06); }
      for (const p of model) { x = Math.max(x, p[1] * 1.03); y = Math.max(y, p[ESTIMATE] * 1.06); }
    }
    this.thirdChart.setData([[0, x], [0, y]]);
  }

  // In the canvas ---------------------------------------------------------------------------------

  halo(u, text, x, y) {
    const { ctx } = u, ratio = devicePixelRatio;
    ctx.font = `600 ${12 * ratio}px system-ui, sans-serif`;
    ctx.strokeStyle = this.colour("panel");
    ctx.lineWidth = 4 * ratio;
    ctx.fillStyle = this.colour("target");
    ctx.textBaseline = "bottom";
    ctx.strokeText(text, x, y);
    ctx.fillText(text, x, y);
  }

  dashed(u, points) {
    const { ctx } = u, ratio = devicePixelRatio;
    ctx.strokeStyle = this.colour("target");
    ctx.lineWidth = 2 * ratio;
    ctx.setLineDash([8 * ratio, 5 * ratio]);
    ctx.beginPath();
    points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
    ctx.stroke();
    ctx.setLineDash([]);
  }

  drawTarget(u) {
    const { ctx, bbox } = u, ratio = devicePixelRatio;
    const y = u.valToPos(this.target, "y", true);
    ctx.save();
    this.dashed(u, [[bbox.left, y], [bbox.left + bbox.width, y]]);
    ctx.textAlign = "left";
    this.halo(u, `target ${this.target.toFixed(2)} N`, bbox.left + 8 * ratio, y - 3 * ratio);
    ctx.restore();
  }

  drawMeasured(u) {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.fillStyle = this.colour("measured");
    for (const p of this.measured) {
      ctx.beginPath();
      ctx.arc(u.valToPos(p[0], "x", true), u.valToPos(p[AREA], "y", true),
        3.5 * devicePixelRatio, 0, 7);
      ctx.fill();
    }
    ctx.restore();
  }

  drawTime(u) {
    if (this.time === null) return;
    const { ctx, bbox } = u;
    const x = u.valToPos(this.time, "x", true);
    if (x < bbox.left || x > bbox.left + bbox.width) return;
    ctx.save();
    ctx.strokeStyle = this.colour("axis");
    ctx.lineWidth = 2 * devicePixelRatio;
    ctx.beginPath(); ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height); ctx.stroke();
    ctx.restore();
  }

  drawLoop(u) {
    const { ctx, bbox } = u, ratio = devicePixelRatio;
    const x = (v) => u.valToPos(v, "x", true), y = (v) => u.valToPos(v, "y", true);
    const line = (points, colour, width) => {
      ctx.strokeStyle = colour;
      ctx.lineWidth = width * ratio;
      ctx.lineJoin = "round";
      ctx.beginPath();
      let time = null;
      for (const p of points) {
        if (p[ESTIMATE] === null) { time = null; continue; }
        const near = time !== null && p[0] - time < GAP;
        if (near) ctx.lineTo(x(p[1]), y(p[ESTIMATE])); else ctx.moveTo(x(p[1]), y(p[ESTIMATE]));
        time = p[0];
      }
      ctx.stroke();
    };
    const dots = (points, colour, radius) => {
      ctx.fillStyle = colour;
      for (const p of points) {
        ctx.beginPath(); ctx.arc(x(p[1]), y(p[AREA]), radius * ratio, 0, 7); ctx.fill();
      }
    };
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    this.dashed(u, [[x(this.target), bbox.top], [x(this.target), bbox.top + bbox.height]]);
    const loop = this.loop();
    line(this.before.model, this.colour("before"), 1.5);
    dots(this.before.measured, this.colour("before"), 3);
    line(loop.model, this.colour("model"), 2.5);
    dots(loop.measured, this.colour("measured"), 4);
    const here = this.mode === "live" ? null : this.at().model;
    if (here && here[ESTIMATE] !== null) {
      ctx.fillStyle = this.colour("target");
      ctx.beginPath(); ctx.arc(x(here[1]), y(here[ESTIMATE]), 6 * ratio, 0, 7); ctx.fill();
    }
    ctx.restore();
  }

  // The area that an estimate has, with what its band is, as text.
  static estimate(point) {
    if (!point || point[ESTIMATE] === null) return "–";
    const spread = point[DEVIATION];
    const band = spread === null ? "" : ` ± ${(1.96 * spread).toFixed(1)}`;
    return `${point[ESTIMATE].toFixed(1)}${band}`;
  }

  static third(kind, point) {
    if (!point) return "";
    const digits = (v, n) => (v === null ? "–" : v.toFixed(n));
    if (kind === "indentation") return digits(point[INDENTATION], 2);
    if (kind === "pressure") return `${digits(point[MEAN], 1)} · ${digits(point[PEAK], 1)}`;
    return "";
  }
}
