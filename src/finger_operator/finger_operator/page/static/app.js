// The operator's page. State comes over one WebSocket; every command goes back over it, with the
// page's token.
import { Link, draw, whenShown } from "./cue.js";
import { areaPlot, forcePlot } from "./plot.js";

const $ = (id) => document.getElementById(id);
const token = document.querySelector("meta[name=token]").content;
const SPAN = 10;
// Steps of a trial that is under way.
const RUNNING = ["moisture_before", "clear", "press", "lift", "moisture_after", "closing"];

const state = {
  status: { step: "closed" }, cue: null, force: [], target: 1, health: [], answers: new Map(),
  now: { measured: [], model: [] }, before: { measured: [], model: [] }, number: 0,
  imageUrl: null, area: null,
};
let dirty = true;
let drawn = 0;
let plotted = 0;

// Commands ------------------------------------------------------------------------------------

function command(name, args = {}) {
  const id = ++state.number;
  return new Promise((resolve) => {
    state.answers.set(id, resolve);
    if (!link.send({ type: "command", name, arguments: args, token, id })) {
      state.answers.delete(id);
      resolve({ success: false, message: "not connected" });
    }
  }).then((answer) => {
    notify(answer.success ? answer.message || `${name}: done` : answer.message, answer.success);
    return answer;
  });
}

let forget = 0;
function notify(text, good) {
  const place = $("answer");
  place.textContent = text;
  place.className = good ? "good" : "bad";
  clearTimeout(forget);
  if (good) forget = setTimeout(() => { place.textContent = ""; place.className = ""; }, 6000);
}

function primary() {
  const { step, paused } = state.status;
  if (step === "closed") return openSession();
  if (paused) return command("resume");
  if (step === "finished") return command("close");
  return command("start");
}

function pauseOrResume() {
  return command(state.status.paused ? "resume" : "pause");
}

function openSession() {
  const plan = state.status.plan;
  if (!plan) return notify("The protocol node is not running.", false);
  $("plan-subject").value = plan.subject;
  $("plan-conditions").value = plan.conditions.join(", ");
  $("plan-trials").value = plan.trials;
  $("plan-readings").value = plan.readings;
  $("plan-target").value = plan.target_force;
  $("plan-error").textContent = "";
  $("session-dialog").showModal();
}

async function beginSession(event) {
  event.preventDefault();
  const answer = await command("configure", {
    subject: $("plan-subject").value.trim(),
    conditions: $("plan-conditions").value.split(",").map((c) => c.trim()).filter(Boolean),
    trials: Number($("plan-trials").value),
    readings: Number($("plan-readings").value),
    target_force: Number($("plan-target").value),
  });
  const started = answer.success ? await command("start") : answer;
  if (started.success) $("session-dialog").close();
  else $("plan-error").textContent = started.message;
}

// Cue -----------------------------------------------------------------------------------------

function showCue(message) {
  const began = message.phase === "press" && (!state.cue || state.cue.phase !== message.phase);
  state.cue = message;
  drawCue();
  // The frame that carries the cue carries nothing else that takes time to draw.
  drawn = performance.now() + 80;
  if (!document.hidden) waiting ??= [];
  whenShown(() => {
    if (message.id >= 0) link.send({ type: "shown", id: message.id });
    goOn();
  });
  if (began) {
    state.before = state.now;
    state.now = { measured: [], model: [] };
  }
  dirty = true;
}

function drawCue() {
  const s = state.status;
  let name = state.cue ? state.cue.phase : "idle";
  if (s.step === "closed") name = "closed";
  else if (s.paused) name = "paused";
  // Press and lift are the cue's own; the finer steps come with the status.
  else if (name !== "press" && name !== "lift") {
    if (["clear", "closing", "finished"].includes(s.step)) name = s.step;
  }
  draw(name);
  const number = (list) => Math.min((list || []).length + 1, s.readings);
  const count = (list) => `reading ${number(list)} of ${s.readings}`;
  const texts = {
    closed: "Start a session with Space.",
    prepare: "Prepare finger and plate, then press Space.",
    moisture_before: `Before the press: ${count(s.moisture_before)}`,
    moisture_after: `After the press: ${count(s.moisture_after)}`,
    clear: s.waiting_for || "Hands off: the frame must be empty.",
    press: "Press until the cue changes.",
    lift: "Lift the finger.",
    paused: s.message || "Resume with P or Space.",
    failed: (state.cue && state.cue.note) || "",
    done: "Trial kept.",
    closing: "The bag is being closed.",
    finished: "All trials are done. Space closes the session.",
  };
  $("cue-text").textContent = texts[name] || "";
}

