// Two small plots on canvas: force over time, area over force.

const COLOUR = {
  faint: "#8b97a5", grid: "#e3e8ee", force: "#0072b2", target: "#d55e00",
  measured: "#0072b2", model: "#e69f00", before: "#b9c3ce",
};

function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  g.font = "12px system-ui, sans-serif";
  return { g, width, height };
}

function ticks(high, wanted) {
  const raw = high / wanted;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const values = [];
  for (let v = 0; v <= high * 1.0001; v += step) values.push(Number(v.toPrecision(6)));
  return values;
}

function axes(g, box, xs, ys, x, y, xName, yName) {
  g.strokeStyle = COLOUR.grid;
  g.fillStyle = COLOUR.faint;
  g.lineWidth = 1;
  g.textAlign = "right";
  g.textBaseline = "middle";
  for (const v of ys) {
    g.beginPath(); g.moveTo(box.left, y(v)); g.lineTo(box.right, y(v)); g.stroke();
    g.fillText(String(v), box.left - 6, y(v));
  }
  g.textAlign = "center";
  g.textBaseline = "top";
  for (const v of xs) {
    g.beginPath(); g.moveTo(x(v), box.top); g.lineTo(x(v), box.bottom); g.stroke();
    g.fillText(String(v), x(v), box.bottom + 5);
  }
  g.textAlign = "right";
  g.fillText(xName, box.right, box.bottom + 19);
  g.textAlign = "left";
  g.textBaseline = "top";
  g.fillText(yName, 2, 0);
}

function line(g, points, x, y) {
  g.beginPath();
  points.forEach(([a, b], i) => (i ? g.lineTo(x(a), y(b)) : g.moveTo(x(a), y(b))));
  g.stroke();
}

export function forcePlot(canvas, samples, target, span) {
  const { g, width, height } = prepare(canvas);
  const box = { left: 34, right: width - 8, top: 18, bottom: height - 34 };
  const newest = samples.length ? samples[samples.length - 1][0] : 0;
  let high = Math.max(target * 1.25, 0.5);
  for (const [, f] of samples) high = Math.max(high, f * 1.05);
  const low = -0.08 * high;
  const x = (t) => box.right + ((t - newest) / span) * (box.right - box.left);
  const y = (f) => box.bottom - ((f - low) / (high - low)) * (box.bottom - box.top);
  const xs = [];
  for (let s = -span; s <= 0; s += 2) xs.push(s);
  axes(g, box, xs, ticks(high, 5), (s) => x(newest + s), y, "s", "N");
  g.strokeStyle = COLOUR.target;
  g.setLineDash([8, 5]);
  g.lineWidth = 2;
  g.beginPath(); g.moveTo(box.left, y(target)); g.lineTo(box.right, y(target)); g.stroke();
  g.setLineDash([]);
  g.save();
  g.beginPath(); g.rect(box.left, box.top, box.right - box.left, box.bottom - box.top); g.clip();
  g.strokeStyle = COLOUR.force;
  g.lineWidth = 2.5;
  g.lineJoin = "round";
  line(g, samples, x, y);
  g.restore();
  // On top of the curve, with a halo, so that it stays readable.
  g.fillStyle = COLOUR.target;
  g.font = "600 12px system-ui, sans-serif";
  g.textAlign = "left";
  g.textBaseline = "bottom";
  g.strokeStyle = "#fff";
  g.lineWidth = 4;
  g.strokeText(`target ${target.toFixed(2)} N`, box.left + 6, y(target) - 4);
  g.fillText(`target ${target.toFixed(2)} N`, box.left + 6, y(target) - 4);
}

export function areaPlot(canvas, now, before, target) {
  const { g, width, height } = prepare(canvas);
  const box = { left: 34, right: width - 8, top: 18, bottom: height - 34 };
  let xHigh = target * 1.15, yHigh = 60;
  for (const points of [now.measured, now.model, before.measured, before.model]) {
    for (const [f, a] of points) {
      xHigh = Math.max(xHigh, f * 1.03);
      yHigh = Math.max(yHigh, a * 1.06);
    }
  }
  const x = (f) => box.left + (f / xHigh) * (box.right - box.left);
  const y = (a) => box.bottom - (a / yHigh) * (box.bottom - box.top);
  axes(g, box, ticks(xHigh, 6), ticks(yHigh, 5), x, y, "N", "mm²");
  g.strokeStyle = COLOUR.target;
  g.setLineDash([8, 5]);
  g.lineWidth = 1.5;
  g.beginPath(); g.moveTo(x(target), box.top); g.lineTo(x(target), box.bottom); g.stroke();
  g.setLineDash([]);
  const dots = (points, colour, radius) => {
    g.fillStyle = colour;
    for (const [f, a] of points) { g.beginPath(); g.arc(x(f), y(a), radius, 0, 7); g.fill(); }
  };
  g.lineJoin = "round";
  g.lineWidth = 1.5; g.strokeStyle = COLOUR.before; line(g, before.model, x, y);
  dots(before.measured, COLOUR.before, 3);
  g.lineWidth = 2.5; g.strokeStyle = COLOUR.model; line(g, now.model, x, y);
  dots(now.measured, COLOUR.measured, 4.5);
}