// Status --------------------------------------------------------------------------------------

const LABELS = {
  closed: "New session", prepare: "Ready", idle: "Begin", finished: "Close session",
};
const MARK = { done: "✓", skipped: "↷", pending: "", failed: "✗" };

function showStatus(s) {
  state.status = s;
  if (s.target_force) state.target = s.target_force;
  const open = s.step !== "closed";
  $("session").textContent = open ? `${s.subject} · ${s.session}` : "no session";
  const attempt = s.attempt ? ` · attempt ${s.attempt + 1}` : "";
  $("cue-trial").textContent = open && s.step !== "finished"
    ? `Trial ${s.index + 1} of ${s.trials.length} · ${s.condition}${attempt}` : "";
  $("preparation-condition").textContent = open ? s.condition : "";
  $("preparation-text").textContent = open ? s.preparation : "";
  $("prompt").textContent = open ? s.prompt : "";
  $("preparation").dataset.now = s.step === "prepare" && !s.paused;
  $("start").querySelector("span").textContent = s.paused ? "Resume" : LABELS[s.step] || "Next";
  $("start").disabled = RUNNING.includes(s.step) && !s.paused;
  $("pause").disabled = !open || s.step === "finished" || s.step === "idle";
  $("pause").firstChild.textContent = s.paused ? "Resume " : "Pause ";
  $("redo").disabled = !open || s.step === "closing";
  $("skip").disabled = !open || ["finished", "done", "closing", "idle"].includes(s.step);
  $("preparation-edit").disabled = !open;
  chips("moisture-before", s.moisture_before, s.readings, s.step === "moisture_before");
  chips("moisture-after", s.moisture_after, s.readings, s.step === "moisture_after");
  showTrials(s);
  drawCue();
  dirty = true;
}

// The status takes long to draw and may arrive before the cue: the cue is drawn first.
let soon = 0;
function showStatusSoon(s) {
  clearTimeout(soon);
  soon = setTimeout(() => (waiting ? showStatusSoon(s) : showStatus(s)), 60);
}

function chips(id, values = [], wanted = 3, now = false) {
  const cells = [];
  for (let i = 0; i < Math.max(wanted, values.length); i++) {
    const chip = document.createElement("span");
    const full = i < values.length;
    chip.className = full ? "chip full" : now && i === values.length ? "chip next" : "chip";
    chip.textContent = full ? values[i].toFixed(1) : "–";
    cells.push(chip);
  }
  if (values.length > 1) {
    const mean = document.createElement("span");
    mean.className = "mean";
    mean.textContent = `mean ${(values.reduce((a, b) => a + b) / values.length).toFixed(1)}`;
    cells.push(mean);
  }
  $(id).replaceChildren(...cells);
}

function showTrials(s) {
  const trials = s.trials || [];
  const body = $("trials").querySelector("tbody");
  const free = !RUNNING.includes(s.step);
  body.replaceChildren(...trials.flatMap((t) => {
    const row = document.createElement("tr");
    const here = t.index === s.index && s.step !== "finished";
    const failed = t.verdict === "pending" && t.reason;
    const verdict = t.verdict === "pending" ? (failed ? "failed" : "pending") : t.verdict;
    row.dataset.verdict = verdict;
    row.dataset.index = t.index;
    if (here) row.className = "here";
    const word = verdict === "pending" ? (here ? "now" : "") : verdict;
    const cells = [t.index + 1, t.condition,
      `${MARK[verdict] || ""} ${word}${t.attempts > 1 ? ` ×${t.attempts}` : ""}`,
      t.time_to_target == null ? "" : `${t.time_to_target.toFixed(2)} s`,
      t.peak_force ? `${t.peak_force.toFixed(2)} N` : ""];
    for (const text of cells) {
      const cell = document.createElement("td");
      cell.textContent = text;
      row.append(cell);
    }
    const last = document.createElement("td");
    if (t.verdict === "done" || t.verdict === "skipped") {
      const again = document.createElement("button");
      again.className = "small repeat";
      again.textContent = "Repeat";
      again.disabled = !free;
      again.onclick = () => command("repeat", { index: t.index });
      last.append(again);
    }
    row.append(last);
    if (!failed) return [row];
    const why = document.createElement("tr");
    why.className = here ? "reason here" : "reason";
    why.dataset.index = t.index;
    const text = document.createElement("td");
    text.colSpan = 5;
    text.textContent = t.reason;
    why.append(document.createElement("td"), text);
    return [row, why];
  }));
  const here = body.querySelector(".here");
  if (here && s.index !== showTrials.index) {
    showTrials.index = s.index;
    const box = body.closest(".scroll");
    box.scrollTop = here.offsetTop - box.clientHeight / 2;
  }
  const blocks = (s.conditions || []).map((name) => {
    const of = trials.filter((t) => t.condition === name);
    const item = document.createElement("li");
    const closed = of.filter((t) => t.verdict !== "pending").length;
    item.textContent = `${name} ${closed}/${of.length}`;
    if (closed === of.length && of.length) item.className = "full";
    if (name === s.condition && s.step !== "finished") item.className = "now";
    item.style.setProperty("--share", of.length ? closed / of.length : 0);
    return item;
  });
  $("progress").replaceChildren(...blocks);
}

const LEVELS = [["ok", "✓"], ["warn", "▲"], ["error", "✖"], ["stale", "◌"]];

function showHealth(items) {
  const list = $("health").querySelector("ul");
  const open = new Set([...list.querySelectorAll("details[open]")].map((d) => d.dataset.name));
  // What needs a look comes first; the server sends them by name.
  items.sort((a, b) => b.level - a.level);
  list.replaceChildren(...items.map((item) => {
    const [level, mark] = LEVELS[item.level] || LEVELS[3];
    const row = document.createElement("li");
    row.dataset.level = level;
    const details = document.createElement("details");
    details.dataset.name = item.name;
    details.open = open.has(item.name);
    const summary = document.createElement("summary");
    const hertz = item.values.measured_rate_hz;
    const rate = hertz ? ` · ${Number(hertz).toFixed(0)} Hz` : "";
    const name = item.name.replace(/^[^:]*\//, "").replace(/^(\w+): \1$/, "$1");
    for (const [kind, text] of [["mark", mark], ["name", name], ["message", item.message + rate]]) {
      const part = document.createElement("span");
      part.className = kind;
      part.textContent = text;
      summary.append(part);
    }
    details.append(summary);
    const values = document.createElement("dl");
    for (const [key, value] of Object.entries(item.values)) {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = key; dd.textContent = value;
      values.append(dt, dd);
    }
    details.append(values);
    row.append(details);
    return row;
  }));
}

function showImage(buffer) {
  const url = URL.createObjectURL(new Blob([buffer.slice(8)], { type: "image/jpeg" }));
  const image = $("image");
  image.onload = () => {
    if (state.imageUrl) URL.revokeObjectURL(state.imageUrl);
    state.imageUrl = url;
  };
  image.src = url;
  image.hidden = false;
  $("image-none").hidden = true;
}

// The link ------------------------------------------------------------------------------------

// Messages held back until the frame with a cue is on the screen; null when there is none.
let waiting = null;

function goOn() {
  const messages = waiting || [];
  waiting = null;
  messages.forEach(receive);
}

function receive(data) {
  if (typeof data !== "string") return waiting ? waiting.push(data) : showImage(data);
  const m = JSON.parse(data);
  if (m.type === "cue") showCue(m);
  else if (waiting && m.type !== "answer") waiting.push(data);
  else if (m.type === "force") {
    state.force.push(...m.samples);
    const newest = state.force[state.force.length - 1][0];
    // A clock that went back (a replay begun again) begins the curve again.
    state.force = state.force.filter(([t]) => t <= newest && t > newest - SPAN - 0.5);
    dirty = true;
  } else if (m.type === "points") {
    for (const kind of ["measured", "model"]) if (m[kind]) state.now[kind].push(...m[kind]);
    if (m.measured) state.area = m.measured[m.measured.length - 1][1];
    for (const kind of ["measured", "model"]) state.now[kind] = state.now[kind].slice(-3000);
    dirty = true;
  } else if (m.type === "contact") { state.area = m.area; dirty = true; }
  else if (m.type === "status") showStatusSoon(m);
  else if (m.type === "health") showHealth(m.items);
  else if (m.type === "hello") {
    $("image-none").textContent = m.images
      ? "no image yet" : "images stay on the rig's own computer";
    link.send({ type: "watch", images: m.images && !document.hidden });
    state.images = m.images;
  } else if (m.type === "answer") {
    const resolve = state.answers.get(m.id);
    state.answers.delete(m.id);
    if (resolve) resolve(m);
  }
}

const link = new Link({ view: "operator", token }, receive, (connected) => {
  $("link").textContent = connected ? "connected" : "not connected";
  $("link").className = connected ? "good" : "bad";
  document.body.classList.toggle("offline", !connected);
  if (!connected) for (const [id, resolve] of state.answers) {
    state.answers.delete(id);
    resolve({ success: false, message: "the connection was lost" });
  }
});

document.addEventListener("visibilitychange", () => {
  // A hidden page shows no frame to wait for.
  if (document.hidden) goOn();
  if (state.images) link.send({ type: "watch", images: !document.hidden });
});

// Drawing -------------------------------------------------------------------------------------

function frame(now) {
  // Ten pictures a second are enough for the eye; the cue does not wait for them.
  if (dirty && now - drawn > 90) {
    dirty = false;
    drawn = now;
    const force = state.force.length ? state.force[state.force.length - 1][1] : null;
    const shown = Math.abs(force) < 0.005 ? 0 : force;
    $("force-value").textContent = force === null ? "–" : shown.toFixed(2);
    $("area-value").textContent = state.area === null ? "–" : state.area.toFixed(1);
    const share = Math.max(0, Math.min(1, (force || 0) / (state.target * 1.25)));
    const bar = $("cue-bar");
    bar.style.setProperty("--share", share);
    bar.setAttribute("aria-valuenow", (force || 0).toFixed(2));
    bar.setAttribute("aria-valuemax", (state.target * 1.25).toFixed(2));
    // Just before the cue to lift the plots wait, for half a second at most: a plot being drawn
    // would hold the cue up.
    const pressing = state.cue && state.cue.phase === "press";
    if (!(pressing && force > 0.8 * state.target && now - plotted < 500)) {
      plotted = now;
      forcePlot($("force-plot"), state.force, state.target, SPAN);
      areaPlot($("area-plot"), state.now, state.before, state.target);
    }
  }
  requestAnimationFrame(frame);
}
requestAnimationFrame(frame);
window.addEventListener("resize", () => { dirty = true; });

// Buttons and keys ----------------------------------------------------------------------------

$("start").onclick = primary;
$("pause").onclick = pauseOrResume;
$("redo").onclick = () => command("redo");
$("skip").onclick = () => command("skip");
$("tare").onclick = async () => {
  const answer = await command("tare");
  // Points taken with the old zero mean nothing.
  if (answer.success && state.status.step !== "press") state.now = { measured: [], model: [] };
};
$("keys").onclick = () => $("keys-dialog").showModal();
$("plan-cancel").onclick = () => $("session-dialog").close();
$("session-form").onsubmit = beginSession;
$("moisture-form").onsubmit = async (event) => {
  event.preventDefault();
  const input = $("moisture-input");
  if (input.value === "") {
    return notify(`Type a reading of ${input.placeholder} a.u. first.`, false);
  }
  const answer = await command("moisture", { value: Number(input.value) });
  if (answer.success) { input.value = ""; input.blur(); }
};
function editPreparation(show) {
  $("preparation-form").hidden = !show;
  $("preparation-text").hidden = show;
  if (!show) return;
  $("preparation-input").value = state.status.preparation || "";
  $("preparation-input").focus();
}
$("preparation-edit").onclick = () => editPreparation(true);
$("preparation-cancel").onclick = () => editPreparation(false);
$("preparation-form").onsubmit = async (event) => {
  event.preventDefault();
  const answer = await command("preparation", {
    condition: state.status.condition, text: $("preparation-input").value,
  });
  if (answer.success) editPreparation(false);
};

const KEYS = {
  " ": () => $("start").click(),
  p: () => $("pause").click(),
  r: () => $("redo").click(),
  s: () => $("skip").click(),
  t: () => $("tare").click(),
  m: () => $("moisture-input").focus(),
  e: () => $("preparation-edit").click(),
  "?": () => $("keys").click(),
  f: () => document.documentElement.requestFullscreen?.(),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (document.querySelector("dialog[open]")) return;
  if (event.target.closest("input, textarea")) {
    if (event.key === "Escape") event.target.blur();
    return;
  }
  const action = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action || event.repeat) return;
  event.preventDefault();
  // A focused button must not take the key as a click of its own.
  if (document.activeElement instanceof HTMLButtonElement) document.activeElement.blur();
  action();
});
